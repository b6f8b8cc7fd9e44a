"""Pictures of depth cameras: numbers stay as they are, damaged files are refused."""

import io

import numpy as np
import pytest
from PIL import Image

from facewright.errors import FileFormatError, ShapeError, StoreError
from facewright.io.frame_image import decode_color, decode_depth, encode_depth, read_bytes


def _file(picture, kind="png"):
    buffer = io.BytesIO()
    picture.save(buffer, format=kind)
    return buffer.getvalue()


def test_depth_comes_back_exactly(rng):
    counts = rng.integers(0, 65536, (48, 64)).astype(np.uint16)
    back = decode_depth(encode_depth(counts), "a.png")
    assert back.dtype == np.uint16
    np.testing.assert_array_equal(back, counts)


def test_float_depth_keeps_nan(rng):
    metres = rng.uniform(0.4, 0.8, (12, 16)).astype(np.float32)
    metres[3, 4] = np.nan
    np.testing.assert_array_equal(decode_depth(_file(Image.fromarray(metres), "tiff"), "a.tif"), metres)


def test_32_bit_integers_become_16_where_they_fit(rng):
    counts = rng.integers(0, 65536, (12, 16)).astype(np.int32)
    back = decode_depth(_file(Image.fromarray(counts), "tiff"), "a.tif")
    assert back.dtype == np.uint16
    np.testing.assert_array_equal(back, counts)
    large = decode_depth(_file(Image.fromarray(counts + 70000), "tiff"), "a.tif")
    np.testing.assert_array_equal(large, counts + 70000)


def test_the_turn_of_exif_is_not_applied(rng):
    """Depth pictures know nothing of it, and both must stay on one grid."""
    color = rng.integers(0, 256, (12, 16, 3)).astype(np.uint8)
    exif = Image.Exif()
    exif[0x0112] = 6
    buffer = io.BytesIO()
    Image.fromarray(color).save(buffer, format="png", exif=exif)
    np.testing.assert_array_equal(decode_color(buffer.getvalue(), "a.png"), color)


def test_grey_and_transparent_colour_become_rgb():
    grey = decode_color(_file(Image.new("L", (4, 3), 90)), "a.png")
    assert grey.shape == (3, 4, 3) and (grey == 90).all()
    assert decode_color(_file(Image.new("RGBA", (4, 3), (1, 2, 3, 255))), "a.png").shape == (3, 4, 3)


@pytest.mark.parametrize("decode", [decode_depth, decode_color])
@pytest.mark.parametrize("cut", [0, 4, 20, 60, 500])
def test_truncated_pictures_are_refused(rng, decode, cut):
    data = encode_depth(rng.integers(0, 65536, (48, 64)).astype(np.uint16))
    with pytest.raises(FileFormatError, match=r"frame\.png must be a"):
        decode(data[:cut], "frame.png")


def test_other_pictures_are_no_depth():
    with pytest.raises(FileFormatError, match="8 bits"):
        decode_depth(_file(Image.new("L", (4, 3))), "a.png")
    with pytest.raises(FileFormatError, match="3 channels"):
        decode_depth(_file(Image.new("RGB", (4, 3))), "a.png")
    with pytest.raises(FileFormatError, match="8 bits"):
        decode_color(encode_depth(np.zeros((3, 4), np.uint16)), "a.png")
    with pytest.raises(FileFormatError, match="truncated or corrupt"):
        decode_depth(b"no picture at all", "a.png")


def test_huge_pictures_are_refused_before_they_are_decoded(monkeypatch):
    monkeypatch.setattr("facewright.io.frame_image.MAX_PIXELS", 10)
    with pytest.raises(FileFormatError, match="at most 10 pixels"):
        decode_depth(encode_depth(np.zeros((3, 4), np.uint16)), "a.png")


def test_encoding_wants_16_bits():
    with pytest.raises(ShapeError, match="uint16"):
        encode_depth(np.zeros((3, 4), np.float32))


def test_missing_files(tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        read_bytes(tmp_path / "a.png")
    with pytest.raises(StoreError, match="cannot be read"):
        read_bytes(tmp_path)
