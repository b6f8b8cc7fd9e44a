"""What a photo shows of a head."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.errors import ShapeError
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.source_surface import BODY, HEAD, INNER, SourceSurface, triangle_kinds


def _view(face, yaw=0.0, scale=1.5):
    c = face.mean_shape @ np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("y", yaw, degrees=True).as_matrix().T
    return MeshView(c[:, :2] * scale + 300.0, c + (0, 0, 2000.0), perspective=False)


@pytest.fixture(scope="module", params=["builtin", "ict"])
def face(request):
    return request.getfixturevalue(f"{request.param}_face")


def test_kinds_of_triangles(face):
    kinds, faces = triangle_kinds(face), face.topology.faces
    masks = face.topology.masks
    assert (kinds[(faces >= face.n_skin).any(axis=1)] == INNER).all()
    cheek = np.isin(faces, masks["cheeks_left"]).all(axis=1)
    assert cheek.any() and (kinds[cheek] == HEAD).all()
    low = (face.mean_shape[faces, 1] < face.mean_shape[masks["chin"], 1].min() - 15).all(axis=1) & (kinds != INNER)
    assert low.any() and (kinds[low] == BODY).all()
    high = (face.mean_shape[faces, 1] > 60).all(axis=1)
    assert (kinds[high] == HEAD).all()


def test_trust_goes_to_what_the_photo_shows(face):
    masks = face.topology.masks
    surface = SourceSurface.of(_view(face), face)
    blend = surface.weights[:, 0]
    assert blend.min() >= 0 and blend.max() <= 1
    nose = masks["nose"]
    bridge = nose[face.mean_shape[nose, 2] > np.percentile(face.mean_shape[nose, 2], 85)]
    forehead = masks["forehead"][np.abs(face.mean_shape[masks["forehead"], 0]) < 30]
    assert np.median(blend[bridge]) > 0.45 and np.median(blend[forehead]) > 0.6
    for ids in (masks["cheeks_left"], masks["cheeks_right"]):  # they curve away
        assert blend[ids].max() > 0.9 and np.mean(blend[ids] > 0.2) > 0.6
    assert (blend[face.n_skin :] == 0).all()
    back = face.mean_shape[:, 2] < 0
    assert (blend[back] == 0).all()


def test_a_turned_head_hides_its_far_side(face):
    masks = face.topology.masks
    surface = SourceSurface.of(_view(face, -50.0), face)
    cheeks = masks["cheeks_right"], masks["cheeks_left"]
    near, far = sorted(cheeks, key=lambda ids: surface.view.depth[ids].mean())
    assert surface.weights[far, 0].mean() < 0.6 * surface.weights[near, 0].mean()


def test_weights_rise_smoothly(face):
    surface = SourceSurface.of(_view(face), face)
    faces = face.topology.faces
    skin = faces[(faces < face.n_skin).all(axis=1)]
    a, b = skin[:, [0, 1, 2]].ravel(), skin[:, [1, 2, 0]].ravel()
    length = np.linalg.norm(face.mean_shape[a] - face.mean_shape[b], axis=1)
    slope = np.abs(surface.weights[a, 0] - surface.weights[b, 0]) / np.maximum(length, 0.5)
    assert np.quantile(slope, 0.999) < 0.4  # per millimetre


def test_the_outline_is_on_the_silhouette(face):
    surface = SourceSurface.of(_view(face), face)
    nose = surface.view.pixels[face.topology.masks["nose"]].mean(axis=0)
    j, i = np.round((nose - surface.outline_origin)[::-1] * surface.outline_scale).astype(int)
    # every entry lies about half a cell before the first place that is not the head
    head = np.unique(surface.faces[surface.kinds != BODY])
    lo, hi = surface.view.pixels[head].min(axis=0), surface.view.pixels[head].max(axis=0)
    place = surface.outline[j, i]
    assert (place >= lo - 2).all() and (place <= hi + 2).all()
    assert np.linalg.norm(place - nose) > 0.15 * surface.head_size
    row = surface.outline[j]  # along a row the nearest outline changes sides
    assert row[5, 0] < nose[0] < row[-6, 0]


def test_the_head_is_measured(face):
    small, large = (SourceSurface.of(_view(face, scale=s), face) for s in (0.5, 2.0))
    assert large.head_size / small.head_size == pytest.approx(4.0, rel=0.05)
    np.testing.assert_allclose(small.down, (0, 1), atol=0.05)
    assert small.chin_vertex in face.topology.masks["chin"]


def test_views_must_match(builtin_face):
    view = _view(builtin_face)
    with pytest.raises(ShapeError):
        SourceSurface.of(MeshView(view.pixels[1:], view.camera_vertices[1:]), builtin_face)
