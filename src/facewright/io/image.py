"""Pictures: any common kind in, sRGB RGB of 8 bits out; written whole or not at all."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically

if TYPE_CHECKING:
    from PIL import Image

#: Largest picture that is read, in pixels: beyond it a small file could fill the memory.
MAX_PIXELS = 120_000_000
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
        1 to 100, for JPEG and WebP.

    Raises
    ------
    ShapeError, ValueRangeError
        If the array is not a picture of 8 bits or the suffix is unknown.
    StoreError
        If the file cannot be written; nothing half-written is left.
    """
    from PIL import Image

    file = Path(path)
    if file.suffix.lower() not in WRITE_SUFFIXES:
        raise ValueRangeError(f"picture file must end in {', '.join(WRITE_SUFFIXES)}, got {file.name!r}.")
    picture = Image.fromarray(_checked_pixels(image))
    if file.suffix.lower() in (".jpg", ".jpeg") and picture.mode == "RGBA":
        picture = picture.convert("RGB")
    with write_atomically(file) as temporary:
        picture.save(temporary, format=Image.registered_extensions()[file.suffix.lower()], quality=quality)


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
            picture = Image.open(file)
    except UnidentifiedImageError as error:
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


def _rgb(picture: Image.Image, file: Path) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 of a picture of any mode."""
    from PIL import Image

    if picture.mode.startswith(("I", "F")):
        return np.repeat(_eight_bits(np.asarray(picture), file)[..., None], 3, axis=2)
    if "transparency" in picture.info or picture.mode in ("RGBA", "LA", "PA", "La", "RGBa"):
        layered = picture.convert("RGBA")
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
