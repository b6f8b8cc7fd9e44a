"""Write a recording as a TUM-style folder, whole or not at all."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from facewright.capture.frame import RGBDFrame
from facewright.errors import ShapeError, ValueRangeError
from facewright.io.folder import write_folder_atomically
from facewright.io.frame_image import encode_depth
from facewright.io.image import encode_image

#: Numbers per metre of depth pictures: 0.2 mm steps up to 13.1 m, as the TUM benchmark.
DEPTH_PER_METRE = 5000.0
_NEAREST_FAR_MM = 20.0
_THREADS = 2


def write_tum_recording(
    folder: str | Path,
    frames: Iterable[RGBDFrame],
    *,
    depth_per_metre: float = DEPTH_PER_METRE,
    color_format: str = "jpeg",
    quality: int = 95,
    overwrite: bool = False,
) -> int:
    """Write frames as ``rgb/*.jpg``, ``depth/*.png`` (16 bit), ``rgb.txt``, ``depth.txt`` and ``camera.json``.

    Parameters
    ----------
    folder : str or Path
        New or empty folder; it appears when all frames are written.
    frames : iterable of RGBDFrame
        Of one camera and size, times increasing; read one after the other.
    depth_per_metre : float
        Numbers per metre; depths beyond 65534 of them are written as none.
    color_format : {"jpeg", "png"}
        JPEG reads ten times as fast; PNG keeps every bit.
    quality : int
        Of JPEG, 1 to 100.
    overwrite : bool
        Replace what the folder holds.

    Returns
    -------
    int
        Number of frames written.

    Raises
    ------
    ValueRangeError
        If there are no frames, times do not increase, cameras differ, or depths look like metres.
    ShapeError
        If sizes differ.
    StoreError
        If the folder cannot be written or holds something.
    """
    if not 0 < depth_per_metre < np.inf:
        raise ValueRangeError(f"depth_per_metre must be positive, got {depth_per_metre}.")
    suffix = "jpg" if color_format == "jpeg" else "png"
    first: RGBDFrame | None = None
    last = -np.inf
    names: list[str] = []
    waiting: deque[Future[None]] = deque()
    with write_folder_atomically(folder, overwrite=overwrite) as temporary, ThreadPoolExecutor(_THREADS) as pool:
        (temporary / "rgb").mkdir()
        (temporary / "depth").mkdir()

        def write(frame: RGBDFrame, name: str) -> None:
            (temporary / "rgb" / f"{name}.{suffix}").write_bytes(encode_image(frame.color, color_format, quality))
            counts = np.rint(frame.depth * np.float32(depth_per_metre / 1000.0))
            counts[counts >= 65535] = 0
            (temporary / "depth" / f"{name}.png").write_bytes(encode_depth(counts.astype(np.uint16)))

        for frame in frames:
            first = first or frame
            _check_frame(frame, first, last)
            last = frame.time
            names.append(f"{frame.time:.6f}")
            waiting.append(pool.submit(write, frame, names[-1]))
            while len(waiting) > 2 * _THREADS:
                waiting.popleft().result()
        for pending in waiting:
            pending.result()
        if first is None:
            raise ValueRangeError(f"frames of {folder} must be at least one, got none.")
        for kind, end in (("rgb", suffix), ("depth", "png")):
            lines = [f"# time in seconds, {kind} picture", *(f"{name} {kind}/{name}.{end}" for name in names)]
            (temporary / f"{kind}.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        camera = json.dumps(_camera(first, depth_per_metre), indent=2)
        (temporary / "camera.json").write_text(camera + "\n", encoding="utf-8")
    return len(names)


def _camera(frame: RGBDFrame, depth_per_metre: float) -> dict[str, float]:
    k = frame.intrinsics
    return {
        "width": frame.size[1],
        "height": frame.size[0],
        "fx": k.focal_x,
        "fy": k.focal_y,
        "cx": k.centre_x,
        "cy": k.centre_y,
        "depth_per_metre": depth_per_metre,
    }


def _check_frame(frame: RGBDFrame, first: RGBDFrame, last: float) -> None:
    if frame.size != first.size:
        raise ShapeError(f"frames must have one size, got {first.size} and {frame.size}.")
    if not frame.time > last + 1e-6:
        raise ValueRangeError(f"times of frames must increase, got {frame.time} s after {last} s.")
    if not np.allclose(frame.intrinsics.matrix, first.intrinsics.matrix, rtol=1e-9):
        raise ValueRangeError("frames must have one camera, got different intrinsics.")
    far = float(frame.depth.max(initial=0.0))
    if 0 < far < _NEAREST_FAR_MM:
        raise ValueRangeError(f"depth of frames must be in millimetres, got at most {far:.4g}: are these metres?")
