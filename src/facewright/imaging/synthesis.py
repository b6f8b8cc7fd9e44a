"""A photo with its face changed: other expression, other shape, other pose."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.faces.face import Face
from facewright.imaging._warp_kernels import soften_breaks
from facewright.imaging.displacement_field import HeadField, HeadMap
from facewright.imaging.head_matte import PersonFinder
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.mirrored_skin import MirroredSkin
from facewright.imaging.photo_layers import PhotoLayers
from facewright.imaging.resample import resample_displaced
from facewright.imaging.source_surface import SourceSurface
from facewright.numeric.check import check_shape

if TYPE_CHECKING:
    from facewright.imaging.inner_face import InnerFace

_KEPT = 4_000_000  # pixels: of photos up to so many a copy in floats is kept, which is faster to look up
_JUMP = 1.0  # pixels: where the map jumps by more, an edge is softened


@dataclass(frozen=True)
class SynthesisOptions:
    """How the surroundings of a head follow it; all as shares of the head's size.

    Parameters
    ----------
    hair : float
        So far out everything follows the head nearly rigidly.
    reach : float
        So far beyond the hair the photo changes, farther only where the head moves far.
    neck : float
        So far below the chin nothing follows a jaw.
    outline : float
        How firmly the photo's silhouette follows the mesh's: more where the head stays and its shape changes, less
        where it turns, for the photo's hair is not the mesh's.
    """

    hair: float = 0.14
    reach: float = 0.22
    neck: float = 0.24
    outline: float = 4.0

    def __post_init__(self) -> None:
        for name in ("hair", "reach", "neck"):
            value = getattr(self, name)
            if not 0.02 <= value <= 2.0:
                raise ValueRangeError(f"{name} must be in [0.02, 2], got {value}.")
        if not 0.1 <= self.outline <= 100.0:
            raise ValueRangeError(f"outline must be in [0.1, 100], got {self.outline}.")


#: For changed shapes of a head that stays where it is.
EDIT_OPTIONS = SynthesisOptions(outline=16.0)


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A redrawn photo.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        The picture.
    smallest_jacobian : float
        Smallest determinant of the map, outside true occlusions.
    head_map : HeadMap or None
        Where the pixels of the head's surroundings were taken from; None where nothing moved.
    touched : ndarray of shape (H, W), bool
        Pixels that may differ from the photo: moved, or drawn anew.
    """

    image: NDArray[np.uint8]
    smallest_jacobian: float
    head_map: HeadMap | None
    touched: NDArray[np.bool_]

    @cached_property
    def source_pixels(self) -> NDArray[np.float32]:
        """Where each pixel was taken from, (H, W, 2), pixels; its own place outside the margin."""
        ys, xs = np.mgrid[: self.image.shape[0], : self.image.shape[1]].astype(np.float32)
        at = np.stack([xs, ys], axis=-1)
        if self.head_map is not None:
            (x, y), (h, w) = self.head_map.origin, self.head_map.displacement.shape[:2]
            at[y : y + h, x : x + w] += self.head_map.displacement
        return at


class PhotoSynthesiser:
    """Redraws one photo for other views of its fitted face; keeps what does not depend on the view.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        sRGB.
    source : MeshView
        The mesh as the photo sees it, all parts.
    face : Face
        Its topology.
    options : SynthesisOptions, optional
        Defaults where absent.
    inner : InnerFace, optional
        Draws what the photo did not show of mouth and eyes.
    find_person : callable, optional
        Tells persons from what lies behind them (`facewright.landmarks.person_mask`); where absent the head's outline
        and colours must tell, and where they cannot what lies behind follows the head.

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
        find_person: PersonFinder | None = None,
    ) -> None:
        check_shape("photo", photo, "H", "W", 3)
        self.photo, self.source, self.face = photo, source, face
        self.options = options or SynthesisOptions()
        self.inner = inner
        self._looked_up = photo.astype(np.float32) if photo[..., 0].size <= _KEPT else photo
        self.surface = SourceSurface.of(source, face)
        self.mirrored = MirroredSkin.of(photo, self.surface, face)
        self.layers = PhotoLayers.of(photo, self.surface, find_person)
        if self.layers is not None and self.mirrored is not None:
            self.mirrored = self.mirrored.held(self.layers.trust_at(source.pixels))
        self.field = HeadField(self.surface, (photo.shape[0], photo.shape[1]), **asdict(self.options))

    def draw(self, target: MeshView, gaze: NDArray[np.floating] | None = None) -> Synthesis:
        """Return the photo with its face as in `target`; `gaze` (2, 2) turns the eyeballs, radians.

        Raises
        ------
        ShapeError
            If the view does not have the face's vertices.
        ValueRangeError
            If its head lies wholly outside the picture, or not wholly before the camera.
        """
        image, touched = self.photo.copy(), np.zeros(self.photo.shape[:2], np.bool_)
        found = self.field.map_of(target)
        if found is not None:
            (x, y), (h, w) = found.origin, found.displacement.shape[:2]
            shares = None
            if self.layers is None:
                part, moved = resample_displaced(self._looked_up, found.displacement, (x, y))
            else:
                part, moved, shares = self.layers.resample(self._looked_up, found.displacement, (x, y))
            offset = (found.fragments_origin[0] - x, found.fragments_origin[1] - y)
            soften_breaks(part, moved, found.displacement, found.breaks, offset, np.float32(_JUMP))
            if self.mirrored is not None:
                self.mirrored.paint(part, moved, self._looked_up, target, found.fragments, offset, shares)
            image[y : y + h, x : x + w], touched[y : y + h, x : x + w] = part, moved
        if self.inner is not None and (found is not None or gaze is not None):
            front = None if found is None else (found.fragments.face_index, found.fragments_origin)
            self.inner.paint(image, target, gaze, touched, front)
        return Synthesis(image, 1.0 if found is None else found.smallest_jacobian, found, touched)
