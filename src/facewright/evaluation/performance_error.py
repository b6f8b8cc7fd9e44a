"""How far an estimated performance is from the truth: coefficients by shape group, jitter, head pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_angle
from facewright.faces.simulate import SimulatedPerson
from facewright.fitting.video import VideoFit
from facewright.models.performance import Performance

#: Shapes by the start of their names.
SHAPE_GROUPS: dict[str, tuple[str, ...]] = {
    "blink": ("eyeBlink",),
    "lids": ("eyeSquint", "eyeWide", "eyesLookDown"),
    "brows": ("brow",),
    "cheek_puff": ("cheekPuff",),
    "cheek_squint": ("cheekSquint",),
    "nose": ("noseSneer",),
    "jaw_open": ("jawOpen",),
    "jaw_sideways": ("jawLeft", "jawRight"),
    "jaw_forward": ("jawForward",),
    "mouth_close": ("mouthClose",),
    "smile": ("mouthSmile", "mouthDimple"),
    "pucker": ("mouthPucker", "mouthFunnel"),
    "mouth_sideways": ("mouthLeft", "mouthRight"),
    "frown": ("mouthFrown", "mouthShrugLower"),
    "lips": ("mouthUpperUp", "mouthLowerDown", "mouthStretch", "mouthRoll", "mouthPress"),
}
#: A shape is acted from here on, and found if the estimate has at least half of it.
ACTED = 0.3
#: Shapes with more than this take part in a frame; most of the others rest, and would rule a plain mean.
ACTIVE = 0.1
#: An estimate of this much claims that the shape is acted; the claim holds if the truth has at least `REAL`.
CLAIMED, REAL = 0.2, 0.05


def coefficient_errors(
    found: NDArray[np.floating], truth: NDArray[np.floating], names: Sequence[str]
) -> dict[str, float]:
    """Compare coefficients.

    Parameters
    ----------
    found, truth : ndarray of shape (T, B)
        FACS coefficients.
    names : sequence of str
        Of the B shapes.

    Returns
    -------
    dict of str to float
        ``coefficient_mae``; ``neutral_mae``, that of zero coefficients; ``active_mae`` and ``neutral_active_mae``, over
        the frames and shapes with more than 0.1 in truth; ``resting_mae``, over the others; for each of `SHAPE_GROUPS`
        ``correlation_``; ``recall_``, the share of frames and shapes at 0.3 or more that the estimate has at no less
        than half; and ``precision_``, the share of the estimate's claims (0.2 or more) with at least 0.05 in truth.
        What is never acted, or never claimed, is left out.
    """
    result = {"coefficient_mae": float(np.abs(found - truth).mean()), "neutral_mae": float(np.abs(truth).mean())}
    error, active = np.abs(found - truth), truth > ACTIVE
    if active.any():
        result |= {"active_mae": float(error[active].mean()), "neutral_active_mae": float(truth[active].mean())}
    if not active.all():
        result["resting_mae"] = float(error[~active].mean())
    for group, starts in SHAPE_GROUPS.items():
        columns = [i for i, name in enumerate(names) if name.startswith(starts)]
        e, t = found[:, columns].ravel(), truth[:, columns].ravel()
        acted, claimed = t >= ACTED, e >= CLAIMED
        if t.std() > 0:
            result[f"correlation_{group}"] = float(np.corrcoef(e, t)[0, 1]) if e.std() > 0 else 0.0
        if acted.any():
            result[f"recall_{group}"] = float((e[acted] >= 0.5 * t[acted]).mean())
        if claimed.any():
            result[f"precision_{group}"] = float((t[claimed] >= REAL).mean())
    return result


def lip_gaps(
    meshes: NDArray[np.floating], pairs: tuple[NDArray[np.integer], NDArray[np.integer]]
) -> NDArray[np.float64]:
    """Return the distance between the lips' inner edges, (T,), millimetres: the middle half of the contact pairs.

    Parameters
    ----------
    meshes : ndarray of shape (T, V, 3), millimetres
        A face over time.
    pairs : two ndarrays of int
        Vertices that meet when the lips close, upper and lower, from one corner to the other.
    """
    upper, lower = pairs
    middle = slice(len(upper) // 4, len(upper) - len(upper) // 4)
    return np.linalg.norm(meshes[:, upper[middle]] - meshes[:, lower[middle]], axis=2).mean(axis=1).astype(np.float64)


def jitter(values: NDArray[np.floating], frames: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the mean absolute second difference over columns at the frames that lie between two chosen ones."""
    inner = frames[1:-1] & frames[2:] & frames[:-2]
    return np.abs(np.diff(values, 2, axis=0)).mean(axis=1)[inner]


def head_jitter(rotations: NDArray[np.float64], frames: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the head's angular acceleration, degrees per frame squared, at the frames between two chosen ones."""
    turns = Rotation.from_matrix(rotations)
    speed = (turns[:-1].inv() * turns[1:]).as_rotvec(degrees=True)
    inner = frames[1:-1] & frames[2:] & frames[:-2]
    return np.linalg.norm(np.diff(speed, axis=0), axis=1)[inner]


def pose_degrees(found: Performance, truth: Performance) -> NDArray[np.float64]:
    """Return the angle between the heads of each frame, (T,), degrees."""
    pairs = zip(found.rotations, truth.rotations, strict=True)
    return np.rad2deg([rotation_angle(a, b) for a, b in pairs])


def point_distances(
    person: SimulatedPerson,
    truth: Performance,
    intrinsics: Intrinsics,
    fit: VideoFit,
    vertices: NDArray[np.integer],
    eyes: Sequence[NDArray[np.integer]],
) -> NDArray[np.float64]:
    """Return how far vertices of the fitted mesh lie from the true ones in the picture, (T,).

    Parameters
    ----------
    person, truth, intrinsics : SimulatedPerson, Performance, Intrinsics
        Who acts what before which camera.
    fit : VideoFit
        What was found.
    vertices : ndarray of int
        Vertices that are compared; the mean of their distances is taken.
    eyes : two ndarrays of int
        Vertices of either eye; distances are shares of that between their true middles in the frame.
    """
    rig = fit.identity.rig
    distances = np.empty(truth.n_frames)
    ids = np.concatenate([vertices, *eyes])
    count, split = len(vertices), len(vertices) + len(eyes[0])
    ours = rig.neutral[vertices] + np.tensordot(fit.performance.weights, rig.deltas[:, vertices], 1)
    true = person.neutral[ids] + np.tensordot(truth.weights, person.deltas[:, ids], 1)
    for k in range(truth.n_frames):
        acted = fit.performance
        found = fit.identity.intrinsics.project(RigidMotion(acted.rotations[k], acted.translations[k]).apply(ours[k]))
        seen = intrinsics.project(RigidMotion(truth.rotations[k], truth.translations[k]).apply(true[k]))
        apart = seen[count:split].mean(axis=0) - seen[split:].mean(axis=0)
        distances[k] = np.linalg.norm(found - seen[:count], axis=1).mean() / np.linalg.norm(apart)
    return distances
