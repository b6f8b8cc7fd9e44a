"""A performance carried to the head in a photo: which expression, pose and gaze each frame of the result has."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import FRONTAL
from facewright.errors import ValueRangeError
from facewright.fitting.gaze import gaze_of_axis, turn_of_gaze
from facewright.models.performance import Performance
from facewright.numeric.check import check_choice
from facewright.numeric.rotation import matrix_from_rotation_vector, nearest_rotation, rotation_vector_from_matrix

HEAD_MODES = ("follow", "keep", "scale")
REST_MODES = ("clip", "camera")
#: What a photo's head turns by at most, degrees, about x (nod), y (turn) and z (lean) of the head.
LIMITS_DEGREES = (14.0, 22.0, 20.0)
#: A photo's head is not turned further away from the camera than this, degrees, nod and turn, beyond where it is.
FARTHEST_DEGREES = (28.0, 40.0)
_LEAST_DEGREES = 6.0
_LINEAR = 0.6  # of a limit: up to here turns are carried as they are
#: The head turns about the top of the neck, model space, millimetres.
PIVOT = np.array([0.0, -50.0, -10.0])
_FARTHEST_GAZE = np.deg2rad([32.0, 24.0])
_EYE_CLOSED = 0.4
_FRAMES_FOR_REST = 12


@dataclass(frozen=True)
class MotionOptions:
    """How head and gaze are carried.

    Parameters
    ----------
    head : {"follow", "keep", "scale"}
        ``follow``: the photo's head turns as the actor's does, away from where it is in the photo; turns beyond what a
        photo can bear are limited softly. ``keep``: it stays. ``scale``: it turns by a share. Where the actor's head is
        does not enter, only how it is turned.
    head_scale : float
        The share, for ``scale``; in [0, 2].
    rest : {"clip", "camera"}
        Which pose and gaze of the actor mean those of the photo: the usual ones of the clip (the median over all frames
        of a shot that show the face; never those of the first frame), or a head and eyes that face the camera.
    """

    head: str = "follow"
    head_scale: float = 0.5
    rest: str = "clip"

    def __post_init__(self) -> None:
        check_choice("head", self.head, HEAD_MODES)
        check_choice("rest", self.rest, REST_MODES)
        if not (np.isfinite(self.head_scale) and 0 <= self.head_scale <= 2):
            raise ValueRangeError(f"head_scale must be in [0, 2], got {self.head_scale}.")


@dataclass(frozen=True, eq=False)
class PhotoMotion:
    """What a photo's person does in each of T frames.

    Parameters
    ----------
    times : ndarray of shape (T,), seconds
        When.
    weights : ndarray of shape (T, 46)
        FACS coefficients, absolute: those of the photo's own expression play no part.
    poses : tuple of RigidMotion
        camera_from_model.
    gaze : ndarray of shape (T, 2, 2), radians
        Of the right and left eyeball, relative to the head.
    notes : tuple of str
        What a user should know: sentences.
    """

    times: NDArray[np.float64]
    weights: NDArray[np.float64]
    poses: tuple[RigidMotion, ...]
    gaze: NDArray[np.float64]
    notes: tuple[str, ...] = ()

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return len(self.times)


def carry_to_photo(
    performance: Performance,
    pose: RigidMotion,
    gaze: NDArray[np.float64],
    names: tuple[str, ...],
    options: MotionOptions | None = None,
    cuts: NDArray[np.bool_] | None = None,
) -> PhotoMotion:
    """Carry a performance to the head in a photo.

    Coefficients are taken as they are. The turn of the actor's head away from its rest turns the photo's head away from
    its own pose, in the head's own axes and about the top of the neck. Eyes keep their direction in space: where the
    photo's head turns less than the actor's, its eyes turn more.

    Parameters
    ----------
    performance : Performance
        Every frame filled, see `facewright.apps.untracked_frames`.
    pose : RigidMotion
        The photo's camera_from_model.
    gaze : ndarray of shape (2, 2), radians
        The photo's.
    names : tuple of str
        Shapes of the photo's rig; those that the performance lacks stay zero.
    options : MotionOptions, optional
        Defaults where absent.
    cuts : ndarray of shape (T,), bool, optional
        Frames that begin another shot: each shot has a rest of its own.
    """
    options = options or MotionOptions()
    weights = np.zeros((performance.n_frames, len(names)))
    known = [name for name in performance.names if name in names]
    weights[:, [names.index(n) for n in known]] = performance.weights[:, [performance.names.index(n) for n in known]]
    turns, looks = np.zeros((performance.n_frames, 3)), np.zeros_like(performance.gaze)
    for shot in _shots(performance, cuts):
        rest_turn, rest_gaze = _rest(performance, shot, options.rest)
        turns[shot] = rotation_vector_from_matrix(rest_turn.T @ performance.rotations[shot])
        looks[shot] = gaze + performance.gaze[shot] - rest_gaze
    share = {"follow": 1.0, "keep": 0.0, "scale": options.head_scale}[options.head]
    limits = _limits(pose)
    applied = soft_limit(share * turns, limits)
    limited = int((np.abs(applied - share * turns) > np.deg2rad(1.0)).any(axis=1).sum())
    actor, photo = matrix_from_rotation_vector(turns), matrix_from_rotation_vector(applied)
    poses = tuple(pose if not turn.any() else _turned(pose, R) for turn, R in zip(applied, photo))
    looks = _look(looks, np.swapaxes(photo, 1, 2) @ actor)
    notes: tuple[str, ...] = ()
    if limited:
        most = "/".join(f"{limit:.0f}" for limit in np.rad2deg(limits))
        notes = (
            f"in {limited} of {performance.n_frames} frames the head turns farther than this photo can bear; turns are "
            f"limited softly to {most} degrees (nod/turn/lean).",
        )
    return PhotoMotion(performance.times, weights, poses, looks, notes)


def soft_limit(turns: NDArray[np.float64], limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values (..., K) as they are up to 0.6 of their limit (K,), beyond that ever closer to the limit."""
    straight = _LINEAR * limits
    room = limits - straight
    beyond = np.maximum(np.abs(turns) - straight, 0.0)
    limited = np.sign(turns) * (straight + room * -np.expm1(-beyond / room))
    return np.where(beyond > 0, limited, turns)


def _shots(performance: Performance, cuts: NDArray[np.bool_] | None) -> list[slice]:
    """Return the shots, in order; one too short for a rest of its own belongs to the one before."""
    starts = [] if cuts is None else [int(k) for k in np.flatnonzero(cuts) if k > 0]
    long = [
        a for a, b in pairwise([*starts, performance.n_frames]) if performance.tracked[a:b].sum() >= _FRAMES_FOR_REST
    ]
    return [slice(a, b) for a, b in pairwise([0, *long, performance.n_frames])]


def _rest(performance: Performance, shot: slice, mode: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rotation and gaze of the actor that mean the photo's."""
    if mode == "camera":
        return FRONTAL, np.zeros((2, 2))
    rotations, gaze, seen = performance.rotations[shot], performance.gaze[shot], performance.tracked[shot]
    seen = seen if seen.any() else np.ones(len(seen), bool)
    mean = nearest_rotation(rotations[seen].mean(axis=0))
    turns = rotation_vector_from_matrix(mean.T @ rotations[seen])
    middle = mean @ matrix_from_rotation_vector(np.median(turns, axis=0))
    blinks = [k for k, name in enumerate(performance.names) if name.startswith("eyeBlink")]
    opened = seen & (performance.weights[shot][:, blinks].max(axis=1, initial=0.0) < _EYE_CLOSED)
    return middle, np.median(gaze[opened if opened.any() else seen], axis=0)


def _limits(pose: RigidMotion) -> NDArray[np.float64]:
    """Return the largest turns, radians; less for a head that is turned already."""
    limits = np.deg2rad(LIMITS_DEGREES)
    nod, turn, _ = np.abs(rotation_vector_from_matrix(FRONTAL @ pose.rotation))
    room = np.deg2rad(FARTHEST_DEGREES) - [nod, turn]
    limits[:2] = np.clip(room, np.deg2rad(_LEAST_DEGREES), limits[:2])
    return limits


def _turned(pose: RigidMotion, turn: NDArray[np.float64]) -> RigidMotion:
    """Return the pose of a head that turns about the top of its neck."""
    return pose.after(RigidMotion(turn, PIVOT - turn @ PIVOT))


def _look(gaze: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return gaze (T, 2, 2) after `turn` (T, 3, 3), limited to what eyes can do."""
    result = np.empty_like(gaze)
    still = np.abs(turn - np.eye(3)).max(axis=(1, 2)) < 1e-12
    for k, both in enumerate(gaze):
        for eye, (yaw, pitch) in enumerate(both):
            if still[k]:
                result[k, eye] = yaw, pitch
            else:
                result[k, eye] = gaze_of_axis(turn[k] @ turn_of_gaze(yaw, pitch)[:, 2])
    return soft_limit(result, _FARTHEST_GAZE)
