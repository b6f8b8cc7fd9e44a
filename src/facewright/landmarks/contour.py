"""Contour points: strips of candidate vertices, the visible outline among them, and sliding along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import TopologyError
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_indices, check_shape

#: Angle off the forward axis at which the strips begin: the middle of the cheek, so that nose and lips stay out.
_STRIP_START_DEGREES = 32.0
#: How far beyond the marked jaw line the strips go: under the chin, whose lowest points the line passes above, and at
#: the sides, where the ears begin.
_MARGIN_DEGREES = {"chin": 7.0, "sides": 2.0}


@dataclass(frozen=True, eq=False)
class ContourStrips:
    """Candidates for the outline of a face: strips of vertices that run from the cheek outwards to the jaw line.

    From any side one vertex of each strip is the outermost; these K vertices, from the subject's right temple over
    the chin to the left temple, are the face's outline. Where a strip bends out of sight, that is the occluding
    contour; where it is seen as a whole, that is the jaw line.

    Parameters
    ----------
    vertices : ndarray of shape (K, M), int32
        Vertices of each strip from the inside out; the last is repeated where a strip is shorter.
    outward : ndarray of shape (K, 3), float64
        Unit vectors of model space in which each strip runs, seen from the front.
    """

    vertices: NDArray[np.int32]
    outward: NDArray[np.float64]

    def __post_init__(self) -> None:
        sizes = check_shape("vertices", self.vertices, "K", "M")
        check_shape("outward", self.outward, "K", 3, **sizes)

    def outline(self, pixels: NDArray[np.floating], camera_from_model: NDArray[np.floating]) -> NDArray[np.intp]:
        """Choose the outermost vertex of each strip.

        Parameters
        ----------
        pixels : ndarray of shape (K, M, 2)
            Projections of `vertices`.
        camera_from_model : ndarray of shape (3, 3)
            Rotation of the head before the camera (y down).

        Returns
        -------
        ndarray of shape (K,), int
            Column of `vertices`, for each strip.
        """
        direction = self.outward @ np.asarray(camera_from_model, dtype=np.float64)[:2].T  # (K, 2)
        return np.argmax(np.einsum("kmc,kc->km", pixels, direction), axis=1)


@dataclass(frozen=True, eq=False)
class Sliding:
    """Where contour points sit on an outline: between its corner `first` and the next one, at `fraction`.

    Parameters
    ----------
    first : ndarray of shape (C,), int
        Corner of the outline, 0 to K - 2.
    fraction : ndarray of shape (C,), float64
        0 at that corner, 1 at the next.
    """

    first: NDArray[np.intp]
    fraction: NDArray[np.float64]


def slide_on_outline(points: NDArray[np.floating], outline: NDArray[np.floating]) -> Sliding:
    """Find the nearest place on an open polyline for each point.

    Parameters
    ----------
    points : ndarray of shape (C, 2), pixels
        Contour points of the picture; rows with NaN give the first corner.
    outline : ndarray of shape (K, 2), pixels
        Corners of the projected outline, in order.

    Returns
    -------
    Sliding
        Segment and fraction of each point.

    Notes
    -----
    FaceWarehouse 3.2.1 takes the nearest silhouette *vertex*; the nearest place between two of them is still linear in
    the model's weights and does not pull points along the contour.
    """
    check_shape("points", points, "C", 2)
    check_shape("outline", outline, "K", 2)
    start, along = outline[:-1], np.diff(outline, axis=0)
    length2 = np.maximum((along**2).sum(axis=1), 1e-12)
    offset = points[:, None] - start[None]
    fraction = np.clip((offset * along).sum(axis=2) / length2, 0.0, 1.0)
    distance = ((offset - fraction[..., None] * along) ** 2).sum(axis=2)
    first = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=1)
    chosen = fraction[np.arange(len(points)), first]
    return Sliding(first, np.where(np.isfinite(chosen), chosen, 0.0))


def build_contour_strips(
    topology: Topology, mean_shape: NDArray[np.floating], n_strips: int = 27, n_nodes: int = 11
) -> ContourStrips:
    """Choose strips of candidate vertices on a face.

    The face is seen as a globe about a point behind the nose, whose pole looks forward; a strip is a meridian from
    the cheek to the jaw line that the topology marks.

    Parameters
    ----------
    topology : Topology
        With the part ``face`` and the ``ibug68`` landmarks, whose first 17 are the jaw line.
    mean_shape : ndarray of shape (V, 3), millimetres
        The generic neutral.
    n_strips : int
        K strips, temple to temple.
    n_nodes : int
        M vertices a strip.

    Returns
    -------
    ContourStrips
        The strips; vertices are those of `topology`.

    Raises
    ------
    TopologyError
        If the topology has no face part or no jaw line.
    """
    check_shape("mean_shape", mean_shape, topology.n_vertices, 3)
    globe = _Globe.of(topology, mean_shape)
    start, stop = topology.parts["face"]
    skin = np.asarray(mean_shape[start:stop], dtype=np.float64)
    directions = globe.directions(skin)
    meridians = np.linspace(globe.jaw_meridians[0], globe.jaw_meridians[-1], n_strips)
    limits = globe.limits(meridians)
    share = np.linspace(0.0, 1.0, n_nodes)
    polar = np.deg2rad(_STRIP_START_DEGREES) * (1 - share) + limits[:, None] * share  # (K, M)
    wanted = np.stack(
        [
            np.sin(polar) * np.sin(meridians)[:, None],
            -np.sin(polar) * np.cos(meridians)[:, None],
            np.cos(polar),
        ],
        axis=2,
    )
    nearest = np.argmax(wanted.reshape(-1, 3) @ directions.T, axis=1).reshape(n_strips, n_nodes)
    outward = np.stack([np.sin(meridians), -np.cos(meridians), np.zeros(n_strips)], axis=1)
    return ContourStrips((nearest + start).astype(np.int32), outward)


def face_region(topology: Topology, mean_shape: NDArray[np.floating]) -> NDArray[np.int32]:
    """Return the vertices of the face proper: in front of the jaw line that `build_contour_strips` ends at.

    Above the temples the limit is that of the temples.

    Raises
    ------
    TopologyError
        If the topology has no face part or no jaw line.
    """
    check_shape("mean_shape", mean_shape, topology.n_vertices, 3)
    globe = _Globe.of(topology, mean_shape)
    start, stop = topology.parts["face"]
    d = globe.directions(np.asarray(mean_shape[start:stop], dtype=np.float64))
    meridian = np.arctan2(d[:, 0], -d[:, 1])
    return (np.flatnonzero(np.arccos(np.clip(d[:, 2], -1, 1)) <= globe.limits(meridian)) + start).astype(np.int32)


@dataclass(frozen=True, eq=False)
class _Globe:
    """Angles about the face's centre: meridian 0 runs down over the chin, positive towards the subject's left."""

    centre: NDArray[np.float64]
    jaw_meridians: NDArray[np.float64]
    jaw_polar: NDArray[np.float64]

    @classmethod
    def of(cls, topology: Topology, mean_shape: NDArray[np.floating]) -> _Globe:
        ids = topology.landmarks.get("ibug68")
        if ids is None or "face" not in topology.parts:
            raise TopologyError(f"topology {topology.name!r} must have a part 'face' and 'ibug68' landmarks.")
        groups = load_scheme("ibug68").groups
        jaw = ids[groups["contour"]]
        if (jaw < 0).any():
            raise TopologyError(f"topology {topology.name!r} must mark the 17 jaw points of 'ibug68'.")
        check_indices("jaw line", jaw, topology.n_vertices)
        line = np.asarray(mean_shape[jaw], dtype=np.float64)
        nose_base = np.asarray(mean_shape[ids[33]], dtype=np.float64)
        # inside the head, as deep as the jaw's upper ends and as high as the base of the nose
        centre = np.array([0.0, nose_base[1] + 12.0, 0.5 * (line[0, 2] + line[-1, 2]) - 8.0])
        d = line - centre
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        meridian = np.arctan2(d[:, 0], -d[:, 1])
        if (np.diff(meridian) <= 0).any():
            raise TopologyError(f"topology {topology.name!r} must mark its jaw line from the right temple to the left.")
        return cls(centre, meridian, np.arccos(d[:, 2]))

    def limits(self, meridians: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the polar angle at which the face ends, a little beyond the jaw line, on each meridian."""
        chin, sides = _MARGIN_DEGREES["chin"], _MARGIN_DEGREES["sides"]
        margin = sides + (chin - sides) * np.maximum(np.cos(meridians), 0.0)
        return np.interp(meridians, self.jaw_meridians, self.jaw_polar) + np.deg2rad(margin)

    def directions(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        d = points - self.centre
        return d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
