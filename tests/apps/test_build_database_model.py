"""Labels on their way from a database's people into a model file."""

import numpy as np
import pytest

pytest.importorskip("zarr")
pytest.importorskip("dask")

from facewright.apps.build_database_model import BuildDatabaseModelRequest, build_database_model
from facewright.faces.simulate import simulate_neutrals
from facewright.models.bilinear_store import load_bilinear
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

PEOPLE = 15


@pytest.fixture(scope="module")
def database(builtin_face, tmp_path_factory):
    face = builtin_face.skin()
    url = str(tmp_path_factory.mktemp("people") / "db")
    warehouse = Warehouse.create(url, face)
    neutrals = simulate_neutrals(face, PEOPLE, np.random.default_rng(2))
    for k, neutral in enumerate(neutrals):
        shapes = np.concatenate([neutral[None], neutral + face.blendshape_deltas]).astype(np.float32)
        attributes = {"age": str(20 + k) if k % 2 else 20 + k, "note": f"session {k} of Jane Doe"}
        if k != 4:
            attributes["sex"] = "female" if k % 3 else "male"
        warehouse.write_subject(Subject(f"p{k:02d}", ("neutral",), shapes[:1], shapes, attributes=attributes))
    return url


def test_labels_reach_the_model_without_names_and_notes(database, tmp_path):
    out = tmp_path / "m.fwbm"
    built = build_database_model(BuildDatabaseModelRequest(database, out, n_identity=8, n_expression=5))
    labels = load_bilinear(out).labels
    assert labels == built.model.labels
    assert set(labels) == {"age", "sex"}
    assert labels["age"] == tuple(20 + k for k in range(PEOPLE))  # numbers, also where written as text
    assert labels["sex"][:6] == ("male", "female", "female", "male", None, "female")
    stored = out.read_bytes()
    assert b"Jane" not in stored and b"p01" not in stored


def test_only_the_people_of_the_model_are_labelled(database, tmp_path):
    request = BuildDatabaseModelRequest(
        database, tmp_path / "m.fwbm", n_identity=4, n_expression=3, where=("age >= 24",), n_held_out=2
    )
    model = build_database_model(request).model
    assert len(model.labels["age"]) == len(model.identity_weights) == 9
    assert min(model.labels["age"]) >= 24
