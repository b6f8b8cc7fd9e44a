"""Where the landmarks of a known mesh are seen by a known camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import TopologyError
from facewright.imaging.rasterise import rasterise
from facewright.landmarks.contour import face_region
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.topology import Topology


def true_landmarks(
    topology: Topology,
    mean_shape: NDArray[np.floating],
    vertices: NDArray[np.floating],
    intrinsics: Intrinsics,
    motion: RigidMotion,
) -> Landmarks:
    """Return the ``fw74`` landmarks of a known mesh in a known camera.

    The contour is found as a person with a pen would: along 15 rays from the middle of the face, evenly spread from the
    right temple over the chin to the left temple, the last place at which the face's region is seen. It knows nothing
    of the strips of vertices that the fit slides along.
    """
    scheme = load_scheme("fw74")
    ids = topology.landmarks.get("fw74")
    jaw = topology.landmarks.get("ibug68")
    if ids is None or jaw is None:
        raise TopologyError(f"topology {topology.name!r} must mark the 'fw74' and 'ibug68' landmarks.")
    seen = motion.apply(np.asarray(vertices, dtype=np.float64))
    pixels = intrinsics.project(seen)
    points = np.full((scheme.n_points, 2), np.nan)
    points[scheme.fixed] = pixels[ids[scheme.fixed]]
    points[scheme.sliding] = _outline_points(
        topology, mean_shape, pixels, seen[:, 2], pixels[jaw[[0, 8, 16]]], points, len(scheme.sliding)
    )
    return Landmarks("fw74", points)


def _outline_points(
    topology: Topology,
    mean_shape: NDArray[np.floating],
    pixels: NDArray[np.float64],
    depth: NDArray[np.float64],
    ends: NDArray[np.float64],
    points: NDArray[np.float64],
    n: int,
) -> NDArray[np.float64]:
    zoom = 3  # samples a pixel
    region = np.zeros(topology.n_vertices, dtype=bool)
    region[face_region(topology, mean_shape)] = True
    faces = topology.faces[region[topology.faces].all(axis=1)]
    low = np.floor(pixels[region].min(axis=0)) - 2
    fine = (pixels - low) * zoom
    size = np.ceil(fine[region].max(axis=0)).astype(int) + 3
    seen = rasterise(fine, depth, faces, (int(size[1]), int(size[0]))).covered
    groups = load_scheme("fw74").groups
    eyes = points[np.concatenate([groups["right_eye"], groups["left_eye"]])].mean(axis=0)
    mouth = points[groups["outer_mouth"]].mean(axis=0)
    middle = 0.5 * (eyes + mouth)
    # angles of the rays, measured from the direction of the chin so that they do not wrap
    down = np.arctan2(*(mouth - eyes)[::-1])
    right, _, left = ((np.arctan2(*(end - middle)[::-1]) - down + np.pi) % (2 * np.pi) - np.pi for end in ends)
    angles = down + np.linspace(right, left, n)
    reach = np.arange(0.0, float(np.hypot(*size)), 0.5)
    along = (middle - low) * zoom + reach[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    column, row = np.rint(along[..., 0]).astype(int), np.rint(along[..., 1]).astype(int)
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    hit = np.zeros(inside.shape, dtype=bool)
    hit[inside] = seen[row[inside], column[inside]]
    last = len(reach) - 1 - np.argmax(hit[::-1], axis=0)
    return along[last, np.arange(n)] / zoom + low
