"""A face component of one photo carried into another of the same person (FaceWarehouse 4.2; Yang et al. 2011)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.default_model import model_or_default
from facewright.errors import TopologyError, ValueRangeError
from facewright.imaging.component_mask import COMPONENTS, component_freedom, component_level, component_shapes
from facewright.imaging.mesh_view import MeshView
from facewright.landmarks.points import interocular_distance
from facewright.numeric.check import check_choice

if TYPE_CHECKING:
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.faces.face import Face
    from facewright.fitting.image import PhotoFit

Progress = Callable[[str, int, int], None]

_STAGES = 6
_LEAST_SEEN = 0.5  # of the component, that the reference must show
# What sharing an identity may cost where there are only 74 points to go by, as the sum of squared distances of all of
# them by the inter-ocular distance: of pairs of one simulated person 19 in 20 stay below, of pairs of two 7 in 8 lie
# above, by true landmarks with noise.
_TWO_PEOPLE = 0.009
_OTHER_SIDE_DEGREES = 15.0  # a nose seen from so far aside shows other nostrils and other wings
_PLURAL = ("eyes", "brows")
_STILL_MM = 1e-6  # what is less is rounding: a photo's own component moves nothing
_MARGIN = 0.15  # round the face's skin, as a share of its size: what the blend may look at


@dataclass(frozen=True)
class TransferRequest:
    """What to carry over and where to write.

    Parameters
    ----------
    target : Path
        Photo that is changed.
    reference : Path
        Photo of the same person with the wanted expression.
    component : str
        One of `facewright.imaging.component_mask.COMPONENTS`.
    out : Path
        Picture to write, of the target's size.
    model : Path, optional
        Model file; the default one where absent.
    target_face, reference_face : int
        Which of the faces found, the largest being 0.
    target_landmarks, reference_landmarks : Path, optional
        Points files; their points win over detected ones.
    task_file : Path, optional
        See `facewright.landmarks.detector.open_detector`.
    """

    target: Path
    reference: Path
    component: str
    out: Path
    model: Path | None = None
    target_face: int = 0
    reference_face: int = 0
    target_landmarks: Path | None = None
    reference_landmarks: Path | None = None
    task_file: Path | None = None

    def __post_init__(self) -> None:
        from facewright.io.image import check_picture_suffix

        check_choice("component", self.component, COMPONENTS)
        check_picture_suffix(self.out)


@dataclass(frozen=True, eq=False)
class Transfer:
    """A component carried over.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        The target with the reference's component; equal to the last bit where not `touched`.
    touched : ndarray of shape (H, W), bool
        Pixels that may differ from the target.
    mask : ndarray of shape (H, W), bool
        Pixels that come from the reference.
    warped : ndarray of shape (H, W, 3), uint8
        The target after the expression flow.
    aligned : ndarray of shape (H, W, 3), uint8
        The reference after the alignment flow; black where it shows nothing of the target's face.
    weights : ndarray of shape (B,)
        FACS coefficients of the new expression.
    remarks : tuple of str
        What a user should know: sentences.
    """

    image: NDArray[np.uint8]
    touched: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    warped: NDArray[np.uint8]
    aligned: NDArray[np.uint8]
    weights: NDArray[np.float64]
    remarks: tuple[str, ...]


def transfer_component(request: TransferRequest, progress: Progress | None = None) -> Transfer:
    """Carry a component of one photo into another and write the picture.

    Parameters
    ----------
    request : TransferRequest
        Photos, component and file.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    Transfer
        The picture, which is written whole or not at all.

    Raises
    ------
    NoFaceError, DegenerateError, ValueRangeError, FileFormatError, StoreError, MissingExtraError, MissingFaceError
        See `facewright.apps.photo_subject.open_photo_subject`; also where the reference hides the component.
    """
    from facewright.apps.photo_subject import open_photo_subject
    from facewright.io.image import PhotoFile, read_focal_length, write_photo
    from facewright.landmarks.files import read_landmarks

    report = _reporter(progress)
    report("reading the model", 0)
    model = model_or_default(request.model, progress)
    subjects = []
    for k, (photo, face, points) in enumerate(
        (
            (request.target, request.target_face, request.target_landmarks),
            (request.reference, request.reference_face, request.reference_landmarks),
        )
    ):
        report(f"finding the face in {photo.name}", k + 1)
        subjects.append(
            open_photo_subject(
                photo,
                model,
                face_index=face,
                landmarks=None if points is None else read_landmarks(points),
                task_file=request.task_file,
            )
        )
    report("one identity for both", 3)
    focal_lengths = (read_focal_length(request.target), read_focal_length(request.reference))
    target, reference, remarks = unify_subjects(subjects[0], subjects[1], focal_lengths)
    report("drawing", 4)
    result = transfer_between(target, reference, request.component)
    report("writing", 5)
    write_photo(request.out, result.image, PhotoFile(target.photo, target.alpha))
    report("done", _STAGES)
    said = [*target.remarks, *(f"Reference: {remark}" for remark in reference.remarks), *remarks, *result.remarks]
    return replace(result, remarks=tuple(said))


def unify_subjects(
    target: PhotoSubject, reference: PhotoSubject, focal_lengths: tuple[float | None, float | None] = (None, None)
) -> tuple[PhotoSubject, PhotoSubject, tuple[str, ...]]:
    """Give two photos of a person one identity: eq. (15), (16).

    Parameters
    ----------
    target, reference : PhotoSubject
        Of one model.
    focal_lengths : (float or None, float or None)
        Of the two photos, pixels, where they are known.

    Returns
    -------
    target, reference : PhotoSubject
        With equal identity weights, each with its own expression, pose and residual; as they were where the photos
        seem to show two people.
    remarks : tuple of str
        What a user should know.
    """
    from facewright.apps.same_person import compare_people
    from facewright.fitting.image import PhotoFitOptions
    from facewright.fitting.joint import fit_jointly

    pair = (target, reference)
    remark = "The photos seem to show two people: each keeps its own identity; the result may look like neither."
    comparison = compare_people(target, reference, focal_lengths)
    if comparison is not None and comparison.two_people:
        return target, reference, (remark,)
    fits = fit_jointly(
        target.fit.model,
        [subject.landmarks for subject in pair],
        [subject.fit.image_size for subject in pair],
        [PhotoFitOptions(focal_length=focal) for focal in focal_lengths],
    )
    # what the landmarks lose by sharing an identity
    loss = sum(_squared_residual(fit) - _squared_residual(subject.fit) for fit, subject in zip(fits, pair, strict=True))
    if comparison is None and loss > _TWO_PEOPLE:
        return target, reference, (remark,)
    first, second = (_refitted(subject, fit) for fit, subject in zip(fits, pair, strict=True))
    return first, second, ()


def _refitted(subject: PhotoSubject, fit: PhotoFit) -> PhotoSubject:
    from facewright.apps.photo_subject import complete_subject
    from facewright.io.image import PhotoFile

    photo = PhotoFile(subject.photo, subject.alpha)
    return complete_subject(photo, fit, subject.face, subject.landmarks, subject.remarks)


def transfer_between(target: PhotoSubject, reference: PhotoSubject, component: str) -> Transfer:
    """Carry a component of one person's photo into another.

    Parameters
    ----------
    target, reference : PhotoSubject
        Of one model; see `unify_subjects`.
    component : str
        One of `facewright.imaging.component_mask.COMPONENTS`.

    Returns
    -------
    Transfer
        The picture and what it was made from.

    Raises
    ------
    ValueRangeError
        If the component is unknown, or the reference shows too little of it.
    TopologyError
        If the two are of different faces.

    Notes
    -----
    *Expression flow* warps the target to its face with the component's FACS coefficients of the reference, all of it:
    chin and cheeks follow a mouth that opens. *Alignment flow* looks the reference up at the same points of the skin.
    Both use the same mesh in the target's view, which takes the reference's residual within the component.
    """
    from facewright.imaging.alignment_flow import align_picture
    from facewright.imaging.component_blend import blend_component
    from facewright.imaging.component_mask import SkinPixels, component_pixels
    from facewright.imaging.synthesis import PhotoSynthesiser
    from facewright.landmarks.person_mask import person_finder

    check_choice("component", component, COMPONENTS)
    face = target.face
    if face.topology.fingerprint != reference.face.topology.fingerprint:
        raise TopologyError("target and reference must be fitted with models of one face, got two.")
    level = component_level(face, component)
    view, weights = _new_view(target, reference, component, level)
    warped = PhotoSynthesiser(target.photo, target.source, face, find_person=person_finder()).draw(view)
    box = _box(face, view, target.photo.shape[:2])
    there = _box(face, reference.source, reference.photo.shape[:2])
    pixels = SkinPixels.of(face, _within(view, box), _size(box))
    if component in ("brows", "nose"):  # the flow is smooth: what the mesh holds still it may move by a little
        free = np.clip(4.0 * component_pixels(pixels, component_freedom(face, component)), 0.0, 1.0)
        free[~(pixels.fragments.covered | pixels.openings)] = 1.0
        still = target.photo[box].astype(np.float32)
        warped.image[box] = np.rint(still + free[..., None] * (warped.image[box] - still)).astype(np.uint8)
    picture = _in_colours_of(reference.photo[there], target.photo[box])
    aligned = align_picture(picture, _within(reference.source, there), face, pixels)
    inside = {name: component_pixels(pixels, component_level(face, name)) for name in {component, "brows", "face"}}
    blend = blend_component(
        warped.image[box],
        aligned,
        inside[component],
        (inside["face"] > 0.0) & ~pixels.openings,
        openings=pixels.openings,
        brows=inside["brows"] if component in ("brows", "face") else None,
        away_from_outline=component == "face",
        colourless=is_grey(reference.photo) and not is_grey(target.photo),
    )
    if blend.seen_share < _LEAST_SEEN:
        raise ValueRangeError(
            f"the reference must show the {component} that the target shows, got a head turned so that "
            f"{100 * blend.seen_share:.0f} % of it is seen."
        )
    image, mask = warped.image.copy(), np.zeros(target.photo.shape[:2], bool)
    apart = angle_between(target, reference)
    only_moves = component == "nose" and apart > _OTHER_SIDE_DEGREES
    if not only_moves:
        image[box], mask[box] = blend.image, blend.mask
    shown = np.zeros_like(image)
    shown[box] = aligned.image
    if only_moves:
        remarks: tuple[str, ...] = (
            f"The reference shows the nose from another side ({apart:.0f} degrees apart): the target's own nose moves "
            "as the reference's, its look stays.",
        )
    else:
        remarks = _remarks(component, blend.seen_share, aligned.shrinking, target, reference)
    return Transfer(image, warped.touched | mask, mask, warped.image, shown, weights, remarks)


def angle_between(target: PhotoSubject, reference: PhotoSubject) -> float:
    """Return the angle, degrees, between the directions from which two photos show a face."""
    rays = []
    for subject in (target, reference):
        ray = subject.camera_from_model.rotation.T @ subject.source.camera_vertices[: subject.face.n_skin].mean(axis=0)
        rays.append(ray / np.linalg.norm(ray))
    return float(np.degrees(np.arccos(np.clip(rays[0] @ rays[1], -1.0, 1.0))))


def _new_view(
    target: PhotoSubject, reference: PhotoSubject, component: str, level: NDArray[np.float64]
) -> tuple[MeshView, NDArray[np.float64]]:
    """Return the target's view of its face with the reference's component, and its coefficients."""
    moves = component_shapes(component, target.rig.names)
    weights = np.where(moves, reference.weights, target.weights)
    gaze = reference.gaze if component in ("eyes", "face") else target.gaze
    vertices = target.vertices(weights=weights, gaze=gaze)
    view = target.view(vertices)
    if np.array_equal(target.fit.identity_weights, reference.fit.identity_weights):
        # within the component the face is the reference's, and so is what the model does not say of it
        share = np.clip(level, 0.0, 1.0)[:, None]
        step = share * (target.camera_from_model.apply(vertices + reference.residual) - view.camera_vertices)
        seen = view.camera_vertices + np.where(np.abs(step) > _STILL_MM, step, 0.0)
        view = MeshView(target.intrinsics.project(seen), seen)
    free = component_freedom(target.face, component)
    if (free < 1.0).any():
        before = target.source
        moved = free[:, None] * (view.camera_vertices - before.camera_vertices)
        still = (np.abs(moved) <= _STILL_MM).all(axis=1)
        seen = np.where(still[:, None], before.camera_vertices, before.camera_vertices + moved)
        view = MeshView(np.where(still[:, None], before.pixels, target.intrinsics.project(seen)), seen)
    return view, weights


def _box(face: Face, view: MeshView, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return rows and columns of the picture round the skin, with a margin."""
    skin = view.pixels[: face.n_skin]
    low, high = skin.min(axis=0), skin.max(axis=0)
    margin = _MARGIN * (high - low).max()
    x0, y0 = np.maximum(np.floor(low - margin).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(high + margin).astype(int) + 1, (size[1], size[0]))
    return slice(int(y0), int(y1)), slice(int(x0), int(x1))


def _size(box: tuple[slice, slice]) -> tuple[int, int]:
    rows, cols = box
    return rows.stop - rows.start, cols.stop - cols.start


def _within(view: MeshView, box: tuple[slice, slice]) -> MeshView:
    """Return the view of a crop."""
    rows, cols = box
    return replace(view, pixels=view.pixels - (cols.start, rows.start))


def _in_colours_of(reference: NDArray[np.uint8], target: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the reference in grey where the target is."""
    if not is_grey(target) or is_grey(reference):
        return reference
    luma = np.rint(reference @ np.array([0.299, 0.587, 0.114])).astype(np.uint8)
    return np.repeat(luma[..., None], 3, axis=2)


def is_grey(picture: NDArray[np.uint8]) -> bool:
    """Tell whether a picture has no colours, to within what JPEG leaves."""
    spread = picture.max(axis=2).astype(np.int16) - picture.min(axis=2)
    return bool(np.percentile(spread, 99) <= 6)


def _remarks(
    component: str, seen_share: float, shrinking: float, target: PhotoSubject, reference: PhotoSubject
) -> tuple[str, ...]:
    remarks = []
    if seen_share < 0.9:
        remarks.append(
            f"The reference is turned so that it shows {100 * seen_share:.0f} % of the {component}; the rest is the "
            "target's."
        )
    if shrinking < 0.5:
        remarks.append(
            f"The reference's face is {1 / shrinking:.1f} times as small as the target's: what comes from it is soft."
        )
    if is_grey(reference.photo) and not is_grey(target.photo):
        remarks.append(
            f"The reference has no colours: the {component} {'take' if component in _PLURAL else 'takes'} the target's."
        )
    return tuple(remarks)


def _squared_residual(fit: PhotoFit) -> float:
    """Return the sum of squared distances of the landmarks from the fit's, by the squared inter-ocular distance."""
    scale = interocular_distance(fit.reprojection, fit.landmarks.scheme)
    return float(np.nansum((fit.residuals_px / scale) ** 2))


def _reporter(progress: Progress | None) -> Callable[[str, int], None]:
    def report(stage: str, done: int) -> None:
        if progress is not None:
            progress(stage, done, _STAGES)

    return report
