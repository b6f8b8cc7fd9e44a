"""Folders of Standard Cyborg TrueDepth frames: one PLY file a frame, from the front camera of an iPhone."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.capture.lens import LensTable, undistort
from facewright.capture.tum import natural_key
from facewright.errors import FileFormatError
from facewright.io.ply import PlyList, read_ply_elements

_NO_DEPTH_METRES = 9999.0


class TrueDepthSource:
    """Frames of a folder of PLY files with elements ``metadata`` (JSON), ``color`` and ``depth``.

    The colours are sRGB in [0, 1], the depths metres (9999 for none). The intrinsic matrix is stored column after
    column, for a reference picture (3088 x 2316) that covers the same view as the depth: it is scaled by the ratio of
    the widths. Where the file has the lens's distortion tables, colour and depth are undistorted. A phone held upright
    records heads that lie on their side: see `quarter_turns` of `open_recording` (3 makes them upright).

    Parameters
    ----------
    folder : Path
        With ``frame-*.ply``, or with other PLY files that are all frames.

    Raises
    ------
    FileFormatError, StoreError
        When a frame is read that is damaged or no such frame.
    """

    kind = "truedepth"

    def __init__(self, folder: Path) -> None:
        files = [f for f in folder.iterdir() if f.suffix.lower() == ".ply" and not f.name.startswith(".")]
        named = [f for f in files if f.name.lower().startswith("frame")]
        self._files = sorted(named or files, key=lambda f: natural_key(f.name))
        self.n_frames = len(self._files)
        self.warnings: tuple[str, ...] = ()
        self._read = lru_cache(maxsize=2)(_read_frame)

    def depth(self, i: int) -> NDArray[np.floating]:
        """Return depth in millimetres."""
        return self._read(self._files[i])[2]

    def color(self, i: int) -> NDArray[np.uint8]:
        """Return colour."""
        return self._read(self._files[i])[1]

    def intrinsics(self, i: int) -> Intrinsics:
        """Return the camera of frame `i`."""
        header, _, _ = self._read(self._files[i])
        try:
            camera = header["camera_intrinsics"]
            m = np.array(camera["intrinsic_matrix"], dtype=np.float64).reshape(3, 3).T
            scale = float(header["width"]) / float(camera["intrinsic_matrix_reference_dimensions_width"])
            return Intrinsics(m[0, 0] * scale, m[1, 1] * scale, m[0, 2] * scale, m[1, 2] * scale)
        except (ValueError, OverflowError, KeyError, TypeError, ZeroDivisionError) as error:
            raise FileFormatError(f"{self._files[i]} must say its camera_intrinsics, got {error!r}.") from error

    def time(self, i: int) -> float:
        """Return the frame's timestamp."""
        header, _, _ = self._read(self._files[i])
        value = header.get("timestamp", i)
        return float(value) if isinstance(value, int | float) and abs(value) < 1e300 else float(i)


def _read_frame(path: Path) -> tuple[dict[str, Any], NDArray[np.uint8], NDArray[np.float32]]:
    """Return the header, colour (H, W, 3) and depth (H, W) in mm of a frame, undistorted; 0 for no depth."""
    elements = read_ply_elements(path)
    try:
        text = _values(elements["metadata"]["char"]).astype(np.uint8).tobytes().rstrip(b"\0 \n")
        rgb = np.stack([_values(elements["color"][c]) for c in "rgb"], axis=1)
        metres = _values(elements["depth"]["d"])
    except KeyError as error:
        raise FileFormatError(
            f"{path} must be a TrueDepth frame with elements metadata, color and depth, got {sorted(elements)}."
        ) from error
    try:
        header = json.loads(text)
        height, width = int(header["height"]), int(header["width"])
    except (ValueError, RecursionError, OverflowError, KeyError, TypeError) as error:
        raise FileFormatError(f"{path} must hold JSON with width and height in its metadata, got {error!r}.") from error
    if height < 2 or width < 2 or len(metres) != height * width or len(rgb) != height * width:
        raise FileFormatError(
            f"{path} must hold {width} x {height} colours and depths, got {len(rgb)} and {len(metres)}."
        )
    color = np.rint(np.clip(np.nan_to_num(rgb), 0.0, 1.0) * np.float32(255.0)).astype(np.uint8)
    seen = np.isfinite(metres) & (metres > 0) & (metres < _NO_DEPTH_METRES)
    depth = np.where(seen, metres, 0.0).astype(np.float32) * np.float32(1000.0)
    color, depth = color.reshape(height, width, 3), depth.reshape(height, width)
    lens = _lens(path, header, width)
    return (header, color, depth) if lens is None else (header, *undistort(color, depth, lens))


def _lens(path: Path, header: dict[str, Any], width: int) -> LensTable | None:
    camera = header.get("camera_intrinsics")
    if not isinstance(camera, dict) or not camera.get("inverse_lens_distortion_lookup_table"):
        return None
    try:
        scale = width / float(camera["intrinsic_matrix_reference_dimensions_width"])
        centre = (camera["lens_distortion_center_x"] * scale, camera["lens_distortion_center_y"] * scale)
        return LensTable(centre, np.array(camera["inverse_lens_distortion_lookup_table"], dtype=np.float64))
    except (ValueError, OverflowError, KeyError, TypeError, ZeroDivisionError) as error:
        raise FileFormatError(f"{path} must state its lens distortion whole, got {error!r}.") from error


def _values(column: NDArray[Any] | PlyList) -> NDArray[Any]:
    if isinstance(column, PlyList):
        raise KeyError("lists")
    return column
