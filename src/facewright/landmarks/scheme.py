"""Landmark schemes as data: names, groups, mirror map and the maps between schemes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_choice, check_indices, check_shape

SCHEME_NAMES = ("fw74", "ibug68", "mediapipe478")


@dataclass(frozen=True, eq=False)
class LandmarkScheme:
    """What the points of one landmark scheme are; left and right are the subject's.

    Parameters
    ----------
    name : str
        ``"fw74"``, ``"ibug68"`` or ``"mediapipe478"``.
    description : str
        One sentence.
    names : tuple of str
        Name of each of the L points.
    groups : mapping of str to ndarray of int32
        Points by face part: ``contour``, ``right_brow``, ``left_brow``, ``right_eye``, ``left_eye``, ``nose``,
        ``outer_mouth``, ``inner_mouth`` (and irises where the scheme has them).
    lines : tuple of ndarray of int32
        Polylines through the points, for drawing; a closed one repeats its first point.
    mirror : ndarray of shape (L,), int32
        The point that each point becomes in the mirror image; its own inverse.
    sliding : ndarray of int32
        Contour points: they have no fixed vertex and slide along the silhouette (FaceWarehouse 3.2).
    """

    name: str
    description: str
    names: tuple[str, ...]
    groups: Mapping[str, NDArray[np.int32]]
    lines: tuple[NDArray[np.int32], ...]
    mirror: NDArray[np.int32]
    sliding: NDArray[np.int32]

    def __post_init__(self) -> None:
        L = len(self.names)
        check_shape("mirror", self.mirror, L)
        check_indices("mirror", self.mirror, L)
        if not np.array_equal(self.mirror[self.mirror], np.arange(L)):
            raise ValueRangeError(f"mirror of scheme {self.name!r} must be its own inverse.")
        for key, ids in [("sliding", self.sliding), *self.groups.items()]:
            check_indices(f"{key} of scheme {self.name!r}", ids, L)

    @property
    def n_points(self) -> int:
        """Number of points L."""
        return len(self.names)

    @property
    def fixed(self) -> NDArray[np.int32]:
        """Points that do not slide, in order."""
        return np.setdiff1d(np.arange(self.n_points, dtype=np.int32), self.sliding)

    def index(self, name: str) -> int:
        """Return the index of the point called `name`; ValueRangeError where there is none."""
        if name not in self.names:
            raise ValueRangeError(f"point must be a name of scheme {self.name!r}, got {name!r}.")
        return self.names.index(name)


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """How points of one scheme are made from another's: rows of weights that sum to one.

    Parameters
    ----------
    source, target : str
        Scheme names.
    weights : ndarray of shape (target L, source L), float64
        Each row sums to one; a row of zeros is a point that the source does not have.
    """

    source: str
    target: str
    weights: NDArray[np.float64]

    @property
    def available(self) -> NDArray[np.bool_]:
        """Target points that the source has, shape (target L,)."""
        return self.weights.any(axis=1)


@cache
def load_scheme(name: str) -> LandmarkScheme:
    """Return a landmark scheme by name.

    Parameters
    ----------
    name : str
        ``"fw74"`` (FaceWarehouse's 74 points), ``"ibug68"`` or ``"mediapipe478"``.

    Returns
    -------
    LandmarkScheme
        The scheme.

    Raises
    ------
    ValueRangeError
        If the name is unknown.

    Examples
    --------
    >>> load_scheme("fw74").n_points
    74
    """
    check_choice("scheme", name, SCHEME_NAMES)
    data = _read_data(f"{name}.json")
    return LandmarkScheme(
        name=data["name"],
        description=data["description"],
        names=tuple(data["names"]),
        groups={key: _ids(ids) for key, ids in data["groups"].items()},
        lines=tuple(_ids(line) for line in data["lines"]),
        mirror=_ids(data["mirror"]),
        sliding=_ids(data["sliding"]),
    )


@cache
def load_map(source: str, target: str) -> LandmarkMap:
    """Return the map that makes the points of `target` from those of `source`.

    Parameters
    ----------
    source, target : str
        Scheme names. Equal names give the identity.

    Returns
    -------
    LandmarkMap
        Weights; points without a counterpart have a row of zeros.

    Raises
    ------
    ValueRangeError
        If a name is unknown or no such map exists.

    Examples
    --------
    >>> load_map("mediapipe478", "fw74").weights.shape
    (74, 478)
    """
    from_scheme, to_scheme = load_scheme(source), load_scheme(target)
    if source == target:
        return LandmarkMap(source, target, np.eye(from_scheme.n_points))
    file = f"{source}_to_{target}.json"
    if not resources.files("facewright.landmarks").joinpath("data", file).is_file():
        raise ValueRangeError(f"landmarks of scheme {source!r} cannot be turned into {target!r}: no map exists.")
    data = _read_data(file)
    weights = np.zeros((to_scheme.n_points, from_scheme.n_points))
    for point, terms in data["points"].items():
        for index, weight in terms:
            weights[int(point), int(index)] = weight
    return LandmarkMap(source, target, weights)


def _read_data(file: str) -> dict[str, Any]:
    text = resources.files("facewright.landmarks").joinpath("data", file).read_text(encoding="utf-8")
    data: dict[str, Any] = json.loads(text)
    return data


def _ids(values: list[int]) -> NDArray[np.int32]:
    ids = np.array(values, dtype=np.int32)
    ids.setflags(write=False)
    return ids
