import numpy as np
import pytest

from facewright.errors import FacewrightError
from facewright.models.region_symmetry import cluster_symmetry, mirrored_clusters, mirrored_regions, nearest_mirror
from facewright.models.regions import Regions

NONE = np.zeros((0, 3), int)


def test_mirror_of_points_on_both_sides():
    points = np.array([[-2.0, 0, 0], [2.1, 0, 0], [0.1, 5, 0]])
    assert nearest_mirror(points, NONE).tolist() == [1, 0, 2]
    with pytest.raises(FacewrightError, match="finite"):
        nearest_mirror(points * np.nan, NONE)


def test_lips_that_lie_on_each_other_keep_their_side():
    """Upper lip 0, 1 and lower lip 2, 3 in the same two places; each has a vertex above or below."""
    points = np.array([[-1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0], [1.0, 0, 0], [0, 2.0, 0], [0, -2.0, 0]])
    faces = np.array([[0, 1, 4], [2, 5, 3]])
    assert nearest_mirror(points, faces).tolist() == [1, 0, 3, 2, 4, 5]


def test_symmetry_is_one_for_mirrored_clusters_and_small_by_chance(rng):
    x = rng.uniform(-1, 1, 400)
    points = np.concatenate([np.stack([x, 0 * x, 0 * x], 1), np.stack([-x, 0 * x, 0 * x], 1)])
    mirror = nearest_mirror(points, NONE)
    assert cluster_symmetry((points[:, 0] > 0).astype(int), mirror) == 1.0
    assert cluster_symmetry((np.abs(points[:, 0]) > 0.5).astype(int), mirror) == 1.0
    assert abs(cluster_symmetry(rng.integers(0, 5, 800), mirror)) < 0.05


def test_nearly_symmetric_clusters_become_exactly_so():
    x = np.arange(-4.0, 5.0)
    mirror = np.arange(9)[::-1]
    assert mirrored_clusters(np.array([0, 0, 0, 1, 1, 1, 1, 2, 2]), mirror, x).tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    stays = np.array([0, 0, 0, 0, 0, 1, 1, 2, 2])  # both of the left have their images in 0
    assert mirrored_clusters(stays, mirror, x).tolist() == stays.tolist()


def test_regions_share_the_mirror_images_of_what_they_share():
    labels, mirror = np.array([0, 0, 0, 1, 1]), np.arange(5)[::-1]
    regions = Regions(5, (np.array([0, 1, 2, 3], np.int32), np.array([2, 3, 4], np.int32)), ("right", "left"))
    symmetric = mirrored_regions(regions, labels, mirror)
    assert [ids.tolist() for ids in symmetric.members] == [[0, 1, 2, 3], [1, 2, 3, 4]]
