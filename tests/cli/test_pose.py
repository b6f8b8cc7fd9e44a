import sys

import numpy as np
import pytest

from facewright.models.region_pca import fit_region_pca
from facewright.models.region_store import save_region_model
from facewright.models.regions import Regions


@pytest.fixture
def model(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    one = fit_region_pca(rng.normal(size=(9, 4, 3)), faces, rng.normal(size=(4, 3)), Regions.holistic(4), 2)
    save_region_model(one, tmp_path / "one.fwrm")
    return tmp_path / "one.fwrm"


def test_says_when_the_extra_is_missing(refused, model, monkeypatch):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert 'pip install "facewright[studio]"' in refused("pose", model)


def test_refuses_in_one_sentence(refused, model, tmp_path):
    pytest.importorskip("nicegui")
    (tmp_path / "photo.fwrm").write_bytes(b"\x89PNG....")
    assert "got a PNG picture" in refused("pose", tmp_path / "photo.fwrm")
    assert "cannot be read" in refused("pose", tmp_path / "none.fwrm")
    assert "beta must be finite and not negative" in refused("pose", model, "--beta", "-1")
    assert "gamma must be finite and not negative" in refused("pose", model, "--gamma", "-1")
    assert "character must be one of" in refused("pose", model, "--character", "bob")
    (tmp_path / "x.fwpose").write_text("{}")
    assert "must be a pose" in refused("pose", model, "--file", tmp_path / "x.fwpose")


def test_a_taken_port_is_told(refused, model):
    pytest.importorskip("nicegui")
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"127.0.0.1:{port}" in refused("pose", model, "--port", str(port))
