"""The matte of rendered people, whose outline is known."""

import numpy as np
import pytest
from scipy import ndimage

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import ShapeError
from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
from facewright.imaging.head_matte import find_head_matte
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.photo_layers import PhotoLayers
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import render_mesh
from facewright.imaging.source_surface import SourceSurface

SIZE = (300, 320)


@pytest.fixture(scope="module")
def scene(builtin_face):
    pose = RigidMotion(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 10.0, 900.0]))
    seen = pose.apply(builtin_face.mean_shape.astype(np.float64))
    view = MeshView(Intrinsics(520.0, 520.0, 159.5, 149.5).project(seen), seen)
    faces = visible_faces(builtin_face)
    look = albedo_function(builtin_face, sample_appearance(np.random.default_rng(3)), faces)
    _, x = np.mgrid[: SIZE[0], : SIZE[1]]
    wall = np.stack([60 + 50 * ((x // 9) % 2), 110 + 40 * ((x // 9) % 2), 170 + 0 * x], axis=-1).astype(np.uint8)
    photo = render_mesh(seen, view.pixels, faces, SIZE, albedo=look, background=wall).image
    covered = rasterise(view.pixels, seen[:, 2], faces, SIZE).covered
    return photo, SourceSurface.of(view, builtin_face), covered, wall


def _inside(matte, shape):
    whole = np.zeros(shape, np.uint8)
    (x, y), (h, w) = matte.origin, matte.alpha.shape
    whole[y : y + h, x : x + w] = matte.alpha
    return whole > 127


def _finder(covered):
    """A finder like the network: soft, and off by a few pixels."""
    blurred = ndimage.gaussian_filter(ndimage.shift(covered.astype(np.float32), (2, -2)), 3)

    def find(picture):
        return blurred[::2, ::2][: -(-picture.shape[0] // 2), : -(-picture.shape[1] // 2)]

    return find


@pytest.mark.parametrize("help", ["none", "finder"])
def test_it_is_the_rendered_outline(scene, help):
    photo, surface, covered, _ = scene
    matte = find_head_matte(photo, surface, None if help == "none" else _finder(covered))
    found = _inside(matte, SIZE)
    rows = np.s_[: int(surface.chin[1])]
    both = (found & covered)[rows].sum() / (found | covered)[rows].sum()
    assert both > 0.97, both
    assert matte.certainty > 0.8


def test_a_wall_of_the_same_colours_is_not_parted(scene):
    """No guess where nothing tells: the background follows the head as ever."""
    photo, surface, covered, _ = scene
    rng = np.random.default_rng(0)
    shuffled = photo.copy()
    shuffled[~covered] = rng.permutation(photo[covered])[rng.integers(0, covered.sum(), (~covered).sum())]
    assert find_head_matte(shuffled, surface, None).certainty < 0.7
    assert PhotoLayers.of(shuffled, surface) is None


def test_a_finder_that_cannot_tell_is_none(scene):
    photo, surface, _, _ = scene
    alone = find_head_matte(photo, surface, None)
    np.testing.assert_array_equal(find_head_matte(photo, surface, lambda picture: None).alpha, alone.alpha)


def test_the_layers_are_the_person_and_the_wall(scene):
    photo, surface, covered, wall = scene
    layers = PhotoLayers.of(photo, surface, _finder(covered))
    (x, y), (h, w) = layers.origin, layers.alpha.shape
    part, behind = photo[y : y + h, x : x + w], wall[y : y + h, x : x + w]
    np.testing.assert_array_equal(layers.plate[~layers.hidden], part[~layers.hidden])
    near = layers.hidden & (ndimage.distance_transform_edt(covered)[y : y + h, x : x + w] < 12)
    near[int(surface.chin[1]) - y :] = False
    assert np.abs(layers.plate[near].astype(float) - behind[near]).mean() < 14
    both = layers.front + (1 - layers.alpha[..., None] / 255) * layers.plate
    assert np.abs(both - part)[layers.hidden].mean() < 1.5


def test_shapes_must_match(scene):
    with pytest.raises(ShapeError):
        find_head_matte(scene[0][..., 0], scene[1], None)
