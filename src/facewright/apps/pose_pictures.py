"""Pictures of a posed face with the markers that pull at it (Tena et al. 2011, Fig. 1 and 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.paint_person import usual_appearance
from facewright.imaging.overlay import draw_points
from facewright.imaging.portrait import portrait_view, render_portrait

if TYPE_CHECKING:
    from facewright.apps.pose_session import PoseSession
    from facewright.apps.posed_character import PosedCharacter
    from facewright.faces.face import Face

Picture = NDArray[np.uint8]

_TARGET, _HELD, _ACTIVE = (150, 150, 154), (20, 20, 22), (250, 205, 30)
_TARGET_RADIUS, _HELD_RADIUS = 0.0125, 0.0075  # shares of the picture's height


class PosePainter:
    """Draw a face in any pose, from the front or turned.

    Parameters
    ----------
    face : Face
        Whose parts are painted.
    size : (height, width)
        Pixels.
    yaw_degrees : float
        Turn of the head towards its own left.
    centre_mm : (x, y, z)
        What is in the middle of the picture.
    height_mm : float
        How much of the face is seen from top to bottom.
    seed : int, optional
        Of the appearance; a usual one where absent.
    """

    def __init__(
        self,
        face: Face,
        size: tuple[int, int] = (360, 300),
        *,
        yaw_degrees: float = 0.0,
        centre_mm: tuple[float, float, float] = (0.0, -6.0, 50.0),
        height_mm: float = 222.0,
        seed: int | None = None,
    ) -> None:
        from facewright.faces.appearance import albedo_function, vertex_gloss, visible_faces

        self._faces, self._gloss = visible_faces(face), vertex_gloss(face)
        self._albedo = albedo_function(face, usual_appearance(seed), self._faces)
        self._size = size
        self._yaw, self._centre, self._height = yaw_degrees, centre_mm, height_mm

    def draw(self, vertices: NDArray[np.floating]) -> Picture:
        """Draw vertices (V, 3), mm; returns (H, W, 3), sRGB."""
        return render_portrait(
            vertices,
            self._faces,
            self._size,
            albedo=self._albedo,
            shininess=self._gloss,
            yaw_degrees=self._yaw,
            centre_mm=self._centre,
            height_mm=self._height,
        ).image

    def draw_pose(self, session: PoseSession, character: PosedCharacter, kind: str = "region") -> Picture:
        """Draw a session's pose; nothing but the face."""
        out = np.empty_like(character.neutral)
        character.pose(kind, session.coefficients(kind), out)
        return self.draw(out)

    def mark(
        self, picture: Picture, targets: NDArray[np.floating], held: NDArray[np.floating], active: Sequence[int] = ()
    ) -> Picture:
        """Draw constraints over a picture, as in the paper's Fig. 7.

        Targets (K, 3) grey, the points held (K, 3) smaller and black, `active` ones yellow; mm, on the character.
        """
        radius = self._size[0] * np.array([_TARGET_RADIUS, _HELD_RADIUS])
        is_active = np.isin(np.arange(len(held)), list(active))
        for points, colour, size in (
            (targets, _TARGET, radius[0]),
            (held[~is_active], _HELD, radius[1]),
            (held[is_active], _ACTIVE, radius[1]),
        ):
            if len(points):
                picture = draw_points(picture, self._project(points), colour, float(size))
        return picture

    def _project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        return portrait_view(points, self._size, yaw_degrees=self._yaw, centre_mm=self._centre, height_mm=self._height)[
            1
        ]
