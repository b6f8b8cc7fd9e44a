"""Simulated people in a database."""

import numpy as np
import pytest

from facewright.apps.simulate_people import SimulatePeopleRequest, simulate_people
from facewright.errors import ValueRangeError

pytest.importorskip("zarr", reason="needs the warehouse extra")


def test_people_are_added_once_and_depend_on_their_number_alone(tmp_path, builtin_face):
    from facewright.warehouse.store import Warehouse

    out = str(tmp_path / "faces.zarr")
    first = simulate_people(SimulatePeopleRequest(out, 2, seed=5))
    assert first.added == ("simulated-0000", "simulated-0001")
    digest = Warehouse.open(out).digest("simulated-0001")
    again = simulate_people(SimulatePeopleRequest(out, 3, seed=5))
    assert again.added == ("simulated-0002",)
    assert again.present == first.added
    warehouse = Warehouse.open(out)
    assert warehouse.digest("simulated-0001") == digest
    other = simulate_people(SimulatePeopleRequest(str(tmp_path / "other.zarr"), 3, seed=5))
    assert Warehouse.open(other.url).digest("simulated-0002") == warehouse.digest("simulated-0002")
    person = warehouse.read_subject("simulated-0002")
    assert person.blendshapes.shape == (47, builtin_face.topology.n_vertices, 3)
    np.testing.assert_array_equal(person.meshes[0], person.blendshapes[0])
    assert 0.5 < np.linalg.norm(person.meshes[0] - builtin_face.mean_shape, axis=1).mean() < 20.0


def test_numbers_of_people_are_checked():
    with pytest.raises(ValueRangeError, match="n_people must be in"):
        SimulatePeopleRequest("faces.zarr", 0)
