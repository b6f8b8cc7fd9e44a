"""Pictures: any common kind in, sRGB RGB of 8 bits out; written whole or not at all."""

from __future__ import annotations

import io
import math
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically

if TYPE_CHECKING:
    from PIL import Image

#: Largest picture that is read, in pixels: beyond it a small file could fill the memory.
MAX_PIXELS = 150_000_000
#: Suffixes that `write_image` understands.
WRITE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_EXIF_IFD, _FOCAL_LENGTH_35MM = 0x8769, 0xA405
_DIAGONAL_35MM = math.hypot(36.0, 24.0)


def read_image(path: str | Path, max_pixels: int = MAX_PIXELS) -> NDArray[np.uint8]:
    """Read a picture as sRGB of 8 bits, upright.

    The orientation of the EXIF data is applied. Greyscale, palette, CMYK, 16-bit and float pictures are turned into
    RGB; transparent parts are laid over white; colours of an embedded profile are turned into sRGB; of an animation
    the first frame is taken.

    Parameters
    ----------
    path : str or Path
        The file.
    max_pixels : int
        Larger pictures are refused before they are decoded.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        sRGB, C-contiguous.

    Raises
    ------
    StoreError
        If the file does not exist or cannot be read.
    FileFormatError
        If it is empty, truncated, not a picture or too large.
    """
    file = Path(path)
    with _opened(file, max_pixels) as picture:
        try:
            upright = _upright(picture)
            return np.ascontiguousarray(_rgb(_to_srgb(upright), file))
        except FileFormatError:
            raise
        except MemoryError:
            raise
        except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error, ...
            raise FileFormatError(f"{file} must be a whole picture, got one that is truncated or corrupt.") from error


@dataclass(frozen=True, eq=False)
class PhotoFile:
    """A photo with what is needed to write a changed copy of it.

    Parameters
    ----------
    pixels : ndarray of shape (H, W, 3), uint8
        sRGB, upright; colours of transparent pixels as they are in the file.
    alpha : ndarray of shape (H, W), uint8, or None
        Opacity, where the picture has any transparency.
    focal_length : float or None
        Pixels, of the EXIF data.
    remarks : tuple of str
        What was made of an unusual file: sentences for the user.
    """

    pixels: NDArray[np.uint8]
    alpha: NDArray[np.uint8] | None = None
    focal_length: float | None = None
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, pixels: NDArray[np.uint8]) -> PhotoFile:
        """Return the photo of an array (H, W), (H, W, 3) or (H, W, 4), uint8."""
        array = _checked_pixels(pixels)
        if array.ndim == 2:
            return cls(np.repeat(array[..., None], 3, axis=2))
        if array.shape[2] == 3:
            return cls(array)
        return cls(np.ascontiguousarray(array[..., :3]), np.ascontiguousarray(array[..., 3]))

    def over_white(self) -> NDArray[np.uint8]:
        """Return the pixels (H, W, 3) laid over white, as they are seen; without transparency the array itself."""
        if self.alpha is None:
            return self.pixels
        seen = np.empty_like(self.pixels)
        for top in range(0, len(seen), 256):  # strips: the 16-bit sum would double a large picture
            rows = slice(top, top + 256)
            opacity = self.alpha[rows, :, None].astype(np.uint16)
            seen[rows] = (self.pixels[rows] * opacity + 255 * (255 - opacity) + 127) // 255
        return seen


def read_photo(path: str | Path, max_pixels: int = MAX_PIXELS) -> PhotoFile:
    """Read a photo that is to be changed and written again, see `write_photo`.

    As `read_image`, but transparency is kept apart and unusual files are remarked on: the first frame of an
    animation, 16 bits made 8, greyscale and CMYK turned into RGB.

    Raises
    ------
    StoreError
        If the file does not exist or cannot be read.
    FileFormatError
        If it is empty, truncated, not a picture or too large, or of a kind (HEIC) whose plug-in is absent.
    """
    file = Path(path)
    with _opened(file, max_pixels) as picture:
        try:
            remarks = _remarks(picture, file)
            upright = _upright(picture)
            pixels = np.ascontiguousarray(_rgb(_to_srgb(upright), file, flatten=False))
            alpha = _alpha(upright)
        except (FileFormatError, MemoryError):
            raise
        except Exception as error:  # decoders raise OSError, SyntaxError, ValueError, struct.error, ...
            raise FileFormatError(f"{file} must be a whole picture, got one that is truncated or corrupt.") from error
    return PhotoFile(pixels, alpha, read_focal_length(file), remarks)


def write_photo(path: str | Path, pixels: NDArray[np.uint8], like: PhotoFile | None = None, quality: int = 95) -> None:
    """Write a changed photo whole, with the transparency of the one it was made from where the format has any.

    Parameters
    ----------
    path : str or Path
        The file: PNG, JPEG, WebP or TIFF by its suffix. PNG and TIFF are lossless; WebP is written without loss where
        the photo is transparent.
    pixels : ndarray of shape (H, W, 3), uint8
        sRGB.
    like : PhotoFile, optional
        The photo; its size must be that of `pixels`. JPEG, which has no transparency, is laid over white.
    quality : int
        1 to 100, for JPEG and WebP.

    Raises
    ------
    ShapeError, ValueRangeError
        If the array is not a picture of 8 bits, sizes differ or the suffix is unknown.
    StoreError
        If the file cannot be written; nothing half-written is left.
    """
    image = _checked_pixels(pixels)
    if like is not None and like.alpha is not None:
        if like.alpha.shape != image.shape[:2]:
            raise ShapeError(f"pixels must have the photo's size {like.alpha.shape}, got {image.shape[:2]}.")
        if Path(path).suffix.lower() in (".jpg", ".jpeg", ".bmp"):
            image = PhotoFile(image[..., :3], like.alpha).over_white()
        else:
            image = np.dstack([image[..., :3], like.alpha])
    write_image(path, image, quality)


def reduced(image: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) made smaller by a whole factor, each pixel the mean of a block.

    The last rows and columns that do not fill a block are left out.
    """
    if step < 1:
        raise ValueRangeError(f"step must be at least 1, got {step}.")
    height, width = image.shape[0] // step, image.shape[1] // step
    if not (height and width):
        raise ValueRangeError(f"step must be at most the picture's shorter side {min(image.shape[:2])}, got {step}.")
    from PIL import Image

    return np.asarray(Image.fromarray(image[: height * step, : width * step]).reduce(step))


def read_focal_length(path: str | Path) -> float | None:
    """Return the focal length that the EXIF data states, in pixels of the picture, or None.

    From the 35 mm equivalent by the diagonal; wrong where the picture has been cropped since.

    Raises
    ------
    StoreError, FileFormatError
        As `read_image`.
    """
    with _opened(Path(path), MAX_PIXELS) as picture:
        try:
            value = float(picture.getexif().get_ifd(_EXIF_IFD).get(_FOCAL_LENGTH_35MM, 0))
        except Exception:  # broken EXIF data are as good as none
            return None
        if not math.isfinite(value) or value <= 0:
            return None
        return value / _DIAGONAL_35MM * math.hypot(*picture.size)


def write_image(path: str | Path, image: NDArray[np.uint8], quality: int = 95) -> None:
    """Write a picture; the format is that of the suffix.

    Parameters
    ----------
    path : str or Path
        The file: one of `WRITE_SUFFIXES`.
    image : ndarray of shape (H, W), (H, W, 3) or (H, W, 4), uint8
        sRGB.
    quality : int
        1 to 100, for JPEG and WebP; WebP with transparency is written without loss.

    Raises
    ------
    ShapeError, ValueRangeError
        If the array is not a picture of 8 bits or the suffix is unknown.
    StoreError
        If the file cannot be written; nothing half-written is left.
    """
    from PIL import Image

    file = Path(path)
    check_picture_suffix(file)
    picture = Image.fromarray(_checked_pixels(image))
    if file.suffix.lower() in (".jpg", ".jpeg") and picture.mode == "RGBA":
        picture = picture.convert("RGB")
    with write_atomically(file) as temporary:
        # `exact` keeps colours below transparent pixels; other formats ignore both
        kind = Image.registered_extensions()[file.suffix.lower()]
        picture.save(temporary, format=kind, quality=quality, lossless=picture.mode == "RGBA", exact=True)


def check_picture_suffix(path: Path) -> None:
    """Refuse a file name that `write_image` could not write; for callers that have long work to do before."""
    if path.suffix.lower() not in WRITE_SUFFIXES:
        raise ValueRangeError(f"picture file must end in {', '.join(WRITE_SUFFIXES)}, got {path.name!r}.")


def encode_image(image: NDArray[np.uint8], kind: str = "jpeg", quality: int = 92) -> bytes:
    """Return the bytes of a picture file, ``"jpeg"`` or ``"png"``, for formats that embed pictures."""
    from PIL import Image

    if kind not in ("jpeg", "png"):
        raise ValueRangeError(f"kind must be 'jpeg' or 'png', got {kind!r}.")
    buffer = io.BytesIO()
    Image.fromarray(_checked_pixels(image)).save(buffer, format=kind, quality=quality)
    return buffer.getvalue()


def _checked_pixels(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    array = np.asarray(image)
    shaped = array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))
    if not shaped or array.dtype != np.uint8 or 0 in array.shape:
        raise ShapeError(f"image must be (H, W), (H, W, 3) or (H, W, 4) of uint8, got {array.shape} of {array.dtype}.")
    return np.ascontiguousarray(array)


def _opened(file: Path, max_pixels: int) -> Image.Image:
    """Open a picture and check its kind and size without decoding it."""
    from PIL import Image, UnidentifiedImageError

    try:
        if file.is_dir():
            raise StoreError(f"{file} must be a picture file, got a folder.")
        if file.stat().st_size == 0:
            raise FileFormatError(f"{file} must be a picture, got an empty file.")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # our own limit is stated below
            _register_heif()
            picture = Image.open(file)
    except UnidentifiedImageError as error:
        if _is_heic(file):
            raise FileFormatError(
                f"{file} is a HEIC picture, which needs a plug-in: pip install pillow-heif, or save it as JPEG or PNG."
            ) from error
        if _starts(file, 4) in (b"II*\0", b"MM\0*"):
            sentence = f"{file} must be a TIFF of whole numbers, got one of floating point or the like; save 8 bits."
            raise FileFormatError(sentence) from error
        raise FileFormatError(f"{file} must be a picture (JPEG, PNG, TIFF, WebP, ...), got something else.") from error
    except Image.DecompressionBombError as error:
        raise FileFormatError(f"{file} must have at most {max_pixels} pixels, got far more.") from error
    except (FileFormatError, StoreError):
        raise
    except FileNotFoundError as error:
        raise StoreError(f"{file} does not exist.") from error
    except PermissionError as error:
        raise StoreError(f"{file} cannot be read: {error.strerror}.") from error
    except Exception as error:
        raise FileFormatError(f"{file} must be a whole picture, got one that is truncated or corrupt.") from error
    width, height = picture.size
    if width * height > max_pixels:
        picture.close()
        raise FileFormatError(f"{file} must have at most {max_pixels} pixels, got {width} x {height}.")
    return picture


def _register_heif() -> None:
    """Let Pillow read HEIC where its plug-in is installed."""
    with suppress(ImportError):
        import pillow_heif

        pillow_heif.register_heif_opener()


def _is_heic(file: Path) -> bool:
    """Tell HEIC and AVIF by the brand at the start of the file."""
    return _starts(file, 12)[4:] in [b"ftyp" + kind for kind in (b"heic", b"heix", b"heif", b"hevc", b"mif1", b"msf1")]


def _starts(file: Path, n_bytes: int) -> bytes:
    with file.open("rb") as stream:
        return stream.read(n_bytes)


def _remarks(picture: Image.Image, file: Path) -> tuple[str, ...]:
    """Say what is made of an unusual picture."""
    remarks = []
    frames = int(getattr(picture, "n_frames", 1))
    if frames > 1:
        remarks.append(f"{file} holds {frames} frames, the first is used.")
    if picture.mode.startswith(("I", "F")) or any(";16" in str(tile) for tile in getattr(picture, "tile", ())):
        remarks.append(f"{file} has more than 8 bits per channel, the result has 8.")
    if picture.mode == "CMYK":
        remarks.append(f"{file} has the colours of a printer (CMYK), the result those of a screen (sRGB).")
    return tuple(remarks)


def _alpha(picture: Image.Image) -> NDArray[np.uint8] | None:
    """Return the opacity (H, W), or None where everything is opaque."""
    if "transparency" not in picture.info and picture.mode not in ("RGBA", "LA", "PA", "La", "RGBa"):
        return None
    alpha = np.asarray(picture.convert("RGBA"))[..., 3]
    return None if (alpha == 255).all() else np.ascontiguousarray(alpha)


def _upright(picture: Image.Image) -> Image.Image:
    from PIL import ImageOps

    picture.load()  # the first frame; a truncated file fails here
    try:
        return ImageOps.exif_transpose(picture)
    except (OSError, SyntaxError, ValueError, KeyError, TypeError):  # broken EXIF data do not spoil the picture
        return picture


def _to_srgb(picture: Image.Image) -> Image.Image:
    """Turn colours of an embedded profile into sRGB; pictures without one are taken as sRGB."""
    profile = picture.info.get("icc_profile")
    if not profile or picture.mode not in ("RGB", "RGBA", "CMYK"):
        return picture
    from PIL import ImageCms

    try:
        return (
            ImageCms.profileToProfile(
                picture,
                ImageCms.ImageCmsProfile(io.BytesIO(profile)),
                ImageCms.createProfile("sRGB"),
                outputMode="RGBA" if picture.mode == "RGBA" else "RGB",
            )
            or picture
        )
    except (ImageCms.PyCMSError, OSError, ValueError):  # a broken profile: the plain values are the best guess
        return picture


def _rgb(picture: Image.Image, file: Path, *, flatten: bool = True) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 of a picture of any mode; transparent parts over white, or as they are."""
    from PIL import Image

    if picture.mode.startswith(("I", "F")):
        return np.repeat(_eight_bits(np.asarray(picture), file)[..., None], 3, axis=2)
    if "transparency" in picture.info or picture.mode in ("RGBA", "LA", "PA", "La", "RGBa"):
        layered = picture.convert("RGBA")
        if not flatten:
            return np.asarray(layered)[..., :3]
        white = Image.new("RGBA", layered.size, (255, 255, 255, 255))
        return np.asarray(Image.alpha_composite(white, layered).convert("RGB"))
    return np.asarray(picture.convert("RGB"))


def _eight_bits(values: NDArray[np.generic], file: Path) -> NDArray[np.uint8]:
    """Scale greyscale of 16 bits, 32 bits or float to 8 bits."""
    numbers = values.astype(np.float64)
    if not np.isfinite(numbers).all() or numbers.min() < 0 or numbers.max() > 65535:
        raise FileFormatError(
            f"{file} must hold grey values in [0, 65535], got [{numbers.min():g}, {numbers.max():g}]."
        )
    if values.dtype.kind == "f":
        white = 1.0 if numbers.max() <= 1 else 255.0 if numbers.max() <= 255 else 65535.0
    else:
        white = 65535.0 if values.dtype.itemsize == 2 or numbers.max() > 255 else 255.0
    return np.round(numbers * (255.0 / white)).astype(np.uint8)
