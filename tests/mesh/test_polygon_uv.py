"""Texture corners of quads: found whichever way the quads were cut."""

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.mesh.polygon_uv import polygon_uv


@pytest.mark.parametrize("cuts", [((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3))])
def test_corners_come_back_from_either_diagonal(rng, cuts):
    quads = np.array([[0, 1, 2, 3], [3, 2, 5, 4], [7, 6, 1, 0]])
    uv_quads = rng.permutation(12).reshape(3, 4)
    faces = np.concatenate([quads[:, cut] for cut in cuts])
    uv_faces = np.concatenate([uv_quads[:, cut] for cut in cuts])
    turn = rng.integers(0, 3, len(faces))  # triangles may start at any corner
    index = (np.arange(3) + turn[:, None]) % 3
    faces, uv_faces = np.take_along_axis(faces, index, 1), np.take_along_axis(uv_faces, index, 1)
    order = rng.permutation(len(faces))
    np.testing.assert_array_equal(polygon_uv(quads, faces[order], uv_faces[order]), uv_quads)


def test_triangles_among_quads():
    polygons = np.array([[0, 1, 2, -1], [2, 1, 3, 4]])
    faces = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4]])
    assert polygon_uv(polygons, faces, faces + 10).tolist() == [[10, 11, 12, -1], [12, 11, 13, 14]]


def test_foreign_polygons_have_no_corners():
    assert polygon_uv(np.array([[0, 1, 2, 3]]), np.array([[0, 1, 2]]), np.array([[0, 1, 2]])) is None
    assert polygon_uv(np.array([[0, 1, 2, 3]]), np.empty((0, 3), int), np.empty((0, 3), int)) is None


def test_wrong_shapes_are_refused():
    with pytest.raises(ShapeError):
        polygon_uv(np.zeros((1, 3), int), np.zeros((1, 3), int), np.zeros((1, 3), int))
    with pytest.raises(ShapeError):
        polygon_uv(np.zeros((1, 4), int), np.zeros((1, 3), int), np.zeros((2, 3), int))


def test_the_whole_of_a_real_face(ict_face):
    t = ict_face.topology
    corners = polygon_uv(t.quads, t.faces, t.uv_faces)
    assert corners is not None and corners.shape == t.quads.shape
    assert ((corners < 0) == (t.quads < 0)).all()
