"""A photo with its face changed: other expression, other shape, other pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.faces.face import Face
from facewright.imaging.displacement_field import displacement_field
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.warp import smallest_jacobian, warp_picture
from facewright.numeric.check import check_shape

if TYPE_CHECKING:
    from facewright.imaging.inner_face import InnerFace


@dataclass(frozen=True)
class SynthesisOptions:
    """How a photo is redrawn.

    Parameters
    ----------
    margin : float
        Reach of the warp around the head, as a share of its size.
    """

    margin: float = 0.45


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A redrawn photo.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        The picture.
    touched : ndarray of shape (H, W), bool
        Pixels that may differ from the photo.
    smallest_jacobian : float
        Smallest determinant of the map, outside true occlusions.
    source_pixels : ndarray of shape (H, W, 2), float32
        Where each pixel was taken from.
    """

    image: NDArray[np.uint8]
    touched: NDArray[np.bool_]
    smallest_jacobian: float
    source_pixels: NDArray[np.float32]


class PhotoSynthesiser:
    """Redraws one photo for other views of its fitted face.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
    source : MeshView
        The mesh as the photo sees it, all parts.
    face : Face
        Its topology.
    options : SynthesisOptions
    inner : InnerFace, optional
        Draws what the photo did not show of mouth and eyes.

    Raises
    ------
    ShapeError
        If shapes do not match.
    """

    def __init__(
        self,
        photo: NDArray[np.uint8],
        source: MeshView,
        face: Face,
        options: SynthesisOptions | None = None,
        inner: InnerFace | None = None,
    ) -> None:
        check_shape("photo", photo, "H", "W", 3)
        check_shape("source.pixels", source.pixels, face.topology.n_vertices, 2)
        self.photo, self.source, self.face = photo, source, face
        self.options = options or SynthesisOptions()
        self.inner = inner

    def draw(self, target: MeshView, gaze: NDArray[np.floating] | None = None) -> Synthesis:
        """Return the photo with its face as in `target`; `gaze` (2, 2) turns the eyeballs, radians."""
        size = self.photo.shape[:2]
        field = displacement_field(self.source, target, self.face, size, self.options.margin)
        image = warp_picture(self.photo, field)
        ys, xs = np.mgrid[: size[0], : size[1]].astype(np.float32)
        at = field + np.stack([xs, ys], axis=-1)
        return Synthesis(image, (field != 0).any(axis=2), smallest_jacobian(field), at)
