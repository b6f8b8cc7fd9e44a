"""A photo with its person's attributes changed: a longer face, a wider mouth (FaceWarehouse 4.1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.default_model import model_or_default
from facewright.apps.edited_view import edited_view
from facewright.errors import ValueRangeError

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.faces.attribute_editor import AttributeEdit, AttributeEditor
    from facewright.imaging.synthesis import Synthesis

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class EditRequest:
    """What to change, and where to write.

    Parameters
    ----------
    photo : Path
        The photograph, of any common format.
    deviations : mapping of str to float
        Change of each attribute in standard deviations of the population, -4 to 4, such as ``{"face length": 1.5}``.
    out : Path, optional
        The picture to write: PNG, JPEG, WebP or TIFF by its suffix; same size as the photo.
    sheet : Path, optional
        Where to write a sheet of every attribute at -2 to +2.
    model : Path, optional
        Model file; the default model where absent, see `facewright.apps.default_model`.
    face_index : int
        Which of the faces found, the largest being 0.
    landmarks : Path, optional
        Points file; its points win over detected ones.
    task_file : Path, optional
        MediaPipe ``face_landmarker.task`` file.
    focal_length : float, optional
        Pixels; from the EXIF data, or estimated, where absent.
    form : str
        ``"least change"`` or ``"regression"``, see `facewright.faces.attribute_editor.AttributeEditor.change`.
    """

    photo: Path
    deviations: Mapping[str, float] = field(default_factory=dict)
    out: Path | None = None
    sheet: Path | None = None
    model: Path | None = None
    face_index: int = 0
    landmarks: Path | None = None
    task_file: Path | None = None
    focal_length: float | None = None
    form: str = "least change"

    def __post_init__(self) -> None:
        if self.out is None and self.sheet is None:
            raise ValueRangeError("out or sheet must be given, got neither.")
        if not self.deviations and self.out is not None:
            raise ValueRangeError("deviations must name at least one attribute to change, got none.")
        for path in (self.out, self.sheet):
            if path is not None and path.exists() and self.photo.exists() and path.samefile(self.photo):
                raise ValueRangeError(f"the result must be written to another file than the photo, got {path}.")
        if self.out is not None and self.out == self.sheet:
            raise ValueRangeError(f"out and sheet must be two files, got {self.out} for both.")


@dataclass(frozen=True, eq=False)
class EditResult:
    """An edited photo.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8, or None
        The picture, where attributes were changed.
    edit : AttributeEdit or None
        Attributes before and after, as measured on the fitted face.
    smallest_jacobian : float or None
        Of the picture's map: positive where nothing folds.
    paths : mapping of str to Path
        ``picture``, ``sheet``: what was written.
    remarks : tuple of str
        What a user should know: sentences.
    """

    image: NDArray[np.uint8] | None
    edit: AttributeEdit | None
    smallest_jacobian: float | None
    paths: dict[str, Path]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class AttributeSummary:
    """An attribute of a model.

    Parameters
    ----------
    name, meaning : str
        What it is called, and what it is.
    unit : str
        ``mm``, or empty for labels.
    mean, standard_deviation : float
        Over the model's people.
    r_squared : float
        Share of its variance over people that identity weights predict for people left out.
    also : mapping of str to float
        How much each other measured attribute changes, in its standard deviations, with 1 of this one: leakage.
    n_people : int
        People it was learned from.
    """

    name: str
    meaning: str
    unit: str
    mean: float
    standard_deviation: float
    r_squared: float
    also: Mapping[str, float]
    n_people: int


def edit_photo(request: EditRequest, progress: Progress | None = None) -> EditResult:
    """Change attributes of the person in a photo.

    Parameters
    ----------
    request : EditRequest
        Photo, changes and files.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    EditResult
        What changed, and the files written; each whole or not at all.

    Raises
    ------
    ValueRangeError
        If an attribute is unknown (the message names the nearest) or a value is beyond 4 standard deviations.
    NoFaceError, DegenerateError, FileFormatError, StoreError, MissingExtraError, MissingFaceError
        See `facewright.apps.photo_subject.open_photo_subject`.

    Notes
    -----
    FaceWarehouse 4.1: changes of attributes become changes of identity weights (eq. 11-12), these a new mesh
    (eq. 10), and the photo is redrawn for it.
    """
    from facewright.apps.photo_subject import open_photo_subject
    from facewright.faces.attribute_editor import AttributeEditor, check_deviations
    from facewright.io.image import PhotoFile, check_picture_suffix, write_image, write_photo
    from facewright.landmarks.files import read_landmarks

    for path in (request.out, request.sheet):
        if path is not None:
            check_picture_suffix(path)
    model = model_or_default(request.model, progress)
    editor = AttributeEditor.of_model(model)
    check_deviations(request.deviations, editor.all_names)  # before the work
    subject = open_photo_subject(
        request.photo,
        model,
        face_index=request.face_index,
        landmarks=None if request.landmarks is None else read_landmarks(request.landmarks),
        task_file=request.task_file,
        focal_length=request.focal_length,
        progress=progress,
    )
    edit = synthesis = None
    paths: dict[str, Path] = {}
    if request.out is not None:
        edit, synthesis = edit_subject(subject, editor, request.deviations, form=request.form)
        write_photo(request.out, synthesis.image, PhotoFile(subject.photo, subject.alpha))
        paths["picture"] = request.out
    if request.sheet is not None:
        from facewright.apps.edit_sheet import attribute_sheet

        pictures = attribute_sheet(subject, editor, deviations=request.deviations, form=request.form, progress=progress)
        write_image(request.sheet, pictures)
        paths["sheet"] = request.sheet
    return EditResult(
        None if synthesis is None else synthesis.image,
        edit,
        None if synthesis is None else synthesis.smallest_jacobian,
        paths,
        subject.remarks,
    )


def edit_subject(
    subject: PhotoSubject, editor: AttributeEditor, deviations: Mapping[str, float], *, form: str = "least change"
) -> tuple[AttributeEdit, Synthesis]:
    """Change attributes of a photo's person and redraw the photo.

    Parameters
    ----------
    subject : PhotoSubject
        The person.
    editor : AttributeEditor
        Of the person's model.
    deviations, form
        See `AttributeEditor.change`.

    Returns
    -------
    edit : AttributeEdit
        Attributes before and after.
    synthesis : Synthesis
        The redrawn photo.
    """
    edit = editor.change(subject.fit.identity_weights, deviations, form=form)
    return edit, subject.edit_synthesiser.draw(edited_view(subject, edit.weights))


def list_attributes(model: Path | None = None, progress: Progress | None = None) -> list[AttributeSummary]:
    """Return what can be changed with a model, and how well it is known.

    Parameters
    ----------
    model : Path, optional
        Model file; the default model where absent.
    progress : callable, optional
        Called with stage, done, total while a default model is built.

    Raises
    ------
    FileFormatError, StoreError
        If the model cannot be read.
    """
    from facewright.faces.attribute_editor import AttributeEditor
    from facewright.faces.attributes import ATTRIBUTE_MEANINGS

    editor = AttributeEditor.of_model(model_or_default(model, progress))
    leakage = editor.leakage()
    summaries = []
    for k, name in enumerate(editor.names):
        also = {other: float(leakage[k, j]) for j, other in enumerate(editor.names) if j != k}
        summaries.append(
            AttributeSummary(
                name,
                ATTRIBUTE_MEANINGS[name],
                "mm",
                float(editor.mean[k]),
                float(editor.standard_deviation[k]),
                float(editor.r_squared[k]),
                also,
                editor.n_people,
            )
        )
    for label in editor.label_attributes:
        summaries.append(
            AttributeSummary(
                label.name,
                "as the people are labelled",
                "",
                label.mean,
                label.standard_deviation,
                label.r_squared,
                {},
                label.n_people,
            )
        )
    return summaries
