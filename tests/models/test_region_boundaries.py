import numpy as np
import pytest

from facewright.errors import FacewrightError
from facewright.models.region_boundaries import home_regions, share_boundaries
from facewright.models.regions import Regions

# 0 - 1 - 2 - 3 above 4 - 5 - 6 - 7
FACES = np.array([[0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 6], [2, 6, 3], [3, 6, 7]])


def test_corners_of_triangles_across_the_border_are_shared():
    regions = share_boundaries(np.array([0, 0, 1, 1, 0, 0, 1, 1]), FACES)
    assert regions.names == ("region_01", "region_02")
    assert regions.members[0].tolist() == [0, 1, 2, 4, 5, 6]
    assert regions.members[1].tolist() == [1, 2, 3, 5, 6, 7]
    assert regions.count.tolist() == [1, 2, 2, 1, 1, 2, 2, 1]
    assert home_regions(regions).tolist() == [0, 0, 0, 1, 0, 0, 0, 1]


def test_one_cluster_is_the_holistic_case():
    regions = share_boundaries(np.zeros(8, int), FACES, ["face"])
    holistic = Regions.holistic(8)
    assert regions.names == holistic.names
    np.testing.assert_array_equal(regions.members[0], holistic.members[0])


@pytest.mark.parametrize("labels", [[0, 1, 2, 0, 1, 2, 0, 1], [0, 0, 0, 1, 2, 2, 0, 1], [2, 0, 0, 1, 0, 1, 0, 1]])
def test_naive_twin(labels):
    for i, ids in enumerate(share_boundaries(np.array(labels), FACES).members):
        expected = {v for v in range(8) if labels[v] == i}
        expected |= {int(v) for face in FACES for v in face if i in [labels[c] for c in face]}
        assert set(ids.tolist()) == expected


@pytest.mark.parametrize(
    ("labels", "names", "words"),
    [
        ([0, 0, 2, 2, 0, 0, 2, 2], None, "each used"),
        ([0, 0, -1, 1, 0, 0, 1, 1], None, "each used"),
        ([0, 0, 1, 1, 0, 0, 1, 1], ["left"], "one for each of 2"),
        ([0, 0, 1, 1, 0, 0, 1], None, "labels|faces|outside|indices"),
    ],
)
def test_refusals(labels, names, words):
    with pytest.raises(FacewrightError, match=words):
        share_boundaries(np.array(labels), FACES, names)
