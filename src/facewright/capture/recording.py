"""A recording of a depth camera, whatever wrote it: a stream of frames on one pixel grid, in millimetres."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.capture.camera_file import camera_path, read_camera_file
from facewright.capture.depth_units import depth_factor
from facewright.capture.frame import RGBDFrame
from facewright.capture.quarter_turns import check_quarter_turns, turn_intrinsics, turn_picture, turn_size
from facewright.errors import FileFormatError, StoreError, ValueRangeError

_N_SAMPLED = 3
_MAX_ASPECT_ERROR = 0.02
_READ_AHEAD = 2


class FrameSource(Protocol):
    """What a reader of one kind of recording gives; `Recording` does the rest."""

    kind: str
    n_frames: int
    warnings: tuple[str, ...]

    def depth(self, i: int) -> NDArray[np.floating]:
        """Return depth (H, W) of frame `i`, millimetres as far as the file says; any value where there is none."""
        ...

    def color(self, i: int) -> NDArray[np.uint8]:
        """Return colour (H', W', 3) of frame `i`; the same view, perhaps on a finer or coarser grid."""
        ...

    def intrinsics(self, i: int) -> Intrinsics | None:
        """Return the camera of frame `i`'s depth grid, or None where the file does not say."""
        ...

    def time(self, i: int) -> float:
        """Return the time of frame `i`, seconds."""
        ...


@dataclass(frozen=True, eq=False)
class Recording:
    """An RGB-D recording; made by `open_recording`. Frames are read when they are asked for.

    Parameters
    ----------
    path : Path
        File or folder.
    kind : str
        ``"tum"``, ``"record3d"``, ``"truedepth"``, ``"realsense"`` or ``"azure"``.
    n_frames : int
        Number of frames.
    size : (height, width)
        Of every frame, turned.
    intrinsics : Intrinsics
        Of the first frame, turned.
    warnings : tuple of str
        Sentences for the user, such as that depths were in metres.
    quarter_turns : int
        Counter-clockwise quarter turns by which frames are turned after they are read.
    """

    path: Path
    kind: str
    n_frames: int
    size: tuple[int, int]
    intrinsics: Intrinsics
    warnings: tuple[str, ...]
    quarter_turns: int
    _source: FrameSource
    _factor: float
    _intrinsics_given: Intrinsics | None

    def frame(self, i: int) -> RGBDFrame:
        """Return frame `i`, counted from 0.

        Raises
        ------
        ValueRangeError
            If there is no such frame.
        FileFormatError, StoreError
            If its files are damaged, missing or of another size than the first frame's.
        """
        if not 0 <= i < self.n_frames:
            raise ValueRangeError(f"frame of {self.path} must be in [0, {self.n_frames}), got {i}.")
        depth = clean_depth(self._source.depth(i))
        stored = turn_size(self.size, self.quarter_turns)
        if depth.shape != stored:
            raise FileFormatError(
                f"{self.path} must have frames of one size, {stored[1]} x {stored[0]}, got frame {i} of "
                f"{depth.shape[1]} x {depth.shape[0]}."
            )
        if self._factor != 1.0:
            depth *= np.float32(self._factor)
        color = on_grid(self._source.color(i), stored, f"colour of frame {i} of {self.path}")
        k = self._intrinsics_given or self._source.intrinsics(i)
        assert k is not None
        turns = self.quarter_turns
        return RGBDFrame(
            turn_picture(color, turns),
            turn_picture(depth, turns),
            turn_intrinsics(k, stored, turns),
            self._source.time(i),
        )

    def frames(self) -> Iterator[RGBDFrame]:
        """Read all frames in order; a thread decodes the next two meanwhile, and no more are in memory.

        Raises
        ------
        FileFormatError, StoreError
            When a damaged frame is reached, see `frame`.
        """
        with ThreadPoolExecutor(max_workers=1, thread_name_prefix="frames") as pool:
            ahead: deque[Future[RGBDFrame]] = deque()
            try:
                for i in range(self.n_frames + _READ_AHEAD):
                    if i < self.n_frames:
                        ahead.append(pool.submit(self.frame, i))
                    if i >= _READ_AHEAD:
                        yield ahead.popleft().result()
            finally:
                for waiting in ahead:
                    waiting.cancel()


def open_recording(
    path: str | Path,
    *,
    intrinsics: Intrinsics | None = None,
    quarter_turns: int | None = None,
    depth_per_metre: float | None = None,
) -> Recording:
    """Open a recording of a depth camera; its kind is told from its name and contents.

    Parameters
    ----------
    path : str or Path
        A folder like those of the TUM RGB-D benchmark (``rgb``, ``depth``, ``camera.json``), a folder of Standard
        Cyborg TrueDepth ``.ply`` frames, or a Record3D ``.r3d``, RealSense ``.bag`` or Azure Kinect ``.mkv`` file.
    intrinsics : Intrinsics, optional
        Camera of the depth pictures as stored (before turning); wins over what the recording says.
    quarter_turns : int, optional
        Turn every frame counter-clockwise by so many quarter turns, for heads that lie on their side; by default what
        the recording's ``camera.json`` says, else 0.
    depth_per_metre : float, optional
        Numbers per metre of stored depth pictures, for TUM folders that do not say it.

    Returns
    -------
    Recording
        Ready to read; first, middle and last frame's depth were looked at to tell the unit.

    Raises
    ------
    StoreError
        If it does not exist or cannot be read.
    FileFormatError
        If it is of no known kind, damaged, without depth or without intrinsics.
    MissingExtraError
        If its kind needs a package that is not installed.
    """
    path = Path(path)
    source = _open_source(path, depth_per_metre)
    camera = read_camera_file(path)
    turns = check_quarter_turns((camera.quarter_turns or 0) if quarter_turns is None else quarter_turns)
    intrinsics = intrinsics or camera.intrinsics
    if source.n_frames < 1:
        raise FileFormatError(f"{path} must hold at least one frame, got none.")
    sampled = sorted({0, source.n_frames // 2, source.n_frames - 1})[:_N_SAMPLED]
    depths = [clean_depth(source.depth(i)) for i in sampled]
    if not any(d.any() for d in depths):  # a camera may lose sight for a while
        depths = [d for i in range(source.n_frames) if (d := clean_depth(source.depth(i))).any()][:_N_SAMPLED]
    factor, sentence = depth_factor(depths, str(path))
    size = (depths[0].shape[0], depths[0].shape[1])
    first = intrinsics or source.intrinsics(0)
    if first is None:
        raise FileFormatError(
            f"{path} must say its camera's intrinsics, got none: add {camera_path(path)} with width, height, fx, fy, "
            "cx, cy (pixels of the depth pictures)."
        )
    _check_intrinsics(first, size, path)
    return Recording(
        path=path,
        kind=source.kind,
        n_frames=source.n_frames,
        size=turn_size(size, turns),
        intrinsics=turn_intrinsics(first, size, turns),
        warnings=source.warnings + ((sentence,) if sentence else ()),
        quarter_turns=turns,
        _source=source,
        _factor=factor,
        _intrinsics_given=intrinsics,
    )


def clean_depth(depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return a float32 copy of a depth picture in which NaN, infinite and negative values are 0."""
    values = np.array(depth, dtype=np.float32)
    values[~(np.isfinite(values) & (values > 0))] = 0.0
    return values


def on_grid(color: NDArray[np.uint8], size: tuple[int, int], name: str) -> NDArray[np.uint8]:
    """Bring a colour picture of the same view to the grid of the depth, by area.

    Raises
    ------
    FileFormatError
        If its sides have another ratio: it cannot be the same view.
    """
    height, width = color.shape[:2]
    if (height, width) == size:
        return color
    if abs(width * size[0] / (height * size[1]) - 1.0) > _MAX_ASPECT_ERROR:
        raise FileFormatError(
            f"{name} must have the size of the depth, {size[1]} x {size[0]}, or one of the same ratio, "
            f"got {width} x {height}."
        )
    from PIL import Image

    method = Image.Resampling.BOX if width > size[1] else Image.Resampling.BILINEAR
    return np.asarray(Image.fromarray(color).resize((size[1], size[0]), method))


def _check_intrinsics(intrinsics: Intrinsics, size: tuple[int, int], path: Path) -> None:
    height, width = size
    inside = 0 < intrinsics.centre_x < width and 0 < intrinsics.centre_y < height
    if not inside or not 0.2 * width < intrinsics.focal_x < 20.0 * width:
        raise FileFormatError(
            f"{path} must have intrinsics of its depth pictures, {width} x {height}, got focal length "
            f"{intrinsics.focal_x:.6g} and principal point ({intrinsics.centre_x:.6g}, {intrinsics.centre_y:.6g})."
        )


def _open_source(path: Path, depth_per_metre: float | None) -> FrameSource:
    if not path.exists():
        raise StoreError(f"{path} does not exist.")
    kind = recording_kind(path)
    if kind == "tum":
        from facewright.capture.tum import TumSource

        return TumSource(path, depth_per_metre)
    if kind == "truedepth":
        from facewright.capture.truedepth import TrueDepthSource

        return TrueDepthSource(path)
    if kind == "record3d":
        from facewright.capture.record3d import Record3DSource

        return Record3DSource(path)
    if kind in ("realsense", "azure"):
        from facewright.capture.open3d_sensors import open_open3d_source

        return open_open3d_source(path, kind)
    raise FileFormatError(
        f"{path} must be a recording of a depth camera: a folder with rgb and depth, a folder of TrueDepth .ply "
        "frames, or a .r3d, .bag or .mkv file."
    )


#: Suffixes of recordings that are one file.
FILE_KINDS = {".r3d": "record3d", ".bag": "realsense", ".mkv": "azure"}


def recording_kind(path: Path) -> str | None:
    """Tell the kind of recording from names alone, or return None."""
    if not path.is_dir():
        return FILE_KINDS.get(path.suffix.lower())
    try:
        names = {entry.name for entry in path.iterdir()}
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
    if names & {"depth", "depth.txt", "associations.txt", "associate.txt"}:
        return "tum"
    if any(name.lower().endswith(".ply") for name in names):
        return "truedepth"
    return "tum" if names & {"rgb", "rgb.txt", "camera.json"} else None
