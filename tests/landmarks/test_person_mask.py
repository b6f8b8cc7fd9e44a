"""Persons told from what lies behind them."""

import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.landmarks import person_mask
from facewright.landmarks.person_mask import _reduced, person_finder, person_probability


@pytest.mark.landmarks
@pytest.mark.parametrize("times", [1, 3])
def test_the_astronaut_is_found(times):
    pytest.importorskip("mediapipe")
    data = pytest.importorskip("skimage.data")
    picture = np.kron(data.astronaut()[:360, 60:400], np.ones((times, times, 1), np.uint8))
    found = person_probability(picture)
    assert max(found.shape) <= 512 and found.dtype == np.float32 and 0 <= found.min() <= found.max() <= 1
    y, x = (round(k * n / 360) for k, n in zip((110, 165), (found.shape[0], found.shape[0])))
    assert found[y, x] > 0.9  # her nose
    assert found[: y // 5, : x // 4].mean() < 0.1


def test_reduced_pictures_are_means_of_blocks(rng):
    picture = rng.integers(0, 256, (7, 10, 3)).astype(np.uint8)
    found = _reduced(picture, 4)
    assert found.shape == (2, 3, 3)
    np.testing.assert_array_equal(found[1, 2], np.rint(picture[4:, 8:].mean(axis=(0, 1))))
    np.testing.assert_array_equal(_reduced(picture, 1), picture)


def test_without_mediapipe_there_is_no_finder(monkeypatch):
    monkeypatch.setattr(person_mask, "find_spec", lambda name: None)
    assert person_finder() is None


def test_a_release_without_the_network_cannot_tell(monkeypatch):
    monkeypatch.setattr(person_mask, "import_mediapipe", lambda: object())
    assert person_probability(np.zeros((8, 8, 3), np.uint8)) is None


def test_shapes_must_match():
    with pytest.raises(ShapeError):
        person_probability(np.zeros((8, 8), np.uint8))
