"""The demo's photo, changed and brought to life: attributes edited, expressions, a short film."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.animate import AnimateRequest, PhotoChoice, animate
from facewright.apps.edit_photo import edit_subject
from facewright.apps.export import demo_clip
from facewright.apps.performance_files import write_performance_csv
from facewright.apps.photo_subject import open_photo_subject
from facewright.camera.rotation import FRONTAL, rotation_from_head_angles
from facewright.faces.attribute_editor import AttributeEditor
from facewright.faces.expressions import expression_weights
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import crop_around
from facewright.io.image import write_image
from facewright.models.performance import Performance

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.landmarks.detector import LandmarkDetector
    from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]
Picture = NDArray[np.uint8]

EDITS: tuple[tuple[str, float], ...] = (
    ("face length", -2.0), ("face width", -2.0), ("mouth width", -2.0), ("nose width", -2.0), ("eye size", -2.0),
    ("face length", 2.0), ("face width", 2.0), ("mouth width", 2.0), ("nose width", 2.0), ("eye size", 2.0),
)  # fmt: skip
ACTED = ("neutral", "mouth_stretch", "lip_puckerer", "brow_raiser", "eyes_closed")
_SIDE = 300  # of a small picture, pixels
_FRAMES_PER_SECOND = 25.0
_NOD_DEGREES = 7.0


def draw_photo(
    out: Path,
    photo: Picture,
    detector: LandmarkDetector,
    model: BilinearModel,
    model_file: Path,
    progress: Progress | None,
) -> None:
    """Write ``edited.png``, ``acted.png`` and ``acting.mp4`` with its ``acting.csv`` into the demo's folder.

    Parameters
    ----------
    out : Path
        The folder.
    photo : ndarray of shape (H, W, 3), uint8
        The portrait.
    detector : LandmarkDetector
        Finds its points.
    model : BilinearModel
        The model.
    model_file : Path
        Where the model was saved.
    progress : callable, optional
        Called with stage, done, total.
    """
    subject = open_photo_subject(photo, model, detector=detector)
    write_image(out / "edited.png", _edited(subject, progress))
    write_image(out / "acted.png", _acted(subject))
    write_image(out / "portrait.png", photo)
    write_performance_csv(out / "acting.csv", acting())
    animate(
        AnimateRequest(PhotoChoice(out / "portrait.png", model=model_file), out / "acting.csv", out / "acting.mp4"),
        progress,
    )


def acting() -> Performance:
    """Return ten seconds of expressions with turns and nods of the head, at 25 frames a second."""
    from facewright.faces.blendshape_names import BLENDSHAPE_NAMES

    clip = demo_clip(BLENDSHAPE_NAMES)
    times = np.arange(int(clip.times[-1] * _FRAMES_PER_SECOND)) / _FRAMES_PER_SECOND
    keys = np.searchsorted(clip.times, times, side="right").clip(1, len(clip.times) - 1)
    share = (times - clip.times[keys - 1]) / (clip.times[keys] - clip.times[keys - 1])
    eased = (share * share * (3.0 - 2.0 * share))[:, None]
    weights = (1.0 - eased) * clip.weights[keys - 1] + eased * clip.weights[keys]
    phase = 2.0 * np.pi * times / times[-1]
    turns = zip(14.0 * np.sin(phase), _NOD_DEGREES * np.sin(3.0 * phase), strict=True)
    rotations = np.stack([rotation_from_head_angles(float(yaw), float(pitch), 0.0) for yaw, pitch in turns])
    assert np.allclose(rotations[0], FRONTAL)
    T = len(times)
    return Performance(
        times, BLENDSHAPE_NAMES, weights, rotations, np.zeros((T, 3)), np.zeros((T, 2, 2)), np.ones(T, dtype=bool)
    )


def _edited(subject: PhotoSubject, progress: Progress | None) -> Picture:
    editor = AttributeEditor.of_model(subject.fit.model)
    pictures, captions = [_cropped(subject, subject.photo)], ["the photo"]
    for k, (name, deviation) in enumerate(EDITS):
        _, synthesis = edit_subject(subject, editor, {name: deviation})
        pictures.append(_cropped(subject, synthesis.image))
        captions.append(f"{name} {deviation:+g} sd")
        if progress is not None:
            progress("editing the photo", k + 1, len(EDITS))
    half = len(EDITS) // 2  # the photo stands before each row
    order = [0, *range(1, half + 1), 0, *range(half + 1, len(EDITS) + 1)]
    return contact_sheet([pictures[k] for k in order], [captions[k] for k in order], columns=half + 1)


def _acted(subject: PhotoSubject) -> Picture:
    pictures, captions = [_cropped(subject, subject.photo)], ["the photo"]
    for name in ACTED:
        view = subject.view(subject.vertices(weights=expression_weights(name)))
        pictures.append(_cropped(subject, subject.synthesiser.draw(view).image))
        captions.append(name.replace("_", " "))
    return contact_sheet(pictures, captions, columns=len(pictures))


def _cropped(subject: PhotoSubject, picture: Picture) -> Picture:
    n_skin = subject.face.n_skin
    return crop_around(picture, subject.source.pixels[:n_skin], height=_SIDE, margin=0.12)[0]
