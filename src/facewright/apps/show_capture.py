"""Look at a recording of a depth camera: its facts, and a sheet of its colour and depth pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError

if TYPE_CHECKING:
    from facewright.capture.frame import RGBDFrame
    from facewright.capture.recording import Recording

Progress = Callable[[str, int, int], None]

_TILE_HEIGHT = 240
_MAX_COLUMNS = 6
_BEHIND_MM = 350.0
# near to far; dark violet is farther than a head is deep
_RAMP = np.array([[252, 253, 191], [254, 159, 109], [222, 73, 104], [140, 41, 129], [59, 15, 112], [24, 12, 44]])


@dataclass(frozen=True)
class ShowCaptureRequest:
    """Which recording to look at.

    Parameters
    ----------
    recording : Path
        File or folder, see `facewright.capture.recording.open_recording`.
    out : Path, optional
        Picture to write.
    n_frames : int
        Frames on the sheet, spread evenly.
    quarter_turns : int, optional
        Counter-clockwise turns; by default as the recording's camera file says.
    save_turn : bool
        Note the turns in the recording's camera file.
    """

    recording: Path
    out: Path | None = None
    n_frames: int = 8
    quarter_turns: int | None = None
    save_turn: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.n_frames <= 100:
            raise ValueRangeError(f"n_frames must be in [1, 100], got {self.n_frames}.")
        if self.save_turn and self.quarter_turns is None:
            raise ValueRangeError("save_turn must come with quarter_turns, got none.")


def show_capture(request: ShowCaptureRequest, progress: Progress | None = None) -> dict[str, Any]:
    """Return a recording's facts as JSON values, and write its sheet if one is asked for.

    Every frame is read, so that damaged ones are found.

    Raises
    ------
    StoreError, FileFormatError, MissingExtraError
        If the recording cannot be read.
    """
    from facewright.capture.camera_file import save_quarter_turns
    from facewright.capture.recording import open_recording
    from facewright.io.image import write_image

    recording = open_recording(request.recording, quarter_turns=request.quarter_turns)
    wanted = set(np.linspace(0, recording.n_frames - 1, min(request.n_frames, recording.n_frames)).round().astype(int))
    shown: list[tuple[int, RGBDFrame]] = []
    seen, near, times = [], [], []
    for i, frame in enumerate(recording.frames()):
        valid = frame.depth[frame.depth > 0]
        seen.append(valid.size / frame.depth.size)
        near.append(float(np.percentile(valid, 5)) if valid.size else np.nan)
        times.append(frame.time)
        if i in wanted:
            shown.append((i, frame))
        if progress is not None:
            progress("reading frames", i + 1, recording.n_frames)
    if request.save_turn and request.quarter_turns is not None:
        save_quarter_turns(request.recording, request.quarter_turns)
    facts = _facts(recording, times, seen, near)
    if request.out is not None:
        write_image(request.out, recording_sheet(shown, float(np.nanmedian(near))))
        facts["picture"] = str(request.out)
    return facts


def depth_picture(depth: NDArray[np.floating], near: float, far: float) -> NDArray[np.uint8]:
    """Return a colour picture (H, W, 3) of depth (H, W), mm: light is near, dark is far, black is none.

    Every 10 mm the brightness jumps a little, so that shape shows.
    """
    place = np.clip((depth - near) / max(far - near, 1.0), 0.0, 1.0) * (len(_RAMP) - 1)
    ramp = np.stack([np.interp(place, np.arange(len(_RAMP)), _RAMP[:, c]) for c in range(3)], axis=-1)
    ramp *= 1.0 - 0.18 * ((depth % 10.0) / 10.0)[..., None]
    ramp[depth <= 0] = 0.0
    return np.rint(ramp).astype(np.uint8)


def recording_sheet(frames: list[tuple[int, RGBDFrame]], near: float) -> NDArray[np.uint8]:
    """Lay frames out as pairs of colour and depth, one above the other, with their numbers and times."""
    from PIL import Image

    from facewright.imaging.contact_sheet import contact_sheet

    tiles, captions = [], []
    first = frames[0][1].time
    for i, frame in frames:
        height, width = frame.size
        shape = (max(round(width * _TILE_HEIGHT / height), 1), _TILE_HEIGHT)
        depth = depth_picture(frame.depth, near, near + _BEHIND_MM)
        color = Image.fromarray(frame.color).resize(shape, Image.Resampling.LANCZOS)
        below = Image.fromarray(depth).resize(shape, Image.Resampling.NEAREST)
        tiles.append(np.concatenate([np.asarray(color), np.asarray(below)]))
        captions.append(f"{i}: {frame.time - first:.2f} s")
    rows = -(-len(tiles) // _MAX_COLUMNS)
    return contact_sheet(tiles, captions, columns=-(-len(tiles) // rows))


def _facts(recording: Recording, times: list[float], seen: list[float], near: list[float]) -> dict[str, Any]:
    k = recording.intrinsics
    return {
        "path": str(recording.path),
        "kind": recording.kind,
        "frames": recording.n_frames,
        "seconds": times[-1] - times[0],
        "width": recording.size[1],
        "height": recording.size[0],
        "focal_x": k.focal_x,
        "focal_y": k.focal_y,
        "centre_x": k.centre_x,
        "centre_y": k.centre_y,
        "quarter_turns": recording.quarter_turns,
        "nearest_mm": float(np.nanmedian(near)),
        "depth_share": float(np.mean(seen)),
        "depth_share_least": float(np.min(seen)),
        "warnings": list(recording.warnings),
    }
