"""Landmarks: 2D points of a named scheme, with confidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.errors import ValueRangeError
from facewright.landmarks.scheme import LandmarkScheme, load_map, load_scheme
from facewright.numeric.check import check_shape


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Points of a landmark scheme found in one picture.

    Parameters
    ----------
    scheme : str
        Name of the scheme (`facewright.landmarks.scheme.SCHEME_NAMES`).
    points : ndarray of shape (L, 2), float64, pixels
        x right, y down; the centre of the first pixel is (0, 0). A missing point is NaN *and* has confidence 0.
    confidence : ndarray of shape (L,), float64, optional
        In [0, 1]; scales each point's weight in fitting. 0 means missing. All 1 where absent.

    Raises
    ------
    ShapeError
        If the number of points is not the scheme's.
    ValueRangeError
        If the scheme is unknown, a confidence is outside [0, 1], or a point that is not marked missing is not finite.
    """

    scheme: str
    points: NDArray[np.float64]
    confidence: NDArray[np.float64] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        L = load_scheme(self.scheme).n_points
        points = np.array(self.points, dtype=np.float64)
        check_shape(f"points of scheme {self.scheme!r}", points, L, 2)
        given = np.ones(L) if self.confidence is None else self.confidence
        confidence = np.array(given, dtype=np.float64)
        check_shape("confidence", confidence, L)
        if not ((confidence >= 0) & (confidence <= 1)).all():
            raise ValueRangeError(f"confidence must lie in [0, 1], got {_first_bad(confidence)}.")
        bad = ~np.isfinite(points).all(axis=1) & (confidence > 0)
        if bad.any():
            raise ValueRangeError(
                f"points must be finite or marked missing by confidence 0, got {int(bad.sum())} that are not "
                f"(first: point {int(np.flatnonzero(bad)[0])})."
            )
        points[confidence == 0] = np.nan
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "confidence", confidence)

    @property
    def definition(self) -> LandmarkScheme:
        """The scheme's names, groups and mirror map."""
        return load_scheme(self.scheme)

    @property
    def present(self) -> NDArray[np.bool_]:
        """Points that are not missing, shape (L,)."""
        return self.confidence > 0

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of the present points, pixels."""
        if not self.present.any():
            raise ValueRangeError("landmarks must hold at least one point that is not missing.")
        low, high = np.nanmin(self.points, axis=0), np.nanmax(self.points, axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def convert(self, scheme: str) -> Landmarks:
        """Return the same face in another scheme; points without a counterpart are missing.

        A point made from several takes the lowest of their confidences; it is missing if one of them is.
        """
        mapping = load_map(self.scheme, scheme)
        weights = mapping.weights
        present = self.present
        usable = mapping.available & ~(weights[:, ~present] != 0).any(axis=1)
        points = weights @ np.where(present[:, None], self.points, 0.0)
        lowest = np.where(weights != 0, self.confidence[None], 1.0).min(axis=1)
        return Landmarks(scheme, points, np.where(usable, lowest, 0.0))

    def overridden_by(self, other: Landmarks) -> Landmarks:
        """Return these landmarks with every point that `other` has taken from `other`, point by point.

        `other` is converted to this scheme where it is of another one.
        """
        theirs = other if other.scheme == self.scheme else other.convert(self.scheme)
        take = theirs.present
        return Landmarks(
            self.scheme,
            np.where(take[:, None], theirs.points, self.points),
            np.where(take, theirs.confidence, self.confidence),
        )

    def mirrored(self, width: int) -> Landmarks:
        """Return the landmarks of the mirror image of a picture `width` pixels wide."""
        mirror = self.definition.mirror
        points = self.points[mirror] * [-1.0, 1.0] + [width - 1.0, 0.0]
        return Landmarks(self.scheme, points, self.confidence[mirror])

    def interocular_distance(self) -> float:
        """Distance between the centres of the two eye outlines, pixels.

        The centres are the means of the outlines' points. (The distance between the *outer corners*, which some
        benchmarks call by the same name, is about 1.4 times as long.)

        Raises
        ------
        ValueRangeError
            If the points of an eye are missing.
        """
        return interocular_distance(self.points, self.scheme)


def interocular_distance(points: ArrayLike, scheme: str) -> float:
    """Return the distance between the centres of the eye outlines of points (L, 2) or (L, 3)."""
    array = np.asarray(points, dtype=np.float64)
    groups = load_scheme(scheme).groups
    centres = []
    for side in ("right", "left"):
        eye = array[groups[f"{side}_eye"]]
        if not np.isfinite(eye).all():
            raise ValueRangeError(f"points of the {side} eye must not be missing.")
        centres.append(eye.mean(axis=0))
    return float(np.linalg.norm(centres[0] - centres[1]))


def _first_bad(confidence: NDArray[np.float64]) -> float:
    return float(confidence[~((confidence >= 0) & (confidence <= 1))][0])
