"""How fast a clip is carried to a photo, from the video file to the written video, as a user runs it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

#: Frames of the clip that is carried first, so that everything is compiled and loaded.
_WARM_UP = 30


def retarget_speed(
    images: NDArray[np.uint8], frames_per_second: float, model: BilinearModel, progress: Progress | None = None
) -> dict[str, float]:
    """Carry a clip to scikit-image's astronaut, 640 x 480, with `facewright.apps.retarget`.

    Parameters
    ----------
    images : ndarray of shape (T, H, W, 3), uint8
        The clip.
    frames_per_second : float
        Its rate.
    model : BilinearModel
        The model.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    dict of str to float
        ``fps``, frames a second from end to end on this machine's cores as they are, decoding, detector, fit, drawing
        and encoding included, without the start (loading the model, opening the photo, compilation); and of the parts,
        milliseconds a frame by the clock, ``retarget_detect_ms``, ``retarget_fit_ms``, ``retarget_draw_ms``. Empty
        where scikit-image is not installed.
    """
    try:
        from skimage import data
    except ImportError:
        return {}
    from PIL import Image

    from facewright.apps.animate import PhotoChoice
    from facewright.apps.retarget import RetargetRequest, retarget
    from facewright.apps.track_video import VideoChoice
    from facewright.models.bilinear_store import save_bilinear

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        photo, stored = folder / "photo.png", folder / "model.fwbm"
        Image.fromarray(data.astronaut()).resize((640, 640), Image.Resampling.LANCZOS).crop((0, 0, 640, 480)).save(
            photo
        )
        save_bilinear(model, stored)
        for name, part in (("warm-up", images[:_WARM_UP]), ("clip", images)):
            video = folder / f"{name}.mp4"
            _write(video, part, frames_per_second)
            choice = PhotoChoice(photo, model=stored)
            request = RetargetRequest(VideoChoice(video), choice, folder / f"{name}-retargeted.mp4")
            numbers = retarget(request, progress).numbers
    parts = {f"retarget_{part}_ms": float(numbers[f"{part}_ms"]) for part in ("detect", "fit", "draw")}
    return {"fps": float(numbers["fps"])} | parts


def _write(path: Path, images: NDArray[np.uint8], frames_per_second: float) -> None:
    from facewright.io.video_writer import FrameClock, VideoWriter

    clock = FrameClock(np.arange(len(images)) / frames_per_second, Fraction(frames_per_second))
    with VideoWriter(path, images.shape[2], images.shape[1], clock) as writer:
        for image in images:
            writer.write(image)
