"""Fit the template to scans of one person: the neutral, then the other expressions (FaceWarehouse 3.2.1, 3.2.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.errors import NoFaceError, TopologyError, ValueRangeError
from facewright.faces.face import Face
from facewright.fitting.scan_contact import ContactPairs
from facewright.fitting.scan_correspondence import Gates, ScanSurface, exposed_vertices
from facewright.fitting.scan_landmarks import LandmarkTerm
from facewright.fitting.scan_stage1 import (
    LinearShapes,
    Stage1Fit,
    Stage1Options,
    Visibility,
    fit_linear,
    start_pose,
)
from facewright.fitting.scan_stage2 import LaplacianDeformer, Pulls, unfold
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.contour import face_region
from facewright.mesh.connectivity import vertex_adjacency
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_choice, check_finite, check_shape

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ScanFitOptions:
    """How a template is fitted to scans.

    Parameters
    ----------
    n_modes : int
        Leading identity modes of stage 1; at most those of the face.
    region : {"face", "head"}
        What is matched: the face in front of ears and hair line, or the whole skin (scans without hair).
    use_landmarks : bool
        False fits by the surface alone after the first pose (for comparison, FaceWarehouse Fig. 3).
    contact : bool
        Keep lips and lids closed that the capture shows closed.
    adapt_weights : bool
        Let the guide's blendshape weights follow the capture before stage 2, instead of taking them as acted exactly.
    stage1, expression_stage1 : Stage1Options
        Weights and rounds of the linear fits.
    stage2_landmarks, stage2_depth, stage2_laplacian : float
        w'1, w'2, w'3 of eq. (7).
    """

    n_modes: int = 50
    region: str = "face"
    use_landmarks: bool = True
    contact: bool = True
    adapt_weights: bool = True
    stage1: Stage1Options = field(default_factory=Stage1Options)
    expression_stage1: Stage1Options = field(
        default_factory=lambda: Stage1Options(gates_mm=(20.0, 15.0, 10.0, 8.0, 6.0), pose_only_rounds=1)
    )
    stage2_landmarks: float = 0.5
    stage2_depth: float = 1.0
    stage2_laplacian: float = 1.0

    def __post_init__(self) -> None:
        check_choice("region", self.region, ("face", "head"))
        if self.n_modes < 1:
            raise ValueRangeError(f"n_modes must be at least 1, got {self.n_modes}.")


@dataclass(frozen=True, eq=False)
class ScanFit:
    """The template on one scan.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float64, millimetres
        The skin after stage 2, in model space (the head as in the neutral, so that expressions may be compared).
    stage1_vertices : ndarray of shape (V, 3), float64, millimetres
        The skin before stage 2.
    coefficients : ndarray of shape (K,) or (46,), float64
        Identity coefficients of a neutral, in standard deviations; blendshape weights of an expression.
    target_from_model : RigidMotion
        The head's pose in the scan's frame.
    report : dict of str to float or int or str
        ``stage1_rms_mm`` and ``stage2_rms_mm``: root mean square distance of matched vertices from the scan;
        ``landmark_rms_mm``; ``matched`` and ``matched_share``: of the vertices that could be seen, those with a point
        of the scan; ``closed_share``: how closed lips and lids were taken to be.
    landmark_offsets : ndarray of shape (74, 3), float64, millimetres
        How far 3D landmarks were from their vertices, model space; of a neutral, subtracted from the landmarks of
        the person's expressions.
    """

    vertices: NDArray[np.float64]
    stage1_vertices: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    target_from_model: RigidMotion
    report: dict[str, float | int | str]
    landmark_offsets: NDArray[np.float64] = field(default_factory=lambda: np.zeros((74, 3)))

    @property
    def posed(self) -> NDArray[np.float64]:
        """The skin in the scan's frame, (V, 3)."""
        return self.target_from_model.apply(self.vertices)


#: Stage 2: the depth's weight as a multiple of the paper's, and the gate, in each Gauss-Newton step: closest points
#: take over as they come to be the right ones.
_DEPTH_SHARE = (0.3, 1.0, 1.0)
_GATES_MM = (6.0, 4.0, 3.0)
#: Weight of a pair of vertices in contact.
_CONTACT_STIFFNESS = 5.0
#: A fit that matches less of what the camera sees, or is further from it, has not found a face.
_LEAST_SHARE, _MOST_RMS_MM = 0.25, 3.0
#: Nor has a stage 1 whose coefficients have this mean square (1 is expected of people) and that is this far off still.
_MOST_SQUARE, _STRANGE_RMS_MM = 5.0, 1.2
#: Weight that keeps vertices without a match near where stage 1 has them.
_REST_WEIGHT = 2e-3
#: Residuals are reported of vertices whose closest point is within this.
_REPORT_GATE_MM = 10.0
#: Guide displacements below this leave a vertex to tell the pose of the head; mm.
_STILL_MM = 0.7
#: Standard deviation of an acted weight about the guide's: of shapes that the guide has, and of all others.
_ACTED_SPREAD, _OTHER_SPREAD = 0.25, 0.05


class ScanFitter:
    """Fits one face's skin to scans; keeps what is the same for all of them.

    Parameters
    ----------
    face : Face
        The template; its skin is used.
    options : ScanFitOptions
        How.

    Raises
    ------
    TopologyError
        If the face does not mark landmarks and jaw line, or has no identity modes.
    """

    def __init__(self, face: Face, options: ScanFitOptions | None = None) -> None:
        self.options = options or ScanFitOptions()
        self.face = face.skin()
        topology = self.face.topology
        if not len(self.face.identity_basis):
            raise TopologyError(f"face {face.name!r} must have identity modes to fit a scan with.")
        self.mean = self.face.mean_shape.astype(np.float64)
        self.landmarks = LandmarkTerm(self.face)
        self.contacts = ContactPairs(self.face)
        allowed = exposed_vertices(self.mean, topology.faces)
        if self.options.region == "face":
            inside = np.zeros(topology.n_vertices, dtype=bool)
            # the mask ends at the hair line; without it, hair is left to the robust weights
            region = topology.masks.get("face_region", np.empty(0, dtype=np.int32))
            inside[region if len(region) else face_region(topology, self.mean)] = True
            allowed &= inside
        self.visibility = Visibility(topology.faces, allowed)
        K = min(self.options.n_modes, len(self.face.identity_basis))
        self.identity = LinearShapes(
            self.mean,
            np.ascontiguousarray(self.face.identity_basis[:K].transpose(1, 2, 0), dtype=np.float64),
            np.zeros(K),
            np.ones(K),
            -4.0,
            4.0,
        )
        self._adjacency = vertex_adjacency(topology.faces, topology.n_vertices)
        self._person: _Person | None = None

    def fit_neutral(self, target: ScanTarget, progress: Progress | None = None) -> ScanFit:
        """Fit the face at rest: stage 1, then stage 2.

        Parameters
        ----------
        target : ScanTarget
            A scan of the person at rest.
        progress : callable, optional
            Called with stage, done, total.

        Raises
        ------
        NoFaceError
            If landmarks determine no pose, or the surface at the landmarks is not a face.
        """
        surface = ScanSurface(target)
        start = self._pose(self.mean, target, None)
        term = self.landmarks if self.options.use_landmarks else None
        linear = fit_linear(self.identity, surface, term, self.visibility, start, self.options.stage1)
        if len(linear.matches.vertices) < _LEAST_SHARE * len(linear.candidates):
            raise NoFaceError(
                f"the scan must show a face at the landmarks, but only {len(linear.matches.vertices)} of "
                f"{len(linear.candidates)} visible vertices of the fitted face find a point of it."
            )
        if progress is not None:
            progress("fitting the neutral", 1, 2)
        deformer = LaplacianDeformer(self.face.topology.faces, linear.vertices)
        fit = self._refine(deformer, linear, surface, None)
        if not float(fit.report["stage2_rms_mm"]) <= _MOST_RMS_MM:
            raise NoFaceError(
                f"the scan must show a face, but the fit stays {fit.report['stage2_rms_mm']:.1f} mm away from it."
            )
        square = float((fit.coefficients**2).mean())
        if square > _MOST_SQUARE and float(fit.report["stage1_rms_mm"]) > _STRANGE_RMS_MM:
            raise NoFaceError(
                f"the scan must show a face, but its shape would be {np.sqrt(square):.1f} standard deviations from "
                "the mean face in every way: check landmarks, unit and what the scan shows."
            )
        if progress is not None:
            progress("fitting the neutral", 2, 2)
        return fit

    def fit_expression(self, neutral: ScanFit, guide_weights: NDArray[np.floating], target: ScanTarget) -> ScanFit:
        """Fit another expression of the same person: deformation transfer of the guide, then stage 2.

        Parameters
        ----------
        neutral : ScanFit
            The person at rest.
        guide_weights : ndarray of shape (46,)
            Blendshape weights of the guide that the person was shown.
        target : ScanTarget
            A scan of the expression.

        Raises
        ------
        ShapeError, ValueRangeError
            If the weights are not (46,) or not finite.
        NoFaceError
            If the surface at the landmarks is not a face.
        """
        guide = np.asarray(guide_weights, dtype=np.float64)
        check_shape("guide_weights", guide, len(self.face.blendshape_names))
        check_finite("guide_weights", guide)
        person = self._prepare(neutral)
        delta = person.shapes @ guide
        moved = np.linalg.norm(delta, axis=1)
        still = np.exp(-0.5 * (moved / _STILL_MM) ** 2)
        start = self._pose(neutral.vertices, target, still)
        # what the detector misses in every picture of this person is no motion of the face
        target = replace(target, landmarks=target.landmarks - neutral.landmark_offsets @ start.rotation.T)
        surface = ScanSurface(target)
        term = self.landmarks if self.options.use_landmarks else None
        spread = np.where(guide > 0, _ACTED_SPREAD, _OTHER_SPREAD)
        shapes = LinearShapes(neutral.vertices, person.shapes, guide, spread, 0.0, 1.5)
        stage1 = self.options.expression_stage1
        if not self.options.adapt_weights:
            stage1 = Stage1Options(stage1.landmarks, stage1.depth, stage1.prior, stage1.gates_mm, len(stage1.gates_mm))
        linear = fit_linear(shapes, surface, term, self.visibility, start, stage1, pose_weights=np.maximum(still, 0.02))
        return self._refine(person.deformer, linear, surface, linear.coefficients)

    def transferred_guide(self, neutral: ScanFit, guide_weights: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the guide's expression carried to a fitted person (V, 3), model space, before any fit to its scan."""
        return neutral.vertices + self._prepare(neutral).shapes @ np.asarray(guide_weights, dtype=np.float64)

    def _prepare(self, neutral: ScanFit) -> _Person:
        """Return what all expressions of a person share: the last person's is kept."""
        if self._person is None or self._person.neutral is not neutral:
            faces = self.face.topology.faces
            transfer = DeformationTransfer(self.mean, neutral.vertices, faces)
            poses = transfer.transfer(self.mean + self.face.blendshape_deltas)
            shapes = np.ascontiguousarray((poses - neutral.vertices).transpose(1, 2, 0))
            self._person = _Person(neutral, shapes, LaplacianDeformer(faces, neutral.vertices))
        return self._person

    def _pose(self, shape: NDArray[np.float64], target: ScanTarget, still: NDArray[np.float64] | None) -> RigidMotion:
        """Return the first pose, by the landmarks with a 3D position; mostly by those that hold still."""
        fixed = self.landmarks.fixed
        used = fixed[np.isfinite(target.landmarks[fixed]).all(axis=1) & (target.confidence[fixed] > 0)]
        ids = self.landmarks.ids[used]
        weights = target.confidence[used] * (1.0 if still is None else np.maximum(still[ids], 0.01))
        return start_pose(shape[ids], target.landmarks[used], weights)

    def _refine(
        self,
        deformer: LaplacianDeformer,
        linear: Stage1Fit,
        surface: ScanSurface,
        weights: NDArray[np.float64] | None,
    ) -> ScanFit:
        """Stage 2, and the report; `weights` are blendshape weights, None at rest."""
        motion, faces, o = linear.target_from_model, self.face.topology.faces, self.options
        start = motion.apply(linear.vertices)
        candidates = self.visibility.candidates(start, vertex_normals(start, faces), surface)
        contact = self.contacts.term(weights, surface.target, motion.rotation, _CONTACT_STIFFNESS)

        def pulls(x: NDArray[np.float64], step: int) -> Pulls:
            matches = surface.match(x, vertex_normals(x, faces), candidates, Gates(_GATES_MM[step]))
            diagonal = np.full(len(x), _REST_WEIGHT)
            rhs = _REST_WEIGHT * start
            w = o.stage2_depth * _DEPTH_SHARE[step] * matches.weights
            diagonal[matches.vertices] += w
            rhs[matches.vertices] += w[:, None] * matches.points
            if o.use_landmarks:
                pull = self.landmarks.pulls(x, motion.rotation, surface.target)
                w = o.stage2_landmarks * pull.weights
                # what a projector lets free keeps its current value
                goals = x[pull.vertices] + np.einsum("nij,nj->ni", pull.projectors, pull.goals - x[pull.vertices])
                np.add.at(diagonal, pull.vertices, w)
                np.add.at(rhs, pull.vertices, w[:, None] * goals)
            return Pulls(diagonal, rhs + contact.rhs, contact.matrix) if o.contact else Pulls(diagonal, rhs)

        posed = deformer.deform(start, pulls, len(_DEPTH_SHARE), smoothness=o.stage2_laplacian)
        posed = unfold(start, posed, faces, self._adjacency)
        report = self._report({"stage1": start, "stage2": posed}, motion, surface, candidates)
        report["closed_share"] = contact.closed_share
        return ScanFit(
            vertices=motion.inverse().apply(posed),
            stage1_vertices=linear.vertices,
            coefficients=linear.coefficients,
            target_from_model=motion,
            report=report,
            landmark_offsets=self.landmarks.offsets(posed, surface.target) @ motion.rotation,
        )

    def _report(
        self,
        stages: dict[str, NDArray[np.float64]],
        motion: RigidMotion,
        surface: ScanSurface,
        candidates: NDArray[np.intp],
    ) -> dict[str, float | int | str]:
        report: dict[str, float | int | str] = {}
        for name, x in stages.items():
            matches = surface.match(x, vertex_normals(x, self.face.topology.faces), candidates, Gates(_REPORT_GATE_MM))
            distance = np.linalg.norm(x[matches.vertices] - matches.points, axis=1)
            report[f"{name}_rms_mm"] = float(np.sqrt((distance**2).mean())) if len(distance) else float("nan")
            report["matched"] = len(matches.vertices)
            report["matched_share"] = len(matches.vertices) / max(len(candidates), 1)
            residuals = self.landmarks.pulls(x, motion.rotation, surface.target).residuals_mm
            report["landmark_rms_mm"] = float(np.sqrt((residuals**2).mean())) if len(residuals) else float("nan")
        return report


@dataclass(frozen=True, eq=False)
class _Person:
    """What the expressions of one person share: transferred shapes (V, 3, 46) and the factored Laplacian."""

    neutral: ScanFit
    shapes: NDArray[np.float64]
    deformer: LaplacianDeformer
