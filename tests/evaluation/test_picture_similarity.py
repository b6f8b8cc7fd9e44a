"""Similarity of pictures within a region."""

import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.evaluation.picture_similarity import psnr_db, ssim

REGION = np.zeros((40, 50), bool)
REGION[10:30, 10:40] = True


def test_equal_pictures_are_alike(rng):
    picture = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    assert psnr_db(picture, picture, REGION) == 100.0
    assert ssim(picture, picture, REGION) == pytest.approx(1.0)


def test_a_constant_error_has_its_own_ratio():
    truth = np.full((40, 50, 3), 100, np.uint8)
    outside = np.where(REGION[..., None], truth + 5, 255).astype(np.uint8)  # what lies outside does not count
    assert psnr_db(outside, truth, REGION) == pytest.approx(20 * np.log10(255 / 5))


def test_similarity_equals_scikit_image(rng):
    metrics = pytest.importorskip("skimage.metrics")
    truth = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    other = np.clip(truth + rng.normal(0, 30, truth.shape), 0, 255).astype(np.uint8)
    a, b = (p @ np.array([0.299, 0.587, 0.114]) for p in (other, truth))
    _, full = metrics.structural_similarity(
        a, b, data_range=255, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    assert ssim(other, truth, REGION) == pytest.approx(full[REGION].mean(), abs=1e-6)


def test_bad_input_is_refused():
    picture = np.zeros((40, 50, 3), np.uint8)
    with pytest.raises(ValueRangeError, match="region"):
        psnr_db(picture, picture, np.zeros((40, 50), bool))
    with pytest.raises(ShapeError):
        ssim(picture, picture[1:], REGION)
