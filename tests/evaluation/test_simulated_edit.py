import numpy as np
import pytest

from facewright.evaluation.simulated_edit import IMAGE_SIZE, TrueAttributes, simulate_scene
from facewright.evaluation.textured_background import textured_background
from facewright.faces.attributes import measure_attributes


@pytest.fixture(scope="module")
def scene(builtin_face):
    return simulate_scene(builtin_face, np.random.default_rng(5))


@pytest.fixture(scope="module")
def truth(builtin_face):
    return TrueAttributes(builtin_face)


@pytest.mark.parametrize("name", ["face length", "mouth width", "cheek fullness"])
def test_the_true_change_is_what_was_asked_for(scene, truth, builtin_face, name):
    """In millimetres of the population, on a person outside the span of the modes."""
    neutral = scene.person.neutral.astype(float)
    meshes = np.stack([neutral, neutral + truth.change(scene.person.neutral, {name: 1.5})])
    before, after = measure_attributes(meshes, builtin_face.topology)
    change = (after - before) / truth.standard_deviation
    row = truth.names.index(name)
    assert change[row] == pytest.approx(1.5, abs=0.02)
    assert np.abs(np.delete(change, row)).mean() < 0.2


def test_pictures_before_and_after(scene, truth):
    photo, region = scene.draw()
    again, _ = scene.draw(np.zeros_like(scene.person.neutral))
    np.testing.assert_array_equal(photo, again)
    after, changed = scene.draw(truth.change(scene.person.neutral, {"face width": 1.5}))
    assert 0.05 < region.mean() < 0.5
    assert changed.sum() > 1.02 * region.sum()
    different = (photo != after).any(axis=2)
    assert different[region & changed].mean() > 0.8
    assert not different[:8].any() and different.mean() < 0.8  # the wall


def test_the_head_stays_in_place(scene, truth):
    """The eyes hardly move when the face gets longer; the chin does."""
    change = truth.change(scene.person.neutral, {"face length": 2.0})
    ids = scene.face.topology.landmarks["fw74"]
    before, after = (scene.intrinsics.project(scene._seen(c))[ids] for c in (None, change))
    moved = np.linalg.norm(after - before, axis=1)
    assert moved[7] > 5.0 and moved[7] > 2.5 * moved[[27, 31, 35, 39]].mean()


def test_a_wall_has_texture_everywhere(rng):
    wall = textured_background((120, 130, 140), IMAGE_SIZE, rng)
    assert wall.shape == (*IMAGE_SIZE, 3) and wall.dtype == np.uint8
    patches = wall.reshape(16, 32, 16, 32, 3).std(axis=(1, 3))
    assert patches.min() > 2.0
    np.testing.assert_allclose(wall.mean(axis=(0, 1)), [120, 130, 140], atol=40)
