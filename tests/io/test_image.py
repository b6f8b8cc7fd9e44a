import io

import numpy as np
import pytest
from PIL import Image, ImageCms

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.image import encode_image, read_focal_length, read_image, write_image


@pytest.fixture
def picture(rng):
    coarse = rng.integers(0, 255, (6, 8, 3)).astype(np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((64, 48), Image.Resampling.BICUBIC))


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif"])
def test_lossless_round_trip(tmp_path, picture, suffix):
    write_image(tmp_path / f"a{suffix}", picture)
    back = read_image(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(back, picture)
    assert back.flags.c_contiguous and back.dtype == np.uint8


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_lossy_round_trip(tmp_path, picture, suffix):
    write_image(tmp_path / f"a{suffix}", picture)
    assert np.abs(read_image(tmp_path / f"a{suffix}").astype(int) - picture).mean() < 5


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied(tmp_path, picture, orientation):
    stored = {
        1: picture,
        2: picture[:, ::-1],
        3: picture[::-1, ::-1],
        4: picture[::-1],
        5: picture.transpose(1, 0, 2),
        6: picture.transpose(1, 0, 2)[::-1],
        7: picture.transpose(1, 0, 2)[::-1, ::-1],
        8: picture.transpose(1, 0, 2)[:, ::-1],
    }[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), picture)


def test_modes_become_rgb(tmp_path, picture):
    grey = np.asarray(Image.fromarray(picture).convert("L"))
    expected = np.repeat(grey[..., None], 3, axis=2)
    Image.fromarray(grey).save(tmp_path / "l.png")
    np.testing.assert_array_equal(read_image(tmp_path / "l.png"), expected)
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "16.png")
    np.testing.assert_array_equal(read_image(tmp_path / "16.png"), expected)
    Image.fromarray((grey / 255).astype(np.float32)).save(tmp_path / "f.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "f.tif"), expected)
    Image.fromarray(grey.astype(np.int32)).save(tmp_path / "i.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "i.tif"), expected)
    Image.fromarray(grey > 127).save(tmp_path / "1.png")
    assert set(np.unique(read_image(tmp_path / "1.png"))) == {0, 255}
    Image.fromarray(picture).convert("P").save(tmp_path / "p.png")
    assert read_image(tmp_path / "p.png").shape == picture.shape
    Image.fromarray(picture).convert("CMYK").save(tmp_path / "c.jpg", quality=95)
    assert np.abs(read_image(tmp_path / "c.jpg").astype(int) - picture).mean() < 8


def test_transparency_is_laid_over_white(tmp_path, picture):
    alpha = np.zeros((*picture.shape[:2], 1), np.uint8)
    alpha[10:20] = 255
    Image.fromarray(np.concatenate([picture, alpha], axis=2)).save(tmp_path / "a.png")
    back = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(back[10:20], picture[10:20])
    assert (back[:10] == 255).all()
    Image.fromarray(picture).convert("P").save(tmp_path / "p.gif", transparency=0)
    assert read_image(tmp_path / "p.gif").shape == picture.shape


def test_colour_profiles_are_applied_or_ignored_if_broken(tmp_path, picture):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(picture).save(tmp_path / "a.png", icc_profile=profile)
    assert np.abs(read_image(tmp_path / "a.png").astype(int) - picture).max() <= 2
    Image.fromarray(picture).save(tmp_path / "b.png", icc_profile=b"nonsense" * 20)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), picture)


def test_focal_length_comes_from_the_35_mm_equivalent(tmp_path, picture):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 50
    Image.fromarray(picture).save(tmp_path / "a.jpg", exif=exif)
    assert read_focal_length(tmp_path / "a.jpg") == pytest.approx(50 / np.hypot(36, 24) * 80)
    write_image(tmp_path / "b.jpg", picture)
    assert read_focal_length(tmp_path / "b.jpg") is None


@pytest.mark.parametrize("kind", ["png", "jpeg", "gif", "tiff", "webp", "bmp"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7])
def test_truncated_files_are_refused(tmp_path, picture, kind, share):
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, kind)
    (tmp_path / f"cut.{kind}").write_bytes(buffer.getvalue()[: int(share * len(buffer.getvalue()))])
    with pytest.raises(FileFormatError, match="cut"):
        read_image(tmp_path / f"cut.{kind}")


def test_other_files_are_refused(tmp_path, picture):
    (tmp_path / "a.jpg").write_text("not a picture at all, but long enough to be looked at")
    with pytest.raises(FileFormatError, match=r"a\.jpg"):
        read_image(tmp_path / "a.jpg")
    with pytest.raises(StoreError, match=r"no\.jpg"):
        read_image(tmp_path / "no.jpg")
    with pytest.raises(StoreError, match="folder"):
        read_image(tmp_path)
    write_image(tmp_path / "b.png", picture)
    with pytest.raises(FileFormatError, match="64 x 48"):
        read_image(tmp_path / "b.png", max_pixels=1000)
    Image.fromarray(np.full((4, 4), np.nan, np.float32)).save(tmp_path / "nan.tif")
    with pytest.raises(FileFormatError, match="grey"):
        read_image(tmp_path / "nan.tif")


def test_a_decompression_bomb_is_refused_before_it_is_decoded(tmp_path):
    import struct
    import zlib

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0))
    (tmp_path / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    with pytest.raises(FileFormatError, match="pixels"):
        read_image(tmp_path / "bomb.png")


def test_writing_refuses_other_arrays_and_suffixes(tmp_path, picture):
    with pytest.raises(ShapeError):
        write_image(tmp_path / "a.png", picture.astype(np.float32))
    with pytest.raises(ShapeError):
        write_image(tmp_path / "a.png", picture[:0])
    with pytest.raises(ValueRangeError, match="psd"):
        write_image(tmp_path / "a.psd", picture)
    with pytest.raises(StoreError):
        write_image(tmp_path / "none" / "a.png", picture)
    assert not list(tmp_path.iterdir())


def test_alpha_is_dropped_in_jpeg_and_encoding_gives_files(tmp_path, picture):
    with_alpha = np.concatenate([picture, np.full((*picture.shape[:2], 1), 255, np.uint8)], axis=2)
    write_image(tmp_path / "a.jpg", with_alpha)
    assert read_image(tmp_path / "a.jpg").shape == picture.shape
    assert np.asarray(Image.open(io.BytesIO(encode_image(picture, "png")))).shape == picture.shape
    assert encode_image(picture)[:2] == b"\xff\xd8"
    with pytest.raises(ValueRangeError):
        encode_image(picture, "bmp")
