"""The acting part of a face and the 397 vertices on it."""

from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import TopologyError
from facewright.faces.coarse_face import coarse_face
from facewright.faces.performance_region import acting_surface, performance_region
from facewright.mesh.areas import face_areas
from facewright.mesh.connectivity import boundary_loops, unique_edges, vertex_components


def _check(face):
    region = performance_region(face)
    skin, topology = face.mean_shape[: face.n_skin], face.skin().topology
    kept = topology.faces[region[topology.faces].all(axis=1)]
    assert len(boundary_loops(kept)) == 4  # outline, mouth, two eyes
    assert np.array_equal(region, region[topology.mirror])
    assert 250e2 < face_areas(skin, kept).sum() < 400e2
    landmarks = topology.landmarks["ibug68"]
    assert region[landmarks[[8, 19, 24, 30, 33]]].all()  # chin, brows, nose
    if "ears" in topology.masks:
        assert not region[topology.masks["ears"]].any()
    surface = acting_surface(face)
    assert (surface >= region).all() and surface.sum() > region.sum()
    coarse = coarse_face(face)
    assert coarse is coarse_face(face)
    assert coarse.positions.shape == (397, 3) and coarse.template == face.topology.name
    assert region[coarse.vertex_ids].all()
    assert len(boundary_loops(coarse.faces)) == 4 and vertex_components(coarse.faces, 397).max() == 0
    image = coarse.positions[coarse.mirror] * [-1, 1, 1]
    assert np.abs(image - coarse.positions).max() < 0.1
    edges = unique_edges(coarse.faces)
    length = np.linalg.norm(np.diff(coarse.positions[edges], axis=1)[:, 0], axis=1)
    assert 8.0 < length.mean() < 12.0 and length.max() < 26.0
    a, b, c = (coarse.positions[coarse.faces[:, k]].astype(float) for k in range(3))
    shortest = np.min([np.linalg.norm(u - v, axis=1) for u, v in ((a, b), (b, c), (c, a))], axis=0)
    longest = np.max([np.linalg.norm(u - v, axis=1) for u, v in ((a, b), (b, c), (c, a))], axis=0)
    area = face_areas(coarse.positions, coarse.faces)
    assert (2 * area / longest / shortest).min() > 0.15  # no slivers


def test_builtin(builtin_face):
    _check(builtin_face)


def test_ict(ict_face):
    _check(ict_face)


def test_faces_that_do_not_say_where_are_refused(builtin_face):
    topology = builtin_face.topology
    for change in ({"landmarks": {}}, {"masks": {}}):
        with pytest.raises(TopologyError):
            performance_region(replace(builtin_face, topology=replace(topology, **change)))
