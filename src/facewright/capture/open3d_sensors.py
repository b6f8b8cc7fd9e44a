"""RealSense (.bag) and Azure Kinect (.mkv) recordings, played back by Open3D where its build can."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import FileFormatError, MissingExtraError, StoreError

_INSTALL = 'pip install "facewright[capture]"'
_MAX_FRAMES = 18_000  # ten minutes at 30 Hz


class SensorFrame(NamedTuple):
    """What a sensor's playback gives: colour (H, W, 3) uint8, depth counts (H, W) uint16 on one grid, seconds."""

    color: NDArray[np.uint8]
    counts: NDArray[np.uint16]
    time: float


class SpooledSource:
    """Frames that could be played back only once and in order, kept in a temporary file.

    Playback drops frames where its reader is slow and cannot step back; the file holds each frame's colour and depth
    as they are, so that memory stays flat. It has no name and is gone when the source is.

    Parameters
    ----------
    kind : str
        ``"realsense"`` or ``"azure"``.
    path : Path
        The recording, for messages.
    frames : iterable of SensorFrame
        Read once, here.
    intrinsics : Intrinsics or None
        Of all frames.
    counts_per_metre : float
        Depth counts per metre.

    Raises
    ------
    FileFormatError
        If there are no frames or their sizes differ.
    StoreError
        If the disk for temporary files is full.
    """

    def __init__(
        self,
        kind: str,
        path: Path,
        frames: Iterable[SensorFrame],
        intrinsics: Intrinsics | None,
        counts_per_metre: float,
    ) -> None:
        self.kind = kind
        self.warnings: tuple[str, ...] = ()
        self._camera, self._to_mm = intrinsics, np.float32(1000.0 / counts_per_metre)
        self._times: list[float] = []
        self._size = (0, 0)
        self._file = tempfile.TemporaryFile(prefix="facewright-")  # noqa: SIM115  closed with the source
        try:
            for frame in frames:
                self._append(frame, path)
            self._file.flush()
        except OSError as error:
            if isinstance(error, StoreError):
                raise
            raise StoreError(
                f"{path} cannot be unpacked in {tempfile.gettempdir()}: {error.strerror or error}."
            ) from error
        self.n_frames = len(self._times)
        if not self.n_frames:
            raise FileFormatError(f"{path} must hold colour and depth frames that belong together, got none.")
        height, width = self._size
        row = np.dtype([("color", np.uint8, (height, width, 3)), ("counts", np.uint16, (height, width))])
        self._rows = np.memmap(self._file, dtype=row, mode="r", shape=(self.n_frames,))

    def depth(self, i: int) -> NDArray[np.floating]:
        """Return depth in millimetres."""
        return self._rows[i]["counts"] * self._to_mm

    def color(self, i: int) -> NDArray[np.uint8]:
        """Return colour."""
        return np.array(self._rows[i]["color"])

    def intrinsics(self, i: int) -> Intrinsics | None:
        """Return the camera, the same for all frames."""
        return self._camera

    def time(self, i: int) -> float:
        """Return the frame's time."""
        return self._times[i]

    def _append(self, frame: SensorFrame, path: Path) -> None:
        height, width = frame.counts.shape
        if frame.color.shape != (height, width, 3) or (self._times and (height, width) != self._size):
            raise FileFormatError(
                f"{path} must have colour and depth of one size, got {frame.color.shape[:2]} and {frame.counts.shape}."
            )
        if len(self._times) >= _MAX_FRAMES:
            raise FileFormatError(f"{path} must have at most {_MAX_FRAMES} frames, got more.")
        self._size = (height, width)
        self._file.write(np.ascontiguousarray(frame.color, dtype=np.uint8).tobytes())
        self._file.write(np.ascontiguousarray(frame.counts, dtype=np.uint16).tobytes())
        self._times.append(frame.time)


def open_open3d_source(path: Path, kind: str) -> SpooledSource:
    """Play a ``.bag`` ("realsense") or ``.mkv`` ("azure") recording back through Open3D.

    Raises
    ------
    MissingExtraError
        If Open3D is not installed, or its build lacks the sensor's library.
    FileFormatError
        If the file is no such recording or holds no frames.
    """
    if path.stat().st_size == 0:
        raise FileFormatError(f"{path} must be a recording, got an empty file.")
    o3d = _import_open3d()
    with _quiet(o3d):
        return _realsense(o3d, path) if kind == "realsense" else _azure(o3d, path)


def _import_open3d() -> Any:
    try:
        import open3d
    except ImportError as error:
        raise MissingExtraError(f"reading .bag and .mkv needs the open3d package: {_INSTALL}.") from error
    return open3d


def _quiet(o3d: Any) -> Any:
    return o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error)


def _realsense(o3d: Any, path: Path) -> SpooledSource:
    """Colour and depth come aligned to the colour camera; depth as counts of `depth_scale` to the metre."""
    if not hasattr(o3d.t.io, "RSBagReader"):
        raise MissingExtraError(f"{path} needs an Open3D that was built with RealSense, this one was not: {_INSTALL}.")
    reader = o3d.t.io.RSBagReader()
    opened = False
    with suppress(RuntimeError):
        opened = reader.open(str(path))
    if not opened:
        raise FileFormatError(f"{path} must be a RealSense recording (rosbag), got one that is corrupt or foreign.")
    meta = reader.metadata
    k = np.asarray(meta.intrinsics.intrinsic_matrix, dtype=np.float64)
    frames = _realsense_frames(reader)
    return SpooledSource(
        "realsense", path, frames, Intrinsics(k[0, 0], k[1, 1], k[0, 2], k[1, 2]), float(meta.depth_scale)
    )


def _realsense_frames(reader: Any) -> Iterator[SensorFrame]:
    try:
        while True:
            pair = reader.next_frame()
            if reader.is_eof() or pair.is_empty():
                return
            color, counts = np.asarray(pair.color.to_legacy()), np.asarray(pair.depth.to_legacy())
            yield SensorFrame(color, counts.astype(np.uint16), reader.get_timestamp() * 1e-6)
    finally:
        reader.close()


def _azure(o3d: Any, path: Path) -> SpooledSource:
    """Depth comes in millimetres, aligned to the colour camera; its intrinsics stand in the file's calibration."""
    if not hasattr(o3d.io, "AzureKinectMKVReader"):
        raise MissingExtraError(
            f"{path} needs an Open3D that was built with Azure Kinect, this one was not: {_INSTALL}."
        )
    reader = o3d.io.AzureKinectMKVReader()
    try:
        opened = reader.open(str(path))
    except RuntimeError as error:
        if "libk4a" in str(error) or "Cannot load" in str(error):
            raise MissingExtraError(
                f"{path} needs Microsoft's Azure Kinect library (libk4arecord), which was not found: install it, or "
                "convert the recording to a TUM folder."
            ) from error
        opened = False
    if not opened:
        raise FileFormatError(f"{path} must be an Azure Kinect recording, got a file that is corrupt or foreign.")
    return SpooledSource("azure", path, _azure_frames(reader), azure_intrinsics(path, reader, o3d), 1000.0)


def azure_intrinsics(path: Path, reader: Any, o3d: Any) -> Intrinsics | None:
    """Return the colour camera of an Azure Kinect recording, or None where Open3D does not tell.

    Open3D gives the calibration only as the JSON that its metadata object writes, the matrix column after column.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "calibration.json"
        if not o3d.io.write_azure_kinect_mkv_metadata(str(file), reader.get_metadata()):
            return None
        try:
            m = json.loads(file.read_bytes())["intrinsic_matrix"]
            return Intrinsics(float(m[0]), float(m[4]), float(m[6]), float(m[7])) if m[0] != 1.0 else None
        except (ValueError, OverflowError, KeyError, TypeError, IndexError) as error:
            raise FileFormatError(f"{path} must state its colour camera, got {error!r}.") from error


def _azure_frames(reader: Any, frames_per_second: float = 30.0) -> Iterator[SensorFrame]:
    n = 0
    try:
        while not reader.is_eof():
            pair = reader.next_frame()
            if pair is not None:  # the playback leaves out captures without colour or depth
                yield SensorFrame(np.asarray(pair.color), np.asarray(pair.depth), n / frames_per_second)
            n += 1
    finally:
        reader.close()
