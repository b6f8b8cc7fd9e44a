"""What the points of one photo tell of a person's shape, and what two photos lose when they must share it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.fitting.clip_person import ClipPersonFitter, KeyFrame
from facewright.fitting.dense_model import N_POSE, DenseModel
from facewright.fitting.energies.coefficient_terms import CoefficientTerms
from facewright.fitting.energies.expression_prior import ExpressionPrior
from facewright.fitting.perspective_refinement import CameraPrior
from facewright.landmarks.points import Landmarks
from facewright.models.bilinear import BilinearModel
from facewright.numeric.check import check_choice

_INSIDE = 1e-6
#: Standard deviation of the focal length's logarithm, where it is known and where it is guessed.
_KNOWN_LENS, _GUESSED_LENS = 0.05, 0.4
#: Share of the points' information that is believed: the detector's errors are not as independent as its calibration
#: on renders has them.
_BELIEVED = 0.3


@dataclass(frozen=True, eq=False)
class ShapeEvidence:
    """A photo's log likelihood -x^T H x / 2 + b^T x of identity and the detector's habits x, pose and expression gone.

    Parameters
    ----------
    information : ndarray of shape (K, K)
        H; the prior, of which x has mean zero and unit covariance, is not in it.
    vector : ndarray of shape (K,)
        b.
    """

    information: NDArray[np.float64]
    vector: NDArray[np.float64]

    def __add__(self, other: ShapeEvidence) -> ShapeEvidence:
        """Return what two photos of one person tell."""
        return ShapeEvidence(self.information + other.information, self.vector + other.vector)

    def gain(self) -> float:
        """Return how much the best x is more likely, with the prior, than the mean person: a log likelihood."""
        A = _BELIEVED * self.information + np.eye(len(self.vector))
        b = _BELIEVED * self.vector
        return 0.5 * float(b @ np.linalg.solve(A, b))


class ShapeWitness:
    """Tells a person's shape from MediaPipe's 478 points; keeps what does not depend on the photo.

    Parameters
    ----------
    model : BilinearModel
        The model.

    Raises
    ------
    TopologyError
        If it is not known what the detector's points are on the model's mesh.
    """

    def __init__(self, model: BilinearModel) -> None:
        self.dense = DenseModel(model)
        self._terms = CoefficientTerms.of(self.dense.names, ExpressionPrior(0.35, 4.0))

    def evidence(
        self, landmarks: Landmarks, image_size: tuple[int, int], focal_length: float | None = None
    ) -> ShapeEvidence:
        """Return what a photo tells.

        Parameters
        ----------
        landmarks : Landmarks
            Scheme ``mediapipe478``.
        image_size : (height, width)
            Of the photo.
        focal_length : float, optional
            Pixels, where it is known.

        Raises
        ------
        ValueRangeError
            If the landmarks are of another scheme.
        """
        check_choice("scheme", landmarks.scheme, ("mediapipe478",))
        known = focal_length is not None
        guess = focal_length if focal_length is not None else Intrinsics.for_image(image_size).focal_x
        lens = CameraPrior(guess, _KNOWN_LENS if known else _GUESSED_LENS)
        found = self.dense.detected(landmarks.points)
        frame = KeyFrame(found, self._terms)
        person, _, (state,) = ClipPersonFitter(self.dense, lens).fit([frame], image_size)
        system = self.dense.system(found, person, state.pose, state.beta, shared=True)
        assert system.by_shared is not None
        # pose, coefficients off their bounds and the lens follow x to first order
        inside = (state.beta > _INSIDE) & (state.beta < 1.0 - _INSIDE)
        follow = np.concatenate([np.arange(N_POSE), N_POSE + np.flatnonzero(inside)])
        own = np.column_stack([system.by_own[:, follow], system.by_shared[:, -1]])
        shared = system.by_shared[:, :-1]
        block = own.T @ own + 1e-9 * np.eye(own.shape[1])
        block[N_POSE:-1, N_POSE:-1] += self._terms.hessian[np.ix_(inside, inside)]
        block[-1, -1] += 1.0 / lens.spread**2
        coupling = own.T @ shared
        H = shared.T @ shared - coupling.T @ np.linalg.solve(block, coupling)
        x = np.concatenate([person.c, person.q])
        return ShapeEvidence(H, H @ x + x)  # at the best x the likelihood's slope is the prior's


def sharing_loss(first: ShapeEvidence, second: ShapeEvidence) -> float:
    """Return how much less likely two photos are of one shape than of a shape each, at their best: a log likelihood.

    Negative where one shape needs less of the prior than two.
    """
    return first.gain() + second.gain() - (first + second).gain()
