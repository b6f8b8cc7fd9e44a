"""Sets of vertices that cover a mesh and share boundaries."""

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.models.regions import Regions


def _ids(*values):
    return np.array(values, dtype=np.int32)


def test_count_tells_shared_vertices():
    regions = Regions(5, (_ids(0, 1, 2), _ids(2, 3, 4), _ids(2, 4)), ("a", "b", "c"))
    assert regions.count.tolist() == [1, 1, 3, 1, 2]


def test_holistic_is_one_region_of_all_vertices():
    regions = Regions.holistic(4)
    assert [ids.tolist() for ids in regions.members] == [[0, 1, 2, 3]]
    assert regions.count.tolist() == [1, 1, 1, 1]


@pytest.mark.parametrize(
    ("members", "names", "said"),
    [
        ((_ids(0, 1, 2),), ("a", "b"), "one name each"),
        ((_ids(0, 1), _ids(1, 2)), ("a", "a"), "one name each"),
        ((_ids(0, 1, 2), _ids()), ("a", "b"), "increasing order"),
        ((_ids(0, 2, 1),), ("a",), "increasing order"),
        ((_ids(0, 1, 1, 2),), ("a",), "increasing order"),
        ((_ids(0, 1, 2, 3),), ("a",), r"\[0, 3\)"),
        ((_ids(-1, 0, 1, 2),), ("a",), r"\[0, 3\)"),
        ((_ids(0, 1),), ("a",), "every vertex"),
        ((_ids(0, 1), _ids(2)), ("a", "b"), "share a vertex"),
    ],
)
def test_what_is_no_division_is_refused(members, names, said):
    with pytest.raises(ValueRangeError, match=said):
        Regions(3, members, names)
