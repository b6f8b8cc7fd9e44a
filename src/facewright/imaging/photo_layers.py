"""A photo as two layers: the person, who moves, before what lies behind, which stays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging._layer_kernels import compose_layers
from facewright.imaging.background_plate import complete_background
from facewright.imaging.blocks import enlarge, masked_means
from facewright.imaging.head_matte import PersonFinder, find_head_matte
from facewright.imaging.source_surface import SourceSurface

#: States of a place in the photo, by the pixels that a look-up there reads.
BEHIND, PERSON, BOTH = 0, 1, 2

_CERTAIN = 0.74  # colours must tell the person from the background so well along the outline
_RIM = 0.012  # of the head's size: pixels so near the person hold some of it
_FADE = 0.008  # of the head's size
_WORK = 150  # pixels that the head has where colours beside an edge are looked up
_BLOCK_ROWS = 512
_LOWEST = 0.5  # of the head's size below the chin: the background is completed down to there


@dataclass(frozen=True, eq=False)
class PhotoLayers:
    """The two layers of a box of the photo.

    Parameters
    ----------
    origin : (x, y)
        First pixel of the box.
    alpha : ndarray of shape (h, w), uint8
        The person's share of each pixel.
    front : ndarray of shape (h, w, 3), uint8
        Their light in each pixel, what lies behind taken away: alpha times their colour.
    plate : ndarray of shape (h, w, 3), uint8
        What lies behind: the photo beside the person, in-painted where they hide it.
    state : ndarray of shape (h, w), uint8
        `PERSON` where the pixels around hold nothing else, `BEHIND` where they hold none of it, `BOTH` between.
    hidden : ndarray of shape (h, w), bool
        Where the plate may differ from the photo.
    trust : ndarray of shape (h, w), uint8
        255 where the layers hold; where it is 0 what lies behind bends with the head.
    fade : float, pixels
        What the layers leave of the photo fades over a motion of so much.
    """

    origin: tuple[int, int]
    alpha: NDArray[np.uint8]
    front: NDArray[np.uint8]
    plate: NDArray[np.uint8]
    state: NDArray[np.uint8]
    hidden: NDArray[np.bool_]
    trust: NDArray[np.uint8]
    fade: float

    @classmethod
    def of(
        cls, photo: NDArray[np.uint8], surface: SourceSurface, find_person: PersonFinder | None = None
    ) -> PhotoLayers | None:
        """Part a photo; None where the person cannot be told from what lies behind.

        Raises
        ------
        ShapeError
            If `photo` has not the shape (H, W, 3).
        """
        matte = find_head_matte(photo, surface, find_person)
        if matte.certainty < _CERTAIN or not (matte.alpha == 0).any() or not matte.trust.any():
            return None
        (x, y), (h, w) = matte.origin, matte.alpha.shape
        part = photo[y : y + h, x : x + w]
        rim = max(1, round(_RIM * surface.head_size))
        hidden = np.asarray(ndimage.maximum_filter(matte.alpha > 0, 2 * rim + 1))
        along = surface.down / max(float(np.linalg.norm(surface.down)), 1e-9)
        below = (np.arange(h)[:, None] + y - surface.chin[1]) * along[1] + (np.arange(w) + x - surface.chin[0]) * along[
            0
        ]
        hidden &= below < _LOWEST * surface.head_size
        if not hidden.any() or hidden.all():
            return None
        alpha = np.where(hidden, matte.alpha, np.where(matte.alpha > 127, 255, 0)).astype(np.uint8)
        plate = complete_background(part, hidden, matte.alpha > 0, surface.head_size)
        front = _part_colours(part, alpha, plate, surface.head_size)
        # two pixels on each side: what a bicubic look-up may read
        state = np.full(alpha.shape, BOTH, np.uint8)
        state[ndimage.minimum_filter(alpha, 5, mode="nearest") == 255] = PERSON
        state[~ndimage.maximum_filter(hidden | (alpha > 0), 5, mode="nearest")] = BEHIND
        return cls(matte.origin, alpha, front, plate, state, hidden, matte.trust, max(1.5, _FADE * surface.head_size))

    def trust_at(self, pixels: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return how far the layers hold at places (N, 2) of the photo, 0 to 1; the box's border beyond it."""
        (h, w), at = self.trust.shape, np.rint(np.nan_to_num(pixels) - self.origin)
        x, y = np.clip(at[:, 0], 0, w - 1).astype(int), np.clip(at[:, 1], 0, h - 1).astype(int)
        return self.trust[y, x] / 255.0

    def resample(
        self, photo: NDArray[np.uint8 | np.float32], displacement: NDArray[np.float32], origin: tuple[int, int]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.uint8]]:
        """Return the part of the picture at `origin` with the person moved, which pixels may have changed, and shares.

        The shares (h, w) are the person's, 255 where they fill a pixel or nothing moves.

        Parameters
        ----------
        photo : ndarray of shape (H, W, 3), uint8 or float32
            The photo, in [0, 255].
        displacement : ndarray of shape (h, w, 2), float32, pixels
            Where the person's pixels lie in the photo, relative to the picture's own; set to zero, in place, where the
            background is seen.
        origin : (x, y)
            Where the part begins.
        """
        part = np.empty((*displacement.shape[:2], 3), np.uint8)
        moved = np.zeros(displacement.shape[:2], np.bool_)
        shares = np.full(displacement.shape[:2], 255, np.uint8)
        compose_layers(
            photo,
            displacement,
            origin,
            self.alpha,
            self.front,
            self.plate,
            self.state,
            self.hidden,
            self.trust,
            self.origin,
            np.float32(self.fade),
            part,
            moved,
            shares,
        )
        return part, moved, shares


def _part_colours(
    part: NDArray[np.uint8], alpha: NDArray[np.uint8], plate: NDArray[np.uint8], head_size: float
) -> NDArray[np.uint8]:
    """Return the person's light in each pixel, (h, w, 3).

    Where a pixel holds both, the person's colour is about that beside it and the other the plate's; of what is left
    the person takes a part by the squares of their shares.
    """
    n = max(1, round(head_size / _WORK))
    guess = _colour_beside(part, alpha == 255, n)
    front = np.where(alpha[..., None] == 255, part, 0).astype(np.uint8)
    for top in range(0, len(part), _BLOCK_ROWS):
        rows = slice(top, min(top + _BLOCK_ROWS, len(part)))
        at = np.nonzero((alpha[rows] > 0) & (alpha[rows] < 255))
        if not len(at[0]):
            continue
        a = (alpha[rows][at] / np.float32(255))[:, None]
        ours = enlarge(guess, n, part.shape[:2], rows)[at]
        seen, theirs = part[rows][at].astype(np.float32), plate[rows][at].astype(np.float32)
        left = (seen - a * ours - (1 - a) * theirs) / (a * a + (1 - a) ** 2)
        front[rows][at] = np.rint(np.clip(a * (ours + a * left), 0, 255 * a))
    return front


def _colour_beside(part: NDArray[np.uint8], person: NDArray[np.bool_], n: int) -> NDArray[np.float32]:
    """Return, for blocks of n x n pixels, the colour of the nearest block that the person fills."""
    colour, share = masked_means(part, person, n)
    filled = ndimage.minimum_filter(share > 0.99, 3)
    if not filled.any():
        filled = share > 0
    index = ndimage.distance_transform_edt(~filled, return_distances=False, return_indices=True)
    return np.asarray(ndimage.gaussian_filter(colour[tuple(index)], (1.0, 1.0, 0)), dtype=np.float32)
