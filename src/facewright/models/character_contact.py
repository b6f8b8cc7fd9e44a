"""Lips and lids of a driven character that meet instead of crossing, and lids that stay outside the eyeballs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_shape

#: Bins of the eyeballs' radius over the cosine of the angle to the line of sight, from -1 to 1.
RADIUS_BINS = 64


@dataclass(frozen=True, eq=False)
class Seals:
    """Pairs of vertices across openings that may close but not cross.

    Parameters
    ----------
    upper, lower : ndarray of shape (K,), int
    floors : ndarray of shape (K,), float64, millimetres
        Height of the upper above the lower one where a pair is closed.
    reaches : ndarray of shape (K,), float64, millimetres
        Gaps below 0.3 of it close, those above it stay.
    moved : ndarray of shape (L,), int
        Vertices that give way.
    spread : ndarray of shape (L, K), float64
        How much of each pair's change they make.
    """

    upper: NDArray[np.intp]
    lower: NDArray[np.intp]
    floors: NDArray[np.float64]
    reaches: NDArray[np.float64]
    moved: NDArray[np.intp]
    spread: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("upper", self.upper, "K")
        check_shape("lower", self.lower, "K", **sizes)
        check_shape("floors", self.floors, "K", **sizes)
        check_shape("reaches", self.reaches, "K", **sizes)
        sizes |= check_shape("moved", self.moved, "L")
        check_shape("spread", self.spread, "L", "K", **sizes)

    @classmethod
    def none(cls) -> Seals:
        """Return what a character without openings has."""
        ids = np.zeros(0, np.intp)
        return cls(ids, ids, np.zeros(0), np.zeros(0), ids, np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class LidClearance:
    """Vertices of the lids, and the eyeballs that they must not enter.

    Parameters
    ----------
    ids : ndarray of shape (L,), int
        Vertices of the lids.
    eye : ndarray of shape (L,), int
        Which eyeball each lies on.
    margins : ndarray of shape (L,), float64, millimetres
        How far outside each must stay; negative where it is inside at rest.
    centres : ndarray of shape (E, 3), float64, millimetres
    radii : ndarray of shape (E, RADIUS_BINS), float64, millimetres
        Radius of each eyeball over the cosine of the angle to +z, from -1 to 1: round about the line of sight.
    """

    ids: NDArray[np.intp]
    eye: NDArray[np.intp]
    margins: NDArray[np.float64]
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("ids", self.ids, "L")
        check_shape("eye", self.eye, "L", **sizes)
        check_shape("margins", self.margins, "L", **sizes)
        sizes = check_shape("centres", self.centres, "E", 3)
        check_shape("radii", self.radii, "E", RADIUS_BINS, **sizes)

    @classmethod
    def none(cls) -> LidClearance:
        """Return what a character without eyeballs has."""
        ids = np.zeros(0, np.intp)
        return cls(ids, ids, np.zeros(0), np.zeros((0, 3)), np.zeros((0, RADIUS_BINS)))
