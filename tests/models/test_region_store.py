"""Region-based models in files."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.container import write_container
from facewright.models.region_store import KIND, load_region_model, region_fingerprint, save_region_model

_spec = importlib.util.spec_from_file_location("reference_regions", Path(__file__).with_name("reference_regions.py"))
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)


def test_a_model_comes_back_to_the_last_bit(rng, tmp_path):
    model = replace(reference.small_model(rng, centred=True), provenance={"template": "ict", "vertex_ids": [1, 2]})
    save_region_model(model, tmp_path / "a.fwrm")
    loaded = load_region_model(tmp_path / "a.fwrm")
    assert loaded.regions.names == model.regions.names
    assert loaded.coefficient_names == model.coefficient_names
    assert loaded.provenance == model.provenance
    np.testing.assert_array_equal(loaded.faces, model.faces)
    np.testing.assert_array_equal(loaded.neutral, model.neutral)
    for key in ("means", "bases", "deviations", "units", "lower", "upper"):
        for a, b in zip(getattr(loaded, key), getattr(model, key), strict=True):
            np.testing.assert_array_equal(a, b)
    for a, b in zip(loaded.regions.members, model.regions.members, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_fingerprint_tells_models_apart(rng):
    model = reference.small_model(rng)
    assert region_fingerprint(model) == region_fingerprint(replace(model, provenance={"other": 1}))
    assert region_fingerprint(model) != region_fingerprint(replace(model, neutral=model.neutral + 1e-6))
    bases = (model.bases[0] * 1.0000001, *model.bases[1:])
    assert region_fingerprint(model) != region_fingerprint(replace(model, bases=bases))


def test_damaged_and_foreign_files_are_refused(rng, tmp_path):
    path = tmp_path / "a.fwrm"
    with pytest.raises(StoreError):
        load_region_model(path)
    save_region_model(reference.small_model(rng), path)
    content = path.read_bytes()
    for damaged in (content[:-9], content[:200], b"", b"PK\x03\x04" + content):
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError):
            load_region_model(path)
    flipped = bytearray(content)
    flipped[-40] ^= 1
    path.write_bytes(bytes(flipped))
    with pytest.raises(FileFormatError, match="checksum"):
        load_region_model(path)
    write_container(path, KIND, 1, {"arrays": {}}, {})
    with pytest.raises(FileFormatError, match="region model"):
        load_region_model(path)


def test_provenance_must_be_json(rng, tmp_path):
    model = replace(reference.small_model(rng), provenance={"a": np.zeros(3)})
    with pytest.raises(ValueRangeError, match="JSON"):
        save_region_model(model, tmp_path / "a.fwrm")
    assert not list(tmp_path.iterdir())
