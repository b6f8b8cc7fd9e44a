"""A person in a photo, ready to be redrawn: fitted, completed with eyes and teeth, adjusted to what the photo shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.apps.photo_landmarks import check_fit, check_in_picture, find_face
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import MissingFaceError
from facewright.fitting.gaze import Eyeballs, find_gaze
from facewright.fitting.image import PhotoFit, PhotoFitOptions, PhotoFitter
from facewright.fitting.landmark_residual import CarriedResidual, smooth_field
from facewright.fitting.outline import Outline, find_outline
from facewright.imaging.mesh_view import MeshView
from facewright.landmarks.points import Landmarks, interocular_distance
from facewright.landmarks.scheme import load_scheme
from facewright.models.blendshapes import BlendshapeRig
from facewright.numeric.check import check_shape

if TYPE_CHECKING:
    from facewright.faces.attach_parts import PartsAttacher
    from facewright.faces.face import Face
    from facewright.imaging.synthesis import PhotoSynthesiser
    from facewright.io.image import PhotoFile
    from facewright.landmarks.detector import LandmarkDetector
    from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

#: Standard deviation, millimetres, of points that the mesh is made to meet: small where an edge shows a mismatch.
_NOISE_MM = {"inner_mouth": 0.12, "mouth": 0.3, "eye": 0.2, "nose": 0.6, "brow": 0.8, "contour": 2.0}
#: Standard deviation, millimetres across it, of a face's outline that the picture clearly shows; how sure it must be.
_OUTLINE_MM, _LEAST_CONFIDENCE = 0.6, 0.05
#: Each finds the outline near the last fit and fits again; more than one changes the fit no more.
_OUTLINE_ROUNDS = 1
#: Groups of landmarks that edits of shape follow exactly.
_FOLLOWED = ("right_eye", "left_eye", "outer_mouth", "inner_mouth")
_STAGES = 4


@dataclass(eq=False)
class PhotoSubject:
    """A photo and the person in it.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        sRGB.
    alpha : ndarray of shape (H, W), uint8, or None
        The photo's transparency, which results keep.
    fit : PhotoFit
        Identity, expression, camera and pose.
    face : Face
        All parts, on the topology of all meshes here.
    rig : BlendshapeRig
        The person's neutral and 46 blendshapes, all parts.
    landmarks : Landmarks
        What was found: ``mediapipe478`` where the detector found it.
    weights : ndarray of shape (46,)
        FACS coefficients of the photo's expression.
    gaze : ndarray of shape (2, 2), radians
        Yaw and pitch of the right and the left eyeball in the photo, relative to the head.
    residual : ndarray of shape (V, 3), millimetres
        What is added to the photo's own mesh in model space so that it meets the landmarks.
    remarks : tuple of str
        What a user should know: sentences.
    """

    photo: NDArray[np.uint8]
    alpha: NDArray[np.uint8] | None
    fit: PhotoFit
    face: Face
    rig: BlendshapeRig
    landmarks: Landmarks
    weights: NDArray[np.float64]
    gaze: NDArray[np.float64]
    residual: NDArray[np.float64]
    remarks: tuple[str, ...] = ()
    _attacher: PartsAttacher | None = None

    @property
    def intrinsics(self) -> Intrinsics:
        """The photo's camera."""
        assert self.fit.intrinsics is not None
        return self.fit.intrinsics

    @property
    def camera_from_model(self) -> RigidMotion:
        """The head's pose in the photo."""
        assert self.fit.camera_from_model is not None
        return self.fit.camera_from_model

    def vertices(
        self,
        identity_weights: NDArray[np.floating] | None = None,
        weights: NDArray[np.floating] | None = None,
        gaze: NDArray[np.floating] | None = None,
    ) -> NDArray[np.float64]:
        """Return all parts (V, 3) in model space, millimetres, without the residual.

        Parameters
        ----------
        identity_weights : ndarray of shape (I,), optional
            Another identity; the photo's where absent. It changes the neutral; expressions keep the displacements that
            the photo showed of this person, so that a mouth stays as far open as it is.
        weights : ndarray of shape (46,), optional
            Another expression; the photo's where absent.
        gaze : ndarray of shape (2, 2), optional
            Another gaze; the photo's where absent. Eyeballs turn by the gaze alone.
        """
        beta = self.weights if weights is None else np.asarray(weights, dtype=np.float64)
        posed = self.rig.pose(beta).astype(np.float64)
        eyeballs = self._eyeballs
        if identity_weights is not None:
            neutral = self.rig.neutral + self._identity_change(identity_weights)
            posed = self._with_neutral(posed, neutral)
            eyeballs = Eyeballs(self.face, neutral)
        eyeballs.turn(posed, self.gaze if gaze is None else gaze)
        return posed

    def _with_neutral(self, posed: NDArray[np.float64], neutral: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a posed mesh with another neutral; lids open by the same share as before."""
        rest = self.rig.neutral.astype(np.float64)
        result = posed + (neutral - rest)
        for contact in smooth_field(self.face).lid_contacts:
            was, now, at_rest, at_new_rest = (contact.offsets(v)[:, 1] for v in (posed, result, rest, neutral))
            wanted = was * at_new_rest / np.maximum(at_rest, 0.1)
            change = np.zeros((len(wanted), 3))
            change[:, 1] = np.where(at_rest > 0.1, wanted - now, 0.0)
            contact.change(result, change)
        return result

    def view(self, vertices: NDArray[np.floating], camera_from_model: RigidMotion | None = None) -> MeshView:
        """Return how the photo's camera sees a mesh, moved by the residual.

        Parameters
        ----------
        vertices : ndarray of shape (V, 3), millimetres
            From `vertices`, model space.
        camera_from_model : RigidMotion, optional
            Another pose of the head; the photo's where absent.
        """
        check_shape("vertices", vertices, self.face.topology.n_vertices, 3)
        motion = self.camera_from_model if camera_from_model is None else camera_from_model
        seen = motion.apply(np.asarray(vertices, dtype=np.float64) + self._carried.at(vertices))
        return MeshView(self.intrinsics.project(seen), seen)

    @cached_property
    def _eyeballs(self) -> Eyeballs:
        return Eyeballs(self.face, self.rig.neutral)

    @cached_property
    def _carried(self) -> CarriedResidual:
        return CarriedResidual(self.face, self.residual, self.vertices())

    @cached_property
    def source(self) -> MeshView:
        """The mesh as the photo shows it."""
        return self.view(self.vertices())

    @cached_property
    def synthesiser(self) -> PhotoSynthesiser:
        """What redraws the photo, with its inner mouth and eyes."""
        from facewright.imaging.synthesis import PhotoSynthesiser
        from facewright.landmarks.person_mask import person_finder

        inner, finder = self._inner_face(), person_finder()
        return PhotoSynthesiser(self.photo, self.source, self.face, inner=inner, find_person=finder)

    @cached_property
    def edit_synthesiser(self) -> PhotoSynthesiser:
        """What redraws the photo for other shapes of the same face, where mouth and eyes show what they showed.

        They come from the photo and follow the points of lips and lids; nothing opens, closes or turns.
        """
        from facewright.imaging.synthesis import EDIT_OPTIONS, PhotoSynthesiser
        from facewright.landmarks.person_mask import person_finder

        synthesiser = PhotoSynthesiser(self.photo, self.source, self.face, EDIT_OPTIONS, find_person=person_finder())
        synthesiser.field.follow(followed_points(self.face))
        return synthesiser

    def _inner_face(self) -> Any:
        try:
            from facewright.imaging.inner_face import InnerFace
            from facewright.imaging.photo_light import estimate_light
        except ImportError:
            return None
        light = estimate_light(self.photo, self.source, self.face)
        return InnerFace.of(self.photo, self.source, self.face, light)

    def _identity_change(self, identity_weights: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return how all parts (V, 3) of the neutral differ with another identity."""
        model = self.fit.model
        check_shape("identity_weights", identity_weights, model.n_identity)
        step = np.asarray(identity_weights, dtype=np.float64) - self.fit.identity_weights
        change = np.tensordot(step, self._neutral_basis.astype(np.float64), 1)
        if self._attacher is None:
            return np.asarray(change)
        skin = self.rig.neutral[: len(change)].astype(np.float64)
        return np.asarray(self._attacher.neutral(skin + change) - self._attacher.neutral(skin))

    @cached_property
    def _neutral_basis(self) -> NDArray[np.float32]:
        """The neutral as a linear model of identity, (I, V, 3)."""
        return self.fit.model.expression(self.fit.model.expression_weights[0])


def open_photo_subject(
    photo: Path | str | NDArray[np.uint8],
    model: BilinearModel,
    *,
    face_index: int = 0,
    landmarks: Landmarks | None = None,
    detector: LandmarkDetector | None = None,
    task_file: Path | None = None,
    focal_length: float | None = None,
    progress: Progress | None = None,
) -> PhotoSubject:
    """Find, fit and complete the person in a photo.

    Parameters
    ----------
    photo : path or ndarray of shape (H, W, 3) or (H, W, 4), uint8
        A picture file, or sRGB pixels.
    model : BilinearModel
        The model; its face must be installed. See `facewright.apps.default_model`.
    face_index : int
        Which of the faces found, the largest being 0.
    landmarks : Landmarks, optional
        Points that win over detected ones. With `detector` absent and MediaPipe not installed they are all there is.
    detector : LandmarkDetector, optional
        An open detector; opened and closed here where absent.
    task_file : Path, optional
        See `facewright.landmarks.detector.open_detector`.
    focal_length : float, optional
        Pixels; from the EXIF data, else estimated, where absent.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    PhotoSubject
        The person.

    Raises
    ------
    NoFaceError
        If no face was found, or fewer than `face_index` asks for.
    DegenerateError, ValueRangeError
        If the head is turned away too far or the landmarks do not make a face.
    FileFormatError, StoreError
        If the file cannot be read.
    MissingExtraError, MissingFaceError
        If the detector or the model's face is needed and not installed.
    """
    from facewright.io.image import PhotoFile, read_photo

    report = _reporter(progress)
    report("reading the photo", 0)
    if isinstance(photo, np.ndarray):
        file, name = PhotoFile.of(photo), "the picture"
    else:
        file, name = read_photo(photo), str(photo)
    face = face_of(model)
    report("finding the face", 1)
    found, n_faces = find_face(file, name, face_index, landmarks, detector, task_file)
    check_in_picture(found, file.pixels, name)
    report("fitting the face", 2)
    focal = file.focal_length if focal_length is None else focal_length
    size = (file.pixels.shape[0], file.pixels.shape[1])
    fitter, options = PhotoFitter(model), PhotoFitOptions(focal_length=focal)
    fit = fitter.fit(found, size, options)
    for _ in range(_OUTLINE_ROUNDS):
        fit = fitter.fit(found, size, options, outline_of(file.pixels, fit))
    check_fit(fit, name)
    report("completing the face", 3)
    remarks = list(file.remarks)
    if n_faces > 1:
        which = "the largest" if face_index == 0 else f"number {face_index}"
        remarks.append(f"{n_faces} faces were found, {which} is used; --face chooses another.")
    subject = complete_subject(file, fit, face, found, tuple(remarks))
    report("ready", _STAGES)
    return subject


def complete_subject(
    file: PhotoFile, fit: PhotoFit, face: Face, found: Landmarks, remarks: tuple[str, ...] = ()
) -> PhotoSubject:
    """Complete a fitted photo's person with all parts, gaze and residual.

    Parameters
    ----------
    file : PhotoFile
        The photo.
    fit : PhotoFit
        Its fit, by itself or with one identity for several photos.
    face : Face
        All parts of the face that the fit's model was built with.
    found : Landmarks
        What was fitted to, of its own scheme.
    remarks : tuple of str
        Kept in the subject.
    """
    rig, attacher = complete_rig(fit.model, fit.rig, face)
    V = face.topology.n_vertices
    subject = PhotoSubject(
        photo=file.pixels,
        alpha=file.alpha,
        fit=fit,
        face=face,
        rig=rig,
        landmarks=found,
        weights=fit.blendshape_weights,
        gaze=np.zeros((2, 2)),
        residual=np.zeros((V, 3)),
        remarks=remarks,
        _attacher=attacher,
    )
    vertices = subject.vertices()
    residual = _residual(subject, vertices)
    gaze = find_gaze(face, vertices + residual, _irises(found), subject.intrinsics, subject.camera_from_model)
    return replace(subject, residual=residual, gaze=gaze)


def outline_of(picture: NDArray[np.uint8], fit: PhotoFit) -> Outline:
    """Return the outline of a fitted face (H, W, 3) as its picture shows it."""
    iod = interocular_distance(fit.reprojection, fit.landmarks.scheme)
    model = fit.model
    return find_outline(picture, model.topology, model.mean_face, fit.project(fit.vertices), fit.rotation, iod)


def _residual(subject: PhotoSubject, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    from facewright.fitting.landmark_residual import Anchors, LandmarkResidual

    found = subject.landmarks.convert("fw74")
    ids = subject.face.topology.landmarks["fw74"]
    points = found.definition.fixed[ids[found.definition.fixed] >= 0]
    noise = np.ones(found.definition.n_points)
    for group, members in found.definition.groups.items():
        noise[members] = _NOISE_MM[group.rpartition("_")[2] if group != "inner_mouth" else group]
    present = found.present[points]
    pixels = np.where(present[:, None], found.points[points], 0.0)
    anchors = Anchors.at_vertices(ids[points], noise[points])
    outline = outline_of(subject.photo, subject.fit)
    sure = outline.confidence > _LEAST_CONFIDENCE
    if sure.any():
        anchors = anchors.with_outline(outline, sure, _OUTLINE_MM)
        pixels = np.concatenate([pixels, outline.pixels[sure]])
        present = np.concatenate([present, np.ones(int(sure.sum()), dtype=bool)])
    adjust = LandmarkResidual(subject.face, anchors)
    return adjust.displacement(vertices, pixels, subject.intrinsics, subject.camera_from_model, present)


def followed_points(face: Face) -> NDArray[np.int32]:
    """Return the vertices of lips and lids that pictures of another shape of the same face are made to meet, (K,)."""
    groups = load_scheme("fw74").groups
    points = np.unique(np.concatenate([groups[name] for name in _FOLLOWED]))
    ids = face.topology.landmarks["fw74"][points]
    return np.asarray(ids[ids >= 0], dtype=np.int32)


def complete_rig(model: BilinearModel, rig: BlendshapeRig, face: Face) -> tuple[BlendshapeRig, PartsAttacher | None]:
    """Return the rig of all parts, and what completes skins where the model holds only the skin.

    Far from where a shape moves a face, what the model says of it is the noise of its compression, tenths of a
    millimetre: ears, hair and neck would breathe with every blink.

    Parameters
    ----------
    model : BilinearModel
        That the rig is of.
    rig : BlendshapeRig
        A person's.
    face : Face
        All parts of the model's face, see `face_of`.
    """
    from facewright.faces.shape_support import shape_support

    local, support = rig.deltas.copy(), shape_support(face)
    for k, name in enumerate(rig.names):
        if name in face.blendshape_names:  # a model may have expressions of its own
            local[k] *= support[face.blendshape_names.index(name), : len(rig.neutral), None]
    if model.n_vertices == face.topology.n_vertices:
        return BlendshapeRig(rig.neutral, rig.names, local), None
    from facewright.faces.attach_parts import parts_attacher

    attacher = parts_attacher(face)
    neutral = attacher.neutral(rig.neutral)
    deltas = attacher.blendshapes(neutral, local, np.ones(len(rig.names)))
    return BlendshapeRig(neutral.astype(np.float32), rig.names, deltas.astype(np.float32)), attacher


def face_of(model: BilinearModel) -> Face:
    """Return the face, all parts, that a model was built with.

    Raises
    ------
    MissingFaceError
        If it is not installed, or has another mesh.
    """
    from facewright.faces import load_face

    name = str(model.provenance.get("face", ""))
    try:
        face = load_face(name)
    except MissingFaceError as error:
        raise MissingFaceError(
            "the face that the model was built with must be installed to draw eyes and teeth, "
            f"got {name or 'an unknown one'!r}: {error}"
        ) from error
    fingerprints = (face.topology.fingerprint, face.skin().topology.fingerprint)
    if model.topology.fingerprint not in fingerprints:
        raise MissingFaceError(
            f"the model must have the mesh of its face {name!r} as installed, got another one: build the model again "
            "(facewright model build)."
        )
    return face


def _irises(found: Landmarks) -> NDArray[np.float64]:
    """Return the centres of the right and the left iris, NaN where the scheme has none."""
    groups = found.definition.groups
    centres = np.full((2, 2), np.nan)
    for k, side in enumerate(("right", "left")):
        ids = groups.get(f"{side}_iris")
        if ids is not None and len(ids):
            centres[k] = found.points[ids].mean(axis=0)
    return centres


def _reporter(progress: Progress | None) -> Callable[[str, int], None]:
    def report(stage: str, done: int) -> None:
        if progress is not None:
            progress(stage, done, _STAGES)

    return report
