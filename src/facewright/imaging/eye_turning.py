"""How head and eyeballs turn from a photo to another view."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.faces.face import Face
from facewright.faces.rigid_motion import rigid_vertices
from facewright.imaging.inner_parts import SIDES, eyeball, rigid_motion, sphere_centre, turn_of_gaze
from facewright.imaging.mesh_view import MeshView


class _Eyeball(NamedTuple):
    """What the photo alone says of an eyeball."""

    ids: NDArray[np.intp]
    then: NDArray[np.float64]  # (N, 3) in the camera's axes
    centre: NDArray[np.float64]
    affine: NDArray[np.float64]  # (3, 2) from steps in the camera's axes to steps in pixels
    back: NDArray[np.float64]  # (3, 3) from the camera's axes to those of an eyeball that looks ahead


class EyeTurning:
    """Where in a photo to look for what turned eyeballs show.

    Parameters
    ----------
    source : MeshView
        The fitted mesh as the photo sees it, all parts of `face`.
    face : Face
        Its topology.
    gaze : ndarray of shape (2, 2), radians, optional
        Yaw and pitch of the right and left eyeball in the photo; as the source's eyeballs stand where absent.
    """

    def __init__(self, source: MeshView, face: Face, gaze: NDArray[np.floating] | None = None) -> None:
        self.source, self.face = source, face
        self._gaze = None if gaze is None else np.asarray(gaze, np.float64)

    @cached_property
    def _skull(self) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Upper teeth, which are fixed to the skull: vertices, places in the photo, and the head's rotation there."""
        teeth = rigid_vertices(self.face, "teeth_upper")
        then = self.source.camera_vertices[teeth]
        head, _ = rigid_motion(self.face.mean_shape[teeth].astype(np.float64), then)
        return teeth, then, head

    @cached_property
    def _eyeballs(self) -> dict[str, _Eyeball]:
        """What the photo alone says of the eyeballs."""
        head = self._skull[2]
        found = {}
        for side in SIDES:
            ids = eyeball(self.face, side)
            then = self.source.camera_vertices[ids]
            centre = sphere_centre(then)
            if self._gaze is None:
                iris = self.source.camera_vertices[self.face.topology.masks[f"iris_{side}"]].mean(axis=0)
                globe = sphere_centre(then[(then - centre) @ (iris - centre) < 0])  # the cornea is no part of it
                x, y, z = head.T @ (iris - globe)
                own = np.array([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
            else:
                own = self._gaze[SIDES.index(side)]
            design = np.column_stack([then - centre, np.ones(len(then))])
            affine, *_ = np.linalg.lstsq(design, self.source.pixels[ids], rcond=None)
            found[side] = _Eyeball(ids, then, centre, affine[:3], turn_of_gaze(own).T @ head.T)
        return found

    def of_head(self, target: MeshView) -> NDArray[np.float64]:
        """Return the rotation of the head from the photo to a view, in the camera's axes, (3, 3)."""
        teeth, then, _ = self._skull
        return rigid_motion(then, target.camera_vertices[teeth])[0]

    def places(self, side: str, target: MeshView, gaze: NDArray[np.floating] | None) -> NDArray[np.float64]:
        """Return where in the photo the eyeball's vertices are shown, (N, 2), by what the target's show."""
        ball = self._eyeballs[side]
        if gaze is None:
            return self.source.pixels[ball.ids]
        now = target.camera_vertices[ball.ids]
        own, shift = rigid_motion(ball.then, now)
        # from the eyeball as the photo has it to the wanted one
        turn = self.of_head(target) @ self._skull[2] @ turn_of_gaze(gaze) @ ball.back
        back = (now - (own @ ball.centre + shift)) @ turn
        return np.asarray(self.source.pixels[ball.ids] + (back - (ball.then - ball.centre)) @ ball.affine)

    def still_places(self, side: str, target: MeshView) -> NDArray[np.float64]:
        """Return the same of an eyeball that turned with the head alone."""
        ball = self._eyeballs[side]
        now = target.camera_vertices[ball.ids]
        own, shift = rigid_motion(ball.then, now)
        head = self.of_head(target)
        back = (now - (own @ ball.centre + shift)) @ head
        return np.asarray(self.source.pixels[ball.ids] + (back - (ball.then - ball.centre)) @ ball.affine)
