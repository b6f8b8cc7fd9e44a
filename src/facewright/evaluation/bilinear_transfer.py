"""Transfer of bilinear expression weights from one person to another, beside blendshape coefficients (Fig. 14)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.fitting.dense_model import N_POSE, FramePose
from facewright.fitting.video import VideoFit, VideoFitter
from facewright.landmarks.track import LandmarkTrack
from facewright.models.bilinear import BilinearModel


def bilinear_expression(fitter: VideoFitter, track: LandmarkTrack, fit: VideoFit, frame: int) -> NDArray[np.float64]:
    """Return w_exp (E,) of a frame: free of bounds and shapes, with the model's Gaussian prior, as in [5] of the paper.

    Person, lens and the detector's habits are those of the video's fit; the head follows to first order.
    """
    model, dense = fitter.model, fitter.dense
    u = model.expression_weights
    mixture = u[1:] - u[0]  # (B, E): w_exp = u_0 + beta mixture spans what the shapes span
    performance = fit.performance
    pose = FramePose(
        RigidMotion(performance.rotations[frame], performance.translations[frame]), fit.identity.intrinsics
    )
    beta = performance.weights[frame]
    system = dense.system(dense.detected(track.points[frame]), fit.identity.person, pose, beta)
    head, shapes = system.by_own[:, :N_POSE], system.by_own[:, N_POSE:]
    turned = np.linalg.lstsq(head, np.column_stack([shapes, system.residual]), rcond=None)[0]
    A = shapes - head @ turned[:, :-1]
    y = A @ beta - (system.residual - head @ turned[:, -1])
    P = mixture @ model.expression_precision @ mixture.T
    wanted = mixture @ model.expression_precision @ (model.expression_mean - u[0])
    free = np.linalg.solve(A.T @ A + P + 1e-6 * np.eye(len(P)), A.T @ y + wanted)
    return u[0] + free @ mixture


def transfer_errors(
    model: BilinearModel,
    w_id: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    expressions: NDArray[np.float64],
    truth: NDArray[np.floating],
    region: NDArray[np.integer],
) -> tuple[float, float, float]:
    """Return the RMS error, millimetres over a region, of another person's motion by shapes, by w_exp and without any.

    Parameters
    ----------
    model : BilinearModel
        The model.
    w_id : ndarray of shape (I,)
        The other person in the model.
    coefficients : ndarray of shape (T, B)
        FACS coefficients of the actor.
    expressions : ndarray of shape (T, E)
        Bilinear expression weights of the actor.
    truth : ndarray of shape (T, V, 3), millimetres
        Displacement from rest that the other person's own face has at the true coefficients.
    region : ndarray of int
        Vertices that count.
    """
    rig = model.blendshapes(w_id)
    person = model.person(w_id)[:, region]
    wanted = np.asarray(truth, dtype=np.float64)[:, region]
    by_shapes = np.tensordot(coefficients, rig.deltas[:, region].astype(np.float64), 1)
    by_weights = np.tensordot(expressions, person, 1) - rig.neutral[region]
    errors = (by_shapes - wanted, by_weights - wanted, wanted)
    return tuple(float(np.sqrt((error**2).sum(axis=2).mean())) for error in errors)  # type: ignore[return-value]
