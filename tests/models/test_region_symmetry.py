import numpy as np
import pytest

from facewright.errors import FacewrightError
from facewright.models.region_symmetry import cluster_symmetry, mirrored_clusters, nearest_mirror


def test_mirror_of_points_on_both_sides():
    points = np.array([[-2.0, 0, 0], [2.1, 0, 0], [0.1, 5, 0]])
    assert nearest_mirror(points).tolist() == [1, 0, 2]
    with pytest.raises(FacewrightError, match="finite"):
        nearest_mirror(points * np.nan)


def test_symmetry_is_one_for_mirrored_clusters_and_small_by_chance(rng):
    x = rng.uniform(-1, 1, 400)
    points = np.concatenate([np.stack([x, 0 * x, 0 * x], 1), np.stack([-x, 0 * x, 0 * x], 1)])
    mirror = nearest_mirror(points)
    assert cluster_symmetry((points[:, 0] > 0).astype(int), mirror) == 1.0
    assert cluster_symmetry((np.abs(points[:, 0]) > 0.5).astype(int), mirror) == 1.0
    assert abs(cluster_symmetry(rng.integers(0, 5, 800), mirror)) < 0.05


def test_nearly_symmetric_clusters_become_exactly_so():
    x = np.arange(-4.0, 5.0)
    mirror = np.arange(9)[::-1]
    assert mirrored_clusters(np.array([0, 0, 0, 1, 1, 1, 1, 2, 2]), mirror, x).tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    unpaired = np.array([0, 0, 1, 1, 1, 1, 1, 1, 2])  # 2 has its image in 0, which has half of its own in 1
    settled = mirrored_clusters(unpaired, mirror, x)
    assert settled.tolist() in (unpaired.tolist(), [0, 0, 1, 1, 1, 1, 1, 2, 2])
    stays = np.array([0, 0, 0, 0, 0, 1, 1, 2, 2])  # both of the left have their images in 0
    assert mirrored_clusters(stays, mirror, x).tolist() == stays.tolist()
