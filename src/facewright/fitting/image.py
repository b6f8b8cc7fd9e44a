"""Fitting the bilinear model to the landmarks of one picture (FaceWarehouse 4.1.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import head_angles_from_rotation
from facewright.camera.weak_perspective import WeakPerspective
from facewright.errors import DegenerateError, ValueRangeError
from facewright.fitting.coordinate_descent import FitState, Targets, descend, start_state
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.energies.identity_prior import IdentityPrior
from facewright.fitting.landmark_model import LandmarkModel, PersonPoints
from facewright.fitting.mesh_synthesis import MeshSynthesiser
from facewright.fitting.outline import Outline
from facewright.fitting.perspective_refinement import CameraPrior, PinholeState, refine
from facewright.landmarks.points import Landmarks, interocular_distance
from facewright.landmarks.scheme import load_scheme
from facewright.models.bilinear import BilinearModel
from facewright.models.blendshapes import BlendshapeRig

#: Fewest fixed landmarks that a face is fitted to.
MIN_LANDMARKS = 10
#: Precision of an outline's point beside a landmark's: neighbours say the same.
_OUTLINE_PRECISION = 0.5
#: Focal length, in sides of the picture, at which a pinhole is as good as weak perspective.
_FAR = 200.0


@dataclass(frozen=True)
class PhotoFitOptions:
    """How a photo is fitted.

    Parameters
    ----------
    rounds : int
        Rounds of weak-perspective coordinate descent, from which the joint refinement starts.
    perspective : bool
        Whether to refine under full perspective, or under weak perspective still.
    refinements : int
        At most so many steps of the joint refinement; 0 leaves it at the coordinate descent.
    focal_length : float or None
        Focal length in pixels where it is known (EXIF); guessed from the picture's size otherwise.
    noise_mm : float
        Standard deviation, per coordinate, of a landmark of confidence 1, as a length on the face; also stands for what
        the model cannot represent.
    expression_spread, expression_sparsity : float
        Prior of the FACS coefficients, see `ExpressionPrior`.
    """

    rounds: int = 2
    perspective: bool = True
    refinements: int = 8
    focal_length: float | None = None
    noise_mm: float = 1.0
    expression_spread: float = 0.35
    expression_sparsity: float = 1.0

    def __post_init__(self) -> None:
        if self.rounds < 1 or self.refinements < 0:
            raise ValueRangeError(
                f"rounds must be at least 1 and refinements at least 0, got {self.rounds} and {self.refinements}."
            )
        for name in ("noise_mm", "expression_spread"):
            if not getattr(self, name) > 0:
                raise ValueRangeError(f"{name} must be positive, got {getattr(self, name)}.")
        if self.focal_length is not None and not (np.isfinite(self.focal_length) and self.focal_length > 0):
            raise ValueRangeError(f"focal_length must be positive, got {self.focal_length}.")


@dataclass(frozen=True, eq=False)
class PhotoFit:
    """A face found in a picture.

    Parameters
    ----------
    model : BilinearModel
        The model it was fitted with.
    identity_weights : ndarray of shape (I,)
        w_id.
    expression_weights : ndarray of shape (E,)
        w_exp; the mixture of the FACS shapes by `blendshape_weights` (eq. 17).
    blendshape_weights : ndarray of shape (B,)
        FACS coefficients beta in [0, 1]; the neutral's own is 1 - sum(beta).
    weak_camera : WeakPerspective
        s, R, t of eq. 13; the weak-perspective camera nearest to the pinhole where there is one.
    intrinsics, camera_from_model : Intrinsics and RigidMotion, or None
        The pinhole camera, where it was refined.
    landmarks : Landmarks
        What was fitted to.
    reprojection : ndarray of shape (L, 2), pixels
        Where the fit has these landmarks; NaN for points that the mesh does not mark.
    image_size : (height, width)
        Size of the picture.
    vertices : ndarray of shape (V, 3), float32, millimetres
        The fitted face in model space: eq. (10), to within `MeshSynthesiser`'s tolerance.
    """

    model: BilinearModel
    identity_weights: NDArray[np.float64]
    expression_weights: NDArray[np.float64]
    blendshape_weights: NDArray[np.float64]
    weak_camera: WeakPerspective
    intrinsics: Intrinsics | None
    camera_from_model: RigidMotion | None
    landmarks: Landmarks
    reprojection: NDArray[np.float64]
    image_size: tuple[int, int]
    vertices: NDArray[np.float32]

    @cached_property
    def rig(self) -> BlendshapeRig:
        """The person's neutral and FACS blendshapes: eq. (17)."""
        return self.model.blendshapes(self.identity_weights)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation of the head, camera_from_model, (3, 3)."""
        return self.weak_camera.rotation if self.camera_from_model is None else self.camera_from_model.rotation

    @property
    def head_angles_degrees(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll of the head; see `rotation_from_head_angles`."""
        return head_angles_from_rotation(self.rotation)

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Project model points (..., 3) into the picture, pixels (..., 2)."""
        if self.intrinsics is None or self.camera_from_model is None:
            return self.weak_camera.project(points)
        return self.intrinsics.project(self.camera_from_model.apply(points))

    def camera_points(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Move model points (..., 3) into the camera's axes, millimetres; for depth tests and shading."""
        if self.camera_from_model is None:
            return self.weak_camera.camera_points(points)
        return self.camera_from_model.apply(points)

    @property
    def residuals_px(self) -> NDArray[np.float64]:
        """Distance of each landmark from the fit's, (L,), NaN where either is missing."""
        return np.linalg.norm(self.reprojection - self.landmarks.points, axis=1)

    @property
    def reprojection_iod(self) -> float:
        """Mean distance of the landmarks from the fit's, as a share of the inter-ocular distance.

        All landmarks that were found and that the mesh marks count equally, contour points at the nearest place of
        the outline. The inter-ocular distance is that of the fit's eye outline centres in the picture.
        """
        return float(np.nanmean(self.residuals_px)) / interocular_distance(self.reprojection, self.landmarks.scheme)


@dataclass(frozen=True, eq=False)
class PhotoStart:
    """What a refinement starts from.

    Parameters
    ----------
    landmarks : Landmarks
        In the fitter's scheme.
    image_size : (height, width)
        Size of the picture.
    targets : Targets
        The same landmarks in the model's order.
    expression_prior, lens : ExpressionPrior and CameraPrior
        Priors.
    state : FitState
        The weak-perspective fit.
    """

    landmarks: Landmarks
    image_size: tuple[int, int]
    targets: Targets
    expression_prior: ExpressionPrior
    lens: CameraPrior
    state: FitState


class PhotoFitter:
    """Fits faces of one model to landmarks; keeps what does not depend on the picture.

    Parameters
    ----------
    model : BilinearModel
        The model; its topology must mark the scheme's landmarks and the jaw line.
    scheme : str
        Landmark scheme that is fitted to; landmarks of others are converted.

    Raises
    ------
    TopologyError
        If the topology does not mark the landmarks.
    ValueRangeError
        If the scheme is unknown.
    """

    def __init__(self, model: BilinearModel, scheme: str = "fw74") -> None:
        self.model = model
        self.scheme = load_scheme(scheme)
        self.landmark_model = LandmarkModel.of(model, self.scheme, IdentityPrior.of(model))
        self._synthesiser = MeshSynthesiser(model)

    def fit(
        self,
        landmarks: Landmarks,
        image_size: tuple[int, int],
        options: PhotoFitOptions | None = None,
        outline: Outline | None = None,
    ) -> PhotoFit:
        """Fit a face to landmarks.

        Parameters
        ----------
        landmarks : Landmarks
            Of any scheme that converts to the fitter's. Missing points are ignored.
        image_size : (height, width)
            Size of the picture, pixels: gives the principal point and the guess of the focal length.
        options : PhotoFitOptions, optional
            Defaults where absent.
        outline : Outline, optional
            Of the face, found in the picture near an earlier fit: further contour points.

        Returns
        -------
        PhotoFit
            The fit.

        Raises
        ------
        ValueRangeError
            If the landmarks are of a scheme that cannot be converted.
        DegenerateError
            If too few landmarks are present, or they lie in one spot.
        """
        options = options or PhotoFitOptions()
        start = self.start(landmarks, image_size, options, outline)
        fine = refine(
            self.landmark_model,
            start.targets,
            start.expression_prior,
            start.lens,
            start.state,
            image_size,
            options.refinements,
        )
        return self.finish(start, fine, options.perspective)

    def start(
        self,
        landmarks: Landmarks,
        image_size: tuple[int, int],
        options: PhotoFitOptions,
        outline: Outline | None = None,
    ) -> PhotoStart:
        """Return the weak-perspective fit from which the refinement starts; see `fit`."""
        found = landmarks.convert(self.scheme.name)
        small = self.landmark_model
        n_present = int(found.present[small.fixed].sum())
        if n_present < MIN_LANDMARKS:
            raise DegenerateError(f"at least {MIN_LANDMARKS} landmarks inside the face are needed, got {n_present}.")
        order = np.concatenate([small.fixed, small.sliding])
        pixels = np.where(found.present[:, None], found.points, 0.0)[order]
        confidence = found.confidence[order]
        if outline is not None:
            confidence = np.concatenate([confidence, _OUTLINE_PRECISION * outline.confidence])
            pixels = np.concatenate([pixels, outline.pixels])
        targets = Targets(pixels, confidence, len(small.fixed), options.noise_mm)
        prior = ExpressionPrior(options.expression_spread, options.expression_sparsity)
        state = descend(small, targets, prior, start_state(small, targets), options.rounds)
        return PhotoStart(found, image_size, targets, prior, _camera_prior(options, image_size), state)

    def finish(self, start: PhotoStart, fine: PinholeState, perspective: bool) -> PhotoFit:
        """Return the fit, with its mesh, of a refined state."""
        small, person, beta = self.landmark_model, fine.person, fine.beta
        w_id, w_exp = small.prior.weights(person.c), small.expression(beta)
        fit = PhotoFit(
            model=self.model,
            identity_weights=w_id,
            expression_weights=w_exp,
            blendshape_weights=beta,
            weak_camera=fine.weak_perspective(person.candidates(w_exp).mean(axis=0)),
            intrinsics=fine.intrinsics if perspective else None,
            camera_from_model=fine.motion if perspective else None,
            landmarks=start.landmarks,
            reprojection=np.empty((0, 2)),
            image_size=start.image_size,
            vertices=self._synthesiser.vertices(w_id, w_exp),
        )
        return self._with_reprojection(fit, person, start.targets, np.concatenate([small.fixed, small.sliding]))

    def _with_reprojection(
        self,
        fit: PhotoFit,
        person: PersonPoints,
        targets: Targets,
        order: NDArray[np.int32],
    ) -> PhotoFit:
        """Fill in where the fit has the landmarks."""
        small = self.landmark_model
        w_exp = fit.expression_weights
        places = small.place_contour(fit.project(person.candidates(w_exp)), fit.rotation, targets.contour)
        reprojection = np.full((self.scheme.n_points, 2), np.nan)
        points = fit.project(person.expression_matrix(places) @ w_exp)
        reprojection[order] = points[: len(order)]  # without an outline's points
        return replace(fit, reprojection=reprojection)


def fit_photo(
    model: BilinearModel,
    landmarks: Landmarks,
    image_size: tuple[int, int],
    options: PhotoFitOptions | None = None,
) -> PhotoFit:
    """Fit a face to the landmarks of one picture; one line over `PhotoFitter`."""
    return PhotoFitter(model).fit(landmarks, image_size, options)


def _camera_prior(options: PhotoFitOptions, image_size: tuple[int, int]) -> CameraPrior:
    if not options.perspective:
        return CameraPrior(_FAR * max(image_size), 1e-3)
    if options.focal_length is not None:
        return CameraPrior(options.focal_length, 0.05)
    return CameraPrior(Intrinsics.for_image(image_size).focal_x, 0.4)
