"""Where the eyes look: the turn of each eyeball that brings its iris to where the picture shows it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.faces.face import Face
from facewright.faces.rigid_motion import rigid_vertices
from facewright.numeric.check import check_shape

#: Right and left, as in `Performance.gaze`.
SIDES = ("right", "left")
#: Farthest turn of an eye, radians: 45 degrees.
_FARTHEST = np.pi / 4


def turn_of_gaze(yaw: float, pitch: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) of an eyeball in model space; yaw to the subject's left (+x), pitch upwards."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cp, sp], [0.0, -sp, cp]])  # turns +z up
    return about_y @ about_x


def eyeball_of(face: Face, side: str) -> NDArray[np.intp]:
    """Return the vertices of one eyeball, ``"right"`` or ``"left"``."""
    return rigid_vertices(face, f"eyeball_{side}")


def eyeball_frame(
    face: Face, side: str, vertices: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centre (3,) and unit axis (3,) through the iris of an eyeball of vertices (V, 3), model space."""
    ball = np.asarray(vertices, dtype=np.float64)[eyeball_of(face, side)]
    centre = 0.5 * (ball.min(axis=0) + ball.max(axis=0))
    iris = np.asarray(vertices, dtype=np.float64)[face.topology.masks[f"iris_{side}"]].mean(axis=0) - centre
    # the mean of the ball's vertices is pulled to the finer front, the box's middle by the cornea: the globe behind
    behind = ball[(ball - centre) @ iris < 0]
    if len(behind) >= 8:
        centre = _sphere_centre(behind)
    axis = np.asarray(vertices, dtype=np.float64)[face.topology.masks[f"iris_{side}"]].mean(axis=0) - centre
    return centre, axis / np.linalg.norm(axis)


def _sphere_centre(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the centre of the sphere through points (N, 3), least squares."""
    middle = points.mean(axis=0)
    p = points - middle
    A = np.concatenate([2.0 * p, np.ones((len(p), 1))], axis=1)
    return np.asarray(np.linalg.lstsq(A, (p**2).sum(axis=1), rcond=None)[0][:3]) + middle


class Eyeballs:
    """Both eyeballs of a person at rest, to be turned by a gaze.

    Parameters
    ----------
    face : Face
        All parts of it.
    neutral : ndarray of shape (V, 3), millimetres
        The person at rest, in model space.
    """

    def __init__(self, face: Face, neutral: NDArray[np.floating]) -> None:
        rest = np.asarray(neutral, dtype=np.float64)
        self._balls = []
        for side in SIDES:
            ids = eyeball_of(face, side)
            centre, axis = eyeball_frame(face, side, rest)
            straight = (rest[ids] - centre) @ turn_of_gaze(*gaze_of_axis(axis))  # undoes the turn at rest
            self._balls.append((ids, centre, straight))

    def turn(self, vertices: NDArray[np.float64], gaze: NDArray[np.floating]) -> None:
        """Put the eyeballs, turned by `gaze` (2, 2), into `vertices` (V, 3), in place.

        They keep their exact shape and place; blendshapes that turn them (a look down) are without effect, since the
        gaze says it all.
        """
        check_shape("gaze", gaze, 2, 2)
        for (ids, centre, straight), (yaw, pitch) in zip(self._balls, np.asarray(gaze, np.float64), strict=True):
            vertices[ids] = straight @ turn_of_gaze(yaw, pitch).T + centre


def gaze_of_axis(axis: NDArray[np.floating]) -> tuple[float, float]:
    """Return yaw and pitch of a direction (3,) in model space."""
    x, y, z = axis / np.linalg.norm(axis)
    return float(np.arctan2(x, z)), float(np.arcsin(np.clip(y, -1.0, 1.0)))


def find_gaze(
    face: Face,
    vertices: NDArray[np.floating],
    irises: NDArray[np.floating],
    intrinsics: Intrinsics,
    camera_from_model: RigidMotion,
) -> NDArray[np.float64]:
    """Find the gaze from the centres of the irises.

    The ray through an iris's centre meets the sphere on which the eyeball carries the iris; the nearer point, seen
    from the ball's centre, is where the eye looks. A ray that misses the sphere takes its nearest point.

    Parameters
    ----------
    face : Face
        All parts of it.
    vertices : ndarray of shape (V, 3), millimetres
        The person, in model space; the turn of the eyeballs does not matter.
    irises : ndarray of shape (2, 2), pixels
        Centres of the right and the left iris; NaN where unknown.
    intrinsics, camera_from_model
        The camera.

    Returns
    -------
    ndarray of shape (2, 2), radians
        Yaw and pitch of the right and the left eyeball relative to the head; an eye without an iris takes the other's,
        and both look straight ahead without any.
    """
    check_shape("irises", irises, 2, 2)
    gaze = np.full((2, 2), np.nan)
    inverse = camera_from_model.inverse()
    eye = inverse.translation  # the camera's centre in model space
    for k, side in enumerate(SIDES):
        if not np.isfinite(irises[k]).all():
            continue
        x, y = irises[k]
        ray = np.array(
            [(x - intrinsics.centre_x) / intrinsics.focal_x, (y - intrinsics.centre_y) / intrinsics.focal_y, 1.0]
        )
        ray = inverse.rotation @ (ray / np.linalg.norm(ray))
        centre, _ = eyeball_frame(face, side, vertices)
        iris = np.asarray(vertices, dtype=np.float64)[face.topology.masks[f"iris_{side}"]].mean(axis=0)
        radius = float(np.linalg.norm(iris - centre))
        along = float((centre - eye) @ ray)
        off = float(np.linalg.norm(eye + along * ray - centre))
        hit = eye + (along - np.sqrt(max(radius**2 - off**2, 0.0))) * ray
        gaze[k] = gaze_of_axis(hit - centre)
    known = np.isfinite(gaze).all(axis=1)
    if not known.any():
        return np.zeros((2, 2))
    gaze[~known] = gaze[known][0]
    return np.clip(gaze, -_FARTHEST, _FARTHEST)
