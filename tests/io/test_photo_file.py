"""Photos read to be changed and written again."""

import builtins
import struct

import numpy as np
import pytest
from PIL import Image

from facewright.errors import FileFormatError, ShapeError, ValueRangeError
from facewright.io.image import PhotoFile, check_picture_suffix, read_photo, reduced, write_photo


@pytest.fixture
def picture(rng):
    coarse = rng.integers(0, 255, (6, 8, 3)).astype(np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((64, 48), Image.Resampling.BICUBIC))


@pytest.fixture
def alpha(rng):
    values = rng.integers(0, 256, (48, 64)).astype(np.uint8)
    values[:8] = 0
    return values


@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp"])
def test_transparency_and_hidden_colours_survive_to_the_bit(tmp_path, picture, alpha, suffix):
    write_photo(tmp_path / f"a{suffix}", picture, PhotoFile(picture, alpha))
    back = read_photo(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(back.pixels, picture)
    np.testing.assert_array_equal(back.alpha, alpha)
    assert back.remarks == ()


def test_jpeg_lies_over_white(tmp_path, picture, alpha):
    photo = PhotoFile(picture, alpha)
    write_photo(tmp_path / "a.jpg", picture, photo)
    back = read_photo(tmp_path / "a.jpg")
    assert back.alpha is None
    assert np.abs(back.pixels[:4].astype(int) - 255).max() < 12  # wholly transparent
    expected = np.round(picture * (alpha / 255.0)[..., None] + 255 * (1 - alpha / 255.0)[..., None])
    assert np.abs(photo.over_white() - expected).max() <= 1


def test_an_opaque_alpha_channel_is_none(tmp_path, picture):
    Image.fromarray(np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])).save(tmp_path / "a.png")
    photo = read_photo(tmp_path / "a.png")
    assert photo.alpha is None and photo.over_white() is photo.pixels


def test_orientation_applies_to_transparency_too(tmp_path, picture, alpha):
    exif = Image.Exif()
    exif[0x0112] = 6  # to be shown turned by a quarter
    layered = np.dstack([picture, alpha])
    Image.fromarray(layered).save(tmp_path / "a.png", exif=exif)
    photo = read_photo(tmp_path / "a.png")
    np.testing.assert_array_equal(photo.pixels, picture.transpose(1, 0, 2)[:, ::-1])
    np.testing.assert_array_equal(photo.alpha, alpha.T[:, ::-1])


def test_the_first_frame_of_an_animation_is_used_and_said(tmp_path, picture):
    frames = [Image.fromarray(picture), Image.fromarray(255 - picture)]
    for suffix in (".gif", ".png", ".webp"):
        frames[0].save(tmp_path / f"a{suffix}", save_all=True, append_images=frames[1:], lossless=True)
        photo = read_photo(tmp_path / f"a{suffix}")
        assert photo.pixels.shape == picture.shape
        assert any("2 frames, the first is used" in remark for remark in photo.remarks)
    np.testing.assert_array_equal(read_photo(tmp_path / "a.png").pixels, picture)


def test_unusual_kinds_are_converted_and_said(tmp_path, picture):
    grey = np.asarray(Image.fromarray(picture).convert("L"))
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "16.png")
    sixteen = read_photo(tmp_path / "16.png")
    np.testing.assert_array_equal(sixteen.pixels, np.repeat(grey[..., None], 3, axis=2))
    assert "more than 8 bits" in sixteen.remarks[0]
    Image.fromarray(picture).convert("CMYK").save(tmp_path / "c.tif")
    assert "CMYK" in read_photo(tmp_path / "c.tif").remarks[0]
    Image.fromarray(grey).save(tmp_path / "l.png")
    np.testing.assert_array_equal(read_photo(tmp_path / "l.png").pixels, np.repeat(grey[..., None], 3, axis=2))


def test_heic_without_its_plug_in_names_it(tmp_path, monkeypatch):
    (tmp_path / "a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100))
    real = builtins.__import__

    def without(name, *rest, **more):
        if name == "pillow_heif":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(FileFormatError, match="pip install pillow-heif"):
        read_photo(tmp_path / "a.heic")


def test_tiff_of_floating_point_colours_is_told(tmp_path):
    colours, n = bytes(4 * 4 * 3 * 4), 10
    lists = 8 + 2 + 12 * n + 4  # where the directory ends
    fields = [(256, 1, 4), (257, 1, 4), (258, 3, lists), (259, 1, 1), (262, 1, 2), (273, 1, lists + 12), (277, 1, 3)]
    fields += [(278, 1, 4), (279, 1, len(colours)), (339, 3, lists + 6)]
    entries = b"".join(struct.pack("<HHII", tag, 3, count, value) for tag, count, value in fields)
    start = b"II*\0" + struct.pack("<IH", 8, n) + entries + bytes(4)
    (tmp_path / "a.tif").write_bytes(start + struct.pack("<6H", 32, 32, 32, 3, 3, 3) + colours)
    with pytest.raises(FileFormatError, match="floating point"):
        read_photo(tmp_path / "a.tif")


def test_refuses_what_is_no_picture(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FileFormatError, match="got something else"):
        read_photo(tmp_path / "a.png")
    Image.new("RGB", (64, 64), (3, 200, 90)).save(tmp_path / "b.png")
    data = (tmp_path / "b.png").read_bytes()
    (tmp_path / "c.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(FileFormatError, match="truncated or corrupt"):
        read_photo(tmp_path / "c.png")
    with pytest.raises(FileFormatError, match="at most 1000 pixels"):
        read_photo(tmp_path / "b.png", max_pixels=1000)


def test_arrays_become_photos(picture, alpha):
    assert PhotoFile.of(picture).pixels is picture
    grey = PhotoFile.of(picture[..., 0])
    np.testing.assert_array_equal(grey.pixels[..., 2], picture[..., 0])
    layered = PhotoFile.of(np.dstack([picture, alpha]))
    np.testing.assert_array_equal(layered.alpha, alpha)
    with pytest.raises(ShapeError):
        PhotoFile.of(picture.astype(np.float32))


def test_writing_refuses_other_sizes_and_names(tmp_path, picture, alpha):
    with pytest.raises(ShapeError, match="photo's size"):
        write_photo(tmp_path / "a.png", picture[:-1], PhotoFile(picture, alpha))
    with pytest.raises(ValueRangeError, match="must end in"):
        check_picture_suffix(tmp_path / "a.txt")
    assert list(tmp_path.iterdir()) == []


def test_reduced_takes_means_of_blocks(picture):
    small = reduced(picture, 4)
    expected = picture.reshape(12, 4, 16, 4, 3).mean(axis=(1, 3))
    assert small.shape == (12, 16, 3) and np.abs(small - expected).max() <= 0.51
    assert reduced(picture, 5).shape == (9, 12, 3)
    with pytest.raises(ValueRangeError):
        reduced(picture, 0)
    with pytest.raises(ValueRangeError, match="shorter side 48"):
        reduced(picture, 49)
