"""Suite `scale`: its figures are measured on what they say, and grow only with what they should."""

import shutil

import numpy as np
import pytest

from facewright.errors import FacewrightError, StoreError, ValueRangeError
from facewright.evaluation import database_svd, scale
from facewright.evaluation.database_svd import fill, measure_database_svd, svd_reference_error
from facewright.warehouse.generated import GeneratedSubjects
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")
pytest.importorskip("dask")


def test_the_decomposition_is_lapacks(builtin_face):
    assert svd_reference_error(builtin_face.skin(), seed=0) < 1e-6


def test_memory_and_time_of_a_small_database(builtin_face, tmp_path):
    face = builtin_face.skin()
    steps = []
    found = measure_database_svd(face, 6, 0, (4, 10), tmp_path, lambda *step: steps.append(step))
    assert set(found) == {"svd_extra_peak_mb_6", "svd_seconds_6", "svd_must_hold_mb"}
    assert found["svd_must_hold_mb"] == pytest.approx(4 * 47 * face.topology.n_vertices * 12 / 1e6)
    assert found["svd_must_hold_mb"] < found["svd_extra_peak_mb_6"] < found["svd_must_hold_mb"] + 150
    assert found["svd_seconds_6"] > 0 and steps[-1] == ("generating 6 people", 6, 6)
    assert list(tmp_path.iterdir()) == []


def test_generated_people_are_the_same_in_a_larger_population(builtin_face, tmp_path):
    face = builtin_face.skin()
    fill(tmp_path / "few.zarr", face, 2, seed=4)
    store = Warehouse.open(tmp_path / "few.zarr")
    many = GeneratedSubjects(face, 100, seed=4)
    for number, name in enumerate(store.subject_names()):
        np.testing.assert_allclose(store.read_array(name, "blendshapes"), many.subject(number).blendshapes, atol=1e-4)
        assert name == many.name(number) and len(many) == 100


def test_generated_people_differ_in_more_directions_than_people_of_the_face(builtin_face):
    """The tensor has full rank, so that nothing about the memory of its decomposition is owed to its being simple."""
    face = builtin_face.skin()
    people = GeneratedSubjects(face, 30, seed=0)
    shapes = np.stack([people.shapes(number)[:, ::20].reshape(-1) for number in range(30)])
    values = np.linalg.svd(shapes.astype(float), compute_uv=False)
    assert values[-1] > 1e-4 * values[1]
    deltas = people.shapes(0)[1:] - people.shapes(0)[0]
    still = np.abs(face.blendshape_deltas).max(axis=2) < 1e-6
    assert np.abs(deltas[still]).max() < 1e-3  # where a shape does not move, it does not move in anybody
    with pytest.raises(ValueRangeError, match="number must be in"):
        people.subject(30)
    with pytest.raises(ValueRangeError, match="count must not be negative"):
        GeneratedSubjects(face, -1)


def test_what_cannot_be_measured_is_refused(builtin_face, tmp_path, monkeypatch):
    for wrong in ({"subjects": 0}, {"frames": 0}, {"expressions": ("smile", "grin")}, {"expressions": ("neutral",)}):
        with pytest.raises(ValueRangeError, match="must be positive"):
            scale.run(builtin_face, 0, **wrong)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(database_svd.shutil, "disk_usage", lambda _: usage._replace(free=10**6))
    with pytest.raises(StoreError, match="GB free for 1000 people"):
        measure_database_svd(builtin_face, 1000, 0, (50, 25), tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(database_svd, "fill", lambda store, *_: store.mkdir())
    with pytest.raises(FacewrightError, match=r"decomposition of 3 people failed: .*must be a facewright database"):
        measure_database_svd(builtin_face, 3, 0, (2, 2), tmp_path)


@pytest.mark.slow
def test_the_suite_runs_small(builtin_face, tmp_path):
    pytest.importorskip("open3d")
    pytest.importorskip("distributed")
    found = scale.run(
        builtin_face, 0, subjects=1, expressions=("neutral", "smile"), frames=2, svd_people=(4,), scratch=tmp_path
    )
    assert found["subjects_per_minute_1_worker"] == pytest.approx(60 / found["build_seconds_1_worker"])
    assert found["subjects_per_minute_2_workers"] == pytest.approx(120 / found["build_seconds_2_workers"])
    assert found["svd_reference_error"] < 1e-6 and list(tmp_path.iterdir()) == []
