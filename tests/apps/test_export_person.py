"""Rigs of people in a database."""

import numpy as np
import pytest

from facewright.apps.export_person import ExportPersonRequest, export_person
from facewright.errors import StoreError, ValueRangeError
from facewright.io.gltf_reader import read_gltf

pytest.importorskip("zarr", reason="needs the warehouse extra")


@pytest.fixture(scope="module")
def database(tmp_path_factory, builtin_face):
    """Two people, one without blendshapes."""
    from facewright.warehouse.store import Warehouse
    from facewright.warehouse.subject import Subject

    url = str(tmp_path_factory.mktemp("export") / "faces.zarr")
    warehouse = Warehouse.create(url, builtin_face)
    neutral = builtin_face.mean_shape + np.float32(1.0)
    shapes = np.concatenate([neutral[None], neutral + 0.9 * builtin_face.blendshape_deltas]).astype(np.float32)
    warehouse.write_subject(Subject("anna", ("neutral",), shapes[:1], blendshapes=shapes))
    warehouse.write_subject(Subject("bert", ("neutral",), shapes[:1]))
    return url


def test_a_captured_person_becomes_a_rig(tmp_path, database, builtin_face):
    result = export_person(ExportPersonRequest(tmp_path / "anna.glb", database=database, subject="anna"))
    assert result.shape_names == builtin_face.blendshape_names
    scene = read_gltf(tmp_path / "anna.glb")
    jaw = builtin_face.blendshape_names.index("jawOpen")
    largest = max(np.abs(mesh.morph_deltas[jaw]).max() for mesh in scene.meshes)
    assert largest == pytest.approx(0.9 * np.abs(builtin_face.blendshape_deltas[jaw]).max(), rel=1e-3)


def test_people_who_cannot_be_exported(tmp_path, database):
    out = tmp_path / "x.glb"
    with pytest.raises(ValueRangeError, match="subject must have blendshapes to be a rig, got 'bert' without"):
        export_person(ExportPersonRequest(out, database=database, subject="bert"))
    with pytest.raises(StoreError, match="carl"):
        export_person(ExportPersonRequest(out, database=database, subject="carl"))
    with pytest.raises(ValueRangeError, match="subject must be given with database"):
        ExportPersonRequest(out, database=database)
    with pytest.raises(ValueRangeError, match="database must be given with subject"):
        ExportPersonRequest(out, subject="anna")
    with pytest.raises(ValueRangeError, match="model and seed must be left out"):
        ExportPersonRequest(out, database=database, subject="anna", seed=3)
    assert not out.exists()
