"""Record3D recordings (.r3d): a ZIP of JPEG colour and LZFSE-compressed depth from an iPhone or iPad."""

from __future__ import annotations

import json
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import FileFormatError, MissingExtraError, StoreError
from facewright.io.frame_image import decode_color
from facewright.io.image import MAX_PIXELS

_DEPTH_NAME = re.compile(r"rgbd/([0-9]{1,9})\.depth")
_LOW_CONFIDENCE = 0
_FRAMES_PER_SECOND = 30.0
_MAX_JPEG_BYTES = 1 << 28


class Record3DSource:
    """Frames of a ``.r3d`` file.

    The JSON ``metadata`` holds sizes of colour (w, h) and depth (dw, dh), the intrinsic matrix K of the colour picture
    column after column, perhaps one camera per frame (fx, fy, cx, cy), and times. Depths are float32 metres, NaN for
    none; where LiDAR's confidence (``.conf``) is low, there is none either. The depth's grid is kept.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is no whole Record3D recording.
    MissingExtraError
        When compressed depth is read without the imagecodecs package.
    """

    kind = "record3d"

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._zip = zipfile.ZipFile(path)
        except OSError as error:
            raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
        except zipfile.BadZipFile as error:
            raise FileFormatError(
                f"{path} must be a Record3D file (ZIP), got one that is truncated or foreign."
            ) from error
        self._names = set(self._zip.namelist())
        self._meta = self._read_metadata()
        numbers = sorted(int(match[1]) for name in self._names if (match := _DEPTH_NAME.fullmatch(name)))
        self._numbers = [k for k in numbers if f"rgbd/{k}.jpg" in self._names]
        self.n_frames = len(self._numbers)
        alone = len(numbers) - self.n_frames
        self.warnings: tuple[str, ...] = (
            (f"{alone} of {len(numbers)} depth pictures of {path} have no colour and are left out.",) if alone else ()
        )
        if numbers and not self.n_frames:
            raise FileFormatError(f"{path} must have colour with its depth, got {alone} depth pictures and no colour.")

    def depth(self, i: int) -> NDArray[np.floating]:
        """Return depth in millimetres."""
        k = self._numbers[i]
        height, width = self._depth_size
        raw = self._unpacked(f"rgbd/{k}.depth", 4 * height * width)
        depth = np.frombuffer(raw, "<f4").reshape(height, width) * np.float32(1000.0)
        if f"rgbd/{k}.conf" in self._names:
            confidence = np.frombuffer(self._unpacked(f"rgbd/{k}.conf", height * width), np.uint8)
            depth[confidence.reshape(height, width) == _LOW_CONFIDENCE] = 0.0
        return depth

    def color(self, i: int) -> NDArray[np.uint8]:
        """Return colour as stored."""
        name = f"rgbd/{self._numbers[i]}.jpg"
        return decode_color(self._member(name, _MAX_JPEG_BYTES), f"{name} of {self._path}")

    def intrinsics(self, i: int) -> Intrinsics | None:
        """Return the camera of frame `i`, on the depth's grid."""
        meta, k = self._meta, self._numbers[i]
        try:
            per_frame = meta.get("perFrameIntrinsicCoeffs") or []
            if k < len(per_frame):
                fx, fy, cx, cy = map(float, per_frame[k][:4])
            elif "K" in meta:
                m = np.array(meta["K"], dtype=np.float64).reshape(3, 3).T
                fx, fy, cx, cy = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
            else:
                return None
            x, y = self._depth_size[1] / float(meta["w"]), self._depth_size[0] / float(meta["h"])
            # the centre of the first pixel is (0, 0) on both grids
            return Intrinsics(fx * x, fy * y, (cx + 0.5) * x - 0.5, (cy + 0.5) * y - 0.5)
        except (ValueError, OverflowError, KeyError, TypeError, ZeroDivisionError) as error:
            raise FileFormatError(
                f"{self._path} must state its camera (K, w, h) in metadata, got {error!r}."
            ) from error

    def time(self, i: int) -> float:
        """Return the frame's time; by the frame rate where the file does not say."""
        k, times = self._numbers[i], self._meta.get("frameTimestamps")
        stated = _number(times[k]) if isinstance(times, list) and k < len(times) else None
        return k / (_number(self._meta.get("fps")) or _FRAMES_PER_SECOND) if stated is None else stated

    def _read_metadata(self) -> dict[str, Any]:
        if "metadata" not in self._names:
            raise FileFormatError(f"{self._path} must be a Record3D file with metadata in it, got a ZIP without.")
        text = self._member("metadata", _MAX_JPEG_BYTES)
        try:
            meta = json.loads(text)
            w, h = int(meta.get("dw") or meta["w"]), int(meta.get("dh") or meta["h"])
        except (ValueError, RecursionError, OverflowError, KeyError, TypeError, AttributeError) as error:
            raise FileFormatError(
                f"{self._path} must have JSON with w, h, dw, dh as metadata, got {error!r}."
            ) from error
        if w < 1 or h < 1 or w * h > MAX_PIXELS:
            raise FileFormatError(f"{self._path} must have depth of 1 to {MAX_PIXELS} pixels, got {w} x {h}.")
        self._depth_size = (h, w)
        return meta

    def _member(self, name: str, most: int) -> bytes:
        try:
            if self._zip.getinfo(name).file_size > most:
                raise FileFormatError(f"{name} of {self._path} must have at most {most} bytes, got more.")
            return self._zip.read(name)
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError) as error:
            raise FileFormatError(
                f"{name} of {self._path} must be whole, got one that is truncated or corrupt."
            ) from error

    def _unpacked(self, name: str, n_bytes: int) -> bytes:
        """Return a member of `n_bytes` decompressed; some writers store it uncompressed."""
        data = self._member(name, 16 * n_bytes + 4096)
        if len(data) == n_bytes:
            return data
        try:
            import imagecodecs
        except ImportError as error:
            raise MissingExtraError(
                'reading Record3D needs the imagecodecs package: pip install "facewright[capture]".'
            ) from error
        try:
            raw = bytes(imagecodecs.lzfse_decode(data, out=n_bytes + 1))
        except (RuntimeError, ValueError) as error:
            raise FileFormatError(f"{name} of {self._path} must be LZFSE data, got {error}.") from error
        if len(raw) != n_bytes:
            raise FileFormatError(f"{name} of {self._path} must hold {n_bytes} bytes, got {len(raw)}.")
        return raw


def _number(value: Any) -> float | None:
    """Return a JSON value as a finite number that is not negative, or None."""
    return float(value) if isinstance(value, int | float) and 0 <= value < 1e300 else None
