import json
from types import SimpleNamespace

import numpy as np

import facewright
from facewright.warehouse.provenance import package_versions, plain, without_folder


def test_values_become_plain_and_stay_what_they_were():
    value = {"a": np.arange(3), 2: (np.float32(0.1), None, True), "c": {"nan": np.nan, "inf": np.inf}, "d": "text"}
    assert plain(value) == {"a": [0, 1, 2], "2": [0.1, None, True], "c": {"nan": None, "inf": None}, "d": "text"}
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == plain(value)
    assert plain(np.bool_(True)) is True
    assert plain(1.23456789) == 1.23457


def test_versions_name_the_package_itself():
    versions = package_versions()
    assert versions["facewright"] == facewright.__version__
    assert versions["numpy"] == np.__version__
    assert all(isinstance(v, str) and v for v in versions.values())


def test_a_package_that_is_not_installed_is_left_out(monkeypatch):
    from facewright.warehouse import provenance

    monkeypatch.setattr(provenance, "_PACKAGES", ("numpy", "no-such-package-of-ours"))
    assert set(package_versions()) == {"facewright", "numpy"}
    assert SimpleNamespace(**package_versions()).numpy


def test_no_text_names_the_folder_of_the_captures(tmp_path):
    folder = tmp_path / "anna"
    told = {
        "failed": {"smile": {"reason": f"{folder / 'smile' / 'depth.txt'} is damaged; see {folder}."}},
        "n": [1, "x"],
    }
    found = without_folder(told, folder)
    assert found == {"failed": {"smile": {"reason": "smile/depth.txt is damaged; see anna."}}, "n": [1, "x"]}
