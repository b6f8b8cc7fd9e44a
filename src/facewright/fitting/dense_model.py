"""The bilinear model at the points that a video is fitted with, and one frame's residuals and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion, pixel_by_point
from facewright.camera.rotation import rotation_from_vector
from facewright.fitting.energies.identity_prior import IdentityPrior
from facewright.landmarks.dense import DensePoints, dense_points, head_plane, pose_terms
from facewright.models.bilinear import BilinearModel

#: Identity axes that move the points by less, root mean square per coordinate, are left at their mean.
_SMALLEST_EFFECT_MM = 0.06
#: A point of the head's middle, in model space, about which it turns, millimetres.
CENTRE = np.array([0.0, 0.0, 40.0])
#: Rotation about the middle, pixel of the middle, logarithm of the scale there.
N_POSE = 6


@dataclass(frozen=True, eq=False)
class FramePose:
    """Where the head is in a frame.

    Parameters
    ----------
    motion : RigidMotion
        camera_from_model.
    intrinsics : Intrinsics
        The camera, of equal focal lengths.
    """

    motion: RigidMotion
    intrinsics: Intrinsics

    @property
    def scale(self) -> float:
        """Pixels per millimetre at the head's middle."""
        return self.intrinsics.focal_x / float(self.motion.apply(CENTRE)[2])

    def moved(self, step: NDArray[np.float64]) -> FramePose:
        """Return the pose after a step (6,): rotation vector, pixels of the middle, logarithm of the scale."""
        rotation = rotation_from_vector(step[:3]) @ self.motion.rotation
        middle = self.motion.apply(CENTRE)
        middle = (middle + np.array([*(step[3:5] / self.scale), 0.0])) * np.exp(-step[5])
        return FramePose(RigidMotion(rotation, middle - rotation @ CENTRE), self.intrinsics)

    def zoomed(self, log_focal: float) -> FramePose:
        """Return the pose seen through another lens, farther away by as much as the focal length is longer."""
        K = self.intrinsics
        focal = K.focal_x * float(np.exp(log_focal))
        middle = self.motion.apply(CENTRE)
        middle[2] *= np.exp(log_focal)
        motion = RigidMotion(self.motion.rotation, middle - self.motion.rotation @ CENTRE)
        return FramePose(motion, Intrinsics(focal, focal, K.centre_x, K.centre_y))


@dataclass(frozen=True, eq=False)
class ClipPerson:
    """What all frames of a clip share: a person's points, and the detector's habits with them.

    Parameters
    ----------
    c : ndarray of shape (I,)
        Identity, in standard deviations along the prior's axes.
    q : ndarray of shape (M,)
        The detector's departure for this person, in standard deviations of `DensePoints.person_modes`.
    neutral : ndarray of shape (N, 3), millimetres
        Points at rest.
    deltas : ndarray of shape (N, 3, B), millimetres
        Points' displacement by each blendshape.
    departure : ndarray of shape (N, 2), millimetres
        offset + q @ person_modes.
    """

    c: NDArray[np.float64]
    q: NDArray[np.float64]
    neutral: NDArray[np.float64]
    deltas: NDArray[np.float64]
    departure: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameSystem:
    """A frame's K whitened residuals and their derivatives.

    Parameters
    ----------
    residual : ndarray of shape (K,)
        Detected minus predicted.
    by_own : ndarray of shape (K, 6 + B)
        By the frame's pose step and coefficients.
    by_shared : ndarray of shape (K, I + M + 1) or None
        By identity, the detector's departure and the logarithm of the focal length.
    """

    residual: NDArray[np.float64]
    by_own: NDArray[np.float64]
    by_shared: NDArray[np.float64] | None


class DenseModel:
    """The model at the detector's points, whitened along identity, as blendshapes.

    Parameters
    ----------
    model : BilinearModel
        The model.
    points : DensePoints, optional
        What the detector's points are on its mesh; looked up by the model's topology where absent.
    rest_freedom : float
        Standard deviation, in each whitened direction, of what a person's face at rest differs by beyond the model and
        the measured habits; 0 trusts them.

    Raises
    ------
    TopologyError
        If it is not known what the detector's points are on the model's mesh.
    """

    def __init__(self, model: BilinearModel, points: DensePoints | None = None, rest_freedom: float = 1.0) -> None:
        self.points = _with_free_modes(points or dense_points(model.topology), rest_freedom)
        u = model.expression_weights
        mixtures = np.concatenate([u[:1], u[1:] - u[0]])  # neutral and displacements, (1 + B, E)
        core = np.einsum("lcie,be->bicl", model.at_vertices(self.points.vertices).core, mixtures, optimize=True)
        prior = IdentityPrior.of(model)
        effect = np.einsum("icl,ik->clk", core[0], prior.axes, optimize=True)
        self.prior = prior.ordered_by(effect.reshape(-1, effect.shape[2]), _SMALLEST_EFFECT_MM)
        basis = np.column_stack([self.prior.mean, self.prior.axes])
        # (1 + I, 1 + B, N, 3): row 0 the mean person, column 0 the neutral
        self.core = np.ascontiguousarray(np.einsum("bicl,ik->kblc", core, basis, optimize=True), dtype=np.float32)
        self._mean, self._axes = self.core[0], self.core[1:].reshape(len(self.core) - 1, -1)
        self.names = model.expression_names[1:]
        self.response = self._response()
        self._whitening = np.ascontiguousarray(self.points.whitening, dtype=np.float32)
        self._by_q = -self.points.whitening @ self.points.person_modes.reshape(self.n_modes, -1).T

    def _response(self) -> NDArray[np.float64]:
        """Return the detector's response to the model's own shapes, (N, 2, B)."""
        known = {name: i for i, name in enumerate(self.points.blendshape_names)}
        response = np.zeros((self.points.n_points, 2, len(self.names)))
        for j, name in enumerate(self.names):
            if name in known:
                response[:, :, j] = self.points.expression_response[known[name]]
        return response

    @property
    def n_identity(self) -> int:
        """Number I of identity axes."""
        return len(self._axes)

    @property
    def n_modes(self) -> int:
        """Number M of the detector's person modes."""
        return len(self.points.person_modes)

    @property
    def n_shapes(self) -> int:
        """Number B of blendshapes."""
        return len(self.names)

    def person(self, c: NDArray[np.float64], q: NDArray[np.float64]) -> ClipPerson:
        """Return the points of a person."""
        core = self._mean + (np.asarray(c, dtype=np.float32) @ self._axes).reshape(self._mean.shape)
        departure = self.points.offset + np.tensordot(q, self.points.person_modes, 1)
        deltas = np.ascontiguousarray(core[1:].transpose(1, 2, 0), dtype=np.float64)
        return ClipPerson(np.asarray(c), np.asarray(q), core[0].astype(np.float64), deltas, departure)

    def identity_of(self, person: ClipPerson) -> NDArray[np.float64]:
        """Return w_id of a person."""
        return self.prior.weights(person.c)

    def detected(self, points478: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the detector's points (478, 2) as the model's (N, 2)."""
        return self.points.sources @ np.asarray(points478, dtype=np.float64)

    def predict(self, person: ClipPerson, pose: FramePose, beta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the detector should find the points (N, 2), pixels."""
        points = person.neutral + person.deltas @ beta
        into_pixels = np.linalg.inv(head_plane(pose.motion.rotation, pose.scale))
        return pose.intrinsics.project(pose.motion.apply(points)) + self._habits(person, pose, beta) @ into_pixels.T

    def _habits(self, person: ClipPerson, pose: FramePose, beta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the detector's departure from the vertices (N, 2), millimetres."""
        by_pose = np.tensordot(pose_terms(pose.motion.rotation), self.points.pose_response, 1)
        return person.departure + by_pose + self.response @ beta

    def residual(
        self,
        found: NDArray[np.float64],
        person: ClipPerson,
        pose: FramePose,
        beta: NDArray[np.float64],
        plane: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return the whitened residual (K,) of the model's points `found` (N, 2), in the pose's plane or another."""
        points = person.neutral + person.deltas @ beta
        if plane is None:
            plane = head_plane(pose.motion.rotation, pose.scale)
        difference = (found - pose.intrinsics.project(pose.motion.apply(points))) @ plane.T
        whole = (difference - self._habits(person, pose, beta)).astype(np.float32)
        return (self._whitening @ whole.reshape(-1)).astype(np.float64)

    def system(
        self,
        found: NDArray[np.float64],
        person: ClipPerson,
        pose: FramePose,
        beta: NDArray[np.float64],
        *,
        shared: bool = False,
    ) -> FrameSystem:
        """Return the residual and its derivatives.

        The plane in which it is measured is held still: a residual in millimetres shrinks where the head is taken to
        be large, and would draw it there.
        """
        N, B = self.points.n_points, self.n_shapes
        points = person.neutral + person.deltas @ beta
        seen = pose.motion.apply(points)
        plane = head_plane(pose.motion.rotation, pose.scale)
        by_camera = plane @ pixel_by_point(seen, pose.intrinsics)  # (N, 2, 3)
        by_model = by_camera @ pose.motion.rotation
        middle = pose.motion.apply(CENTRE)
        arms = seen - middle
        n_shared = self.n_identity + 1 if shared else 0
        J = np.empty((N, 2, N_POSE + B + n_shared), dtype=np.float32)
        J[:, :, 0] = by_camera[:, :, 2] * arms[:, 1, None] - by_camera[:, :, 1] * arms[:, 2, None]
        J[:, :, 1] = by_camera[:, :, 0] * arms[:, 2, None] - by_camera[:, :, 2] * arms[:, 0, None]
        J[:, :, 2] = by_camera[:, :, 1] * arms[:, 0, None] - by_camera[:, :, 0] * arms[:, 1, None]
        J[:, :, 3:5] = by_camera[:, :, :2] / pose.scale
        J[:, :, 5] = -by_camera @ middle
        J[:, :, :3] += np.einsum("kw,knr->nrw", _pose_terms_by_turn(pose.motion.rotation), self.points.pose_response)
        J[:, :, N_POSE : N_POSE + B] = by_model @ person.deltas + self.response
        if shared:
            moved = np.concatenate([[1.0], beta]).astype(np.float32) @ self.core[1:].reshape(self.n_identity, 1 + B, -1)
            axes = moved.reshape(self.n_identity, N, 3)
            J[:, :, N_POSE + B : -1] = by_model @ axes.transpose(1, 2, 0)
            K = pose.intrinsics
            from_centre = pose.intrinsics.project(seen) - [K.centre_x, K.centre_y]
            J[:, :, -1] = from_centre @ plane.T + by_camera[:, :, 2] * middle[2]
        difference = (found - pose.intrinsics.project(seen)) @ plane.T - self._habits(person, pose, beta)
        white = self._whitening @ np.concatenate(
            [J.reshape(2 * N, -1), difference.reshape(-1, 1)], axis=1, dtype=np.float32
        )
        white = white.astype(np.float64)
        by_shared = None
        if shared:
            by_c, by_focal = -white[:, N_POSE + B : -2], -white[:, -2:-1]
            by_shared = np.concatenate([by_c, self._by_q, by_focal], axis=1)
        return FrameSystem(white[:, -1], -white[:, : N_POSE + B], by_shared)


def _pose_terms_by_turn(rotation: NDArray[np.float64], h: float = 1e-4) -> NDArray[np.float64]:
    """Return the derivative (6, 3) of `pose_terms` by a rotation vector, by central differences."""
    turned = [[rotation_from_vector(sign * h * axis) @ rotation for axis in np.eye(3)] for sign in (1.0, -1.0)]
    terms = pose_terms(np.array(turned))
    return (terms[0] - terms[1]).T / (2.0 * h)


def _with_free_modes(points: DensePoints, freedom: float) -> DensePoints:
    """Return the points with one more person mode for each whitened direction."""
    if freedom <= 0:
        return points
    free = freedom * np.linalg.pinv(points.whitening).T.reshape(-1, points.n_points, 2)
    return replace(points, person_modes=np.concatenate([points.person_modes, free]))
