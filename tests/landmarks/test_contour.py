from itertools import pairwise

import numpy as np
import pytest

from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ShapeError, TopologyError
from facewright.landmarks.contour import build_contour_strips, face_region, slide_on_outline
from facewright.mesh.topology import Topology


def test_sliding_finds_the_nearest_place(rng):
    outline = np.cumsum(rng.normal(size=(12, 2)), axis=0)
    points = rng.normal(size=(30, 2)) * 3
    sliding = slide_on_outline(points, outline)
    places = outline[sliding.first] + sliding.fraction[:, None] * np.diff(outline, axis=0)[sliding.first]
    dense = np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(outline)])
    nearest = np.linalg.norm(points[:, None] - dense[None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(points - places, axis=1), nearest, atol=1e-2)
    assert (sliding.fraction >= 0).all() and (sliding.fraction <= 1).all()


def test_sliding_takes_missing_points_and_degenerate_outlines():
    sliding = slide_on_outline(np.array([[np.nan, 0.0], [1.0, 1.0]]), np.zeros((3, 2)))
    assert np.isfinite(sliding.fraction).all()
    with pytest.raises(ShapeError):
        slide_on_outline(np.zeros((2, 3)), np.zeros((3, 2)))


@pytest.mark.parametrize("face_name", ["builtin_face", "ict_face"])
def test_strips_run_outwards_on_both_sides_alike(face_name, request):
    face = request.getfixturevalue(face_name).skin()
    strips = build_contour_strips(face.topology, face.mean_shape)
    K = len(strips.vertices)
    points = face.mean_shape[strips.vertices]
    assert strips.vertices.max() < face.topology.parts["face"][1]
    # the chin's strip is in the middle, the first is at the right (-x) temple
    assert abs(points[K // 2, -1, 0]) < 5 and points[0, -1, 0] < -50 and points[-1, -1, 0] > 50
    np.testing.assert_allclose(points[::-1, :, 0], -points[:, :, 0], atol=4.0)
    np.testing.assert_allclose(strips.outward[::-1] * [-1, 1, 1], strips.outward, atol=0.05)
    lengths = np.linalg.norm(points[:, -1] - points[:, 0], axis=1)
    assert (lengths > 8).all() and (lengths < 90).all()


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (35, 0), (-35, 10), (0, 20), (20, -20)])
def test_outline_is_the_silhouette_of_the_face_region(builtin_face, yaw, pitch):
    """Against a rasterised mask of the region: the outline lies on its border."""
    from facewright.imaging.rasterise import rasterise

    face = builtin_face.skin()
    R = rotation_from_head_angles(yaw, pitch, 0)
    seen = face.mean_shape @ R.T
    pixels = 3 * seen[:, :2] + 400
    strips = build_contour_strips(face.topology, face.mean_shape, 41, 30)
    chosen = strips.outline(pixels[strips.vertices], R)
    outline = pixels[strips.vertices[np.arange(len(chosen)), chosen]]
    region = np.zeros(len(seen), bool)
    region[face_region(face.topology, face.mean_shape)] = True
    faces = face.topology.faces[region[face.topology.faces].all(axis=1)]
    mask = rasterise(pixels, seen[:, 2], faces, (800, 800), perspective=False).covered
    from scipy.ndimage import distance_transform_edt

    depth_inside = distance_transform_edt(mask) + distance_transform_edt(~mask) - 1
    x, y = np.rint(outline).astype(int).T
    assert np.median(depth_inside[y, x]) / 3 < 1.0  # millimetres
    assert np.quantile(depth_inside[y, x], 0.9) / 3 < 4.0


def test_needs_a_marked_jaw_line(builtin_face):
    skin = builtin_face.skin()
    plain = Topology("plain", skin.topology.n_vertices, skin.topology.faces)
    with pytest.raises(TopologyError, match="ibug68"):
        build_contour_strips(plain, skin.mean_shape)
    ids = skin.topology.landmarks["ibug68"].copy()
    ids[3] = -1
    holey = Topology(
        "holey", skin.topology.n_vertices, skin.topology.faces, parts=skin.topology.parts, landmarks={"ibug68": ids}
    )
    with pytest.raises(TopologyError, match="17 jaw points"):
        face_region(holey, skin.mean_shape)
    with pytest.raises(ShapeError):
        build_contour_strips(skin.topology, skin.mean_shape[:-1])
