"""What the skin of a shot looks like, learned from its own frames before they are followed one by one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from facewright.camera.pinhole import Intrinsics
from facewright.fitting.clip_person import FrameState, KeyFrame, fit_frame, start_state
from facewright.fitting.dense_model import ClipPerson, DenseModel
from facewright.fitting.face_surface import FaceSurface
from facewright.fitting.image_term import ImageTerm, observe
from facewright.fitting.rest_appearance import RestAppearance
from facewright.landmarks.face_crops import FaceCrop

#: Frames of a shot from which its skin is learned, and the fewest.
SHOT_FRAMES, FEWEST_FRAMES = 48, 12
#: Steps of each frame by its points, and by its picture in between the two lessons.
_POINT_STEPS, _PICTURE_STEPS = 4, 2


def learn_shot(
    model: DenseModel,
    surface: FaceSurface,
    frames: Sequence[KeyFrame],
    crops: Sequence[FaceCrop],
    person: ClipPerson,
    intrinsics: Intrinsics,
) -> ImageTerm | None:
    """Learn the skin from frames as their points alone place them, place them by the skin too, and learn again.

    Parameters
    ----------
    model : DenseModel
        The model at the detector's points.
    surface : FaceSurface
        The person's skin.
    frames : sequence of KeyFrame
        Points of some of the shot's frames.
    crops : sequence of FaceCrop
        The same frames' brightness.
    person, intrinsics
        Who acts, and the camera.

    Returns
    -------
    ImageTerm or None
        None if there are too few frames to tell the skin from what it does.
    """
    if len(frames) < FEWEST_FRAMES:
        return None
    states = []
    for frame in frames:
        start = start_state(model, frame.found, person, intrinsics)
        states.append(fit_frame(model, frame.found, person, frame.terms, start, _POINT_STEPS))
    image = _learned(surface, crops, states)
    refined = [
        fit_frame(model, frame.found, person, frame.terms, state, _PICTURE_STEPS, partial(image.quadratic, crop))
        for frame, crop, state in zip(frames, crops, states, strict=True)
    ]
    return _learned(surface, crops, refined)


def _learned(surface: FaceSurface, crops: Sequence[FaceCrop], states: Sequence[FrameState]) -> ImageTerm:
    return ImageTerm(surface, RestAppearance.learned(observe(surface, list(crops), list(states))))
