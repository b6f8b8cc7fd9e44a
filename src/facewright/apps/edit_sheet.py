"""A sheet of a person with every attribute changed in steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.apps.edited_view import edited_view

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.faces.attribute_editor import AttributeEditor
    from facewright.imaging.mesh_view import MeshView

Progress = Callable[[str, int, int], None]

STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0)


def attribute_sheet(
    subject: PhotoSubject,
    editor: AttributeEditor,
    *,
    deviations: Mapping[str, float] | None = None,
    size: int = 256,
    form: str = "least change",
    progress: Progress | None = None,
) -> NDArray[np.uint8]:
    """Return one row of pictures for each attribute, from -2 to +2 standard deviations.

    Parameters
    ----------
    subject : PhotoSubject
        The person.
    editor : AttributeEditor
        Of the person's model.
    deviations : mapping of str to float, optional
        Changes that all pictures have besides.
    size : int
        Side of each picture, pixels.
    form : str
        See `AttributeEditor.change`.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        The sheet.
    """
    from facewright.imaging.contact_sheet import contact_sheet

    crop = _Crop(subject, size)
    weights = subject.fit.identity_weights
    if deviations:
        weights = editor.change(weights, deviations, form=form).weights
    middle = crop.draw(edited_view(subject, weights))
    pictures, captions = [], []
    for done, name in enumerate(editor.all_names, start=1):
        for step in STEPS:
            captions.append(f"{name} {step:+g}" if step else name)
            if step:
                changed = editor.change(weights, {name: step}, form=form).weights
                pictures.append(crop.draw(edited_view(subject, changed)))
            else:
                pictures.append(middle)
        if progress is not None:
            progress("drawing the sheet", done, len(editor.all_names))
    return contact_sheet(pictures, captions, columns=len(STEPS))


class _Crop:
    """The photo's square round the head, shrunk to `size`, and what redraws it: a sheet needs no full resolution."""

    def __init__(self, subject: PhotoSubject, size: int) -> None:
        from facewright.apps.photo_subject import followed_points
        from facewright.imaging.overlay import crop_around
        from facewright.imaging.synthesis import EDIT_OPTIONS, PhotoSynthesiser
        from facewright.landmarks.person_mask import person_finder

        face = subject.face
        start, stop = face.topology.parts["face"]
        picture, self._origin, self._zoom = crop_around(
            subject.photo, subject.source.pixels[start:stop], margin=0.18, height=size
        )
        source = self._moved(subject.source)
        self._synthesiser = PhotoSynthesiser(picture, source, face, EDIT_OPTIONS, find_person=person_finder())
        self._synthesiser.field.follow(followed_points(face))

    def draw(self, view: MeshView) -> NDArray[np.uint8]:
        """Return the square (size, size, 3) as the photo's camera would see `view`."""
        image: NDArray[np.uint8] = self._synthesiser.draw(self._moved(view)).image
        return image

    def _moved(self, view: MeshView) -> Any:
        from dataclasses import replace

        return replace(view, pixels=(view.pixels + 0.5 - self._origin) * self._zoom - 0.5)
