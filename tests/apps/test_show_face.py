"""Describing faces, painting people, describing the machine."""

import re
from pathlib import Path

import numpy as np
import pytest

from facewright.apps import describe
from facewright.apps.describe import describe_installation, describe_machine
from facewright.apps.paint_person import face_of_model, person_colors, portrait_painter
from facewright.apps.show_face import ShowFaceRequest, show_face
from facewright.errors import MissingFaceError, StoreError, ValueRangeError
from facewright.io.image import read_image


def test_a_face_described_and_drawn(tmp_path, builtin_face):
    steps = []
    request = ShowFaceRequest("builtin", tmp_path / "f.png", seed=2, size=(48, 40))
    found = show_face(request, lambda *step: steps.append(step))
    assert found["vertices"] == builtin_face.topology.n_vertices == sum(found["parts"].values())
    assert found["blendshapes"] == 46 and found["fingerprint"] == builtin_face.topology.fingerprint
    assert steps[-1] == ("drawing expressions", 20, 20)
    sheet = read_image(tmp_path / "f.png")
    assert sheet.shape == (4 * (48 + 6 + 22) + 6, 5 * (40 + 6) + 6, 3)
    assert "picture" not in show_face(ShowFaceRequest("builtin"))


def test_what_cannot_be_shown(tmp_path):
    with pytest.raises(MissingFaceError):
        show_face(ShowFaceRequest("nobody"))
    with pytest.raises(ValueRangeError, match="seed"):
        ShowFaceRequest(seed=-1)
    with pytest.raises(StoreError):
        show_face(ShowFaceRequest("builtin", tmp_path / "none" / "f.png", size=(16, 16)))


def test_colours_and_portraits(builtin_face):
    colors = person_colors(builtin_face, seed=1)
    assert colors.shape == builtin_face.mean_shape.shape and colors.dtype == np.uint8 and colors.std() > 10
    assert person_colors(None) is None
    painted = portrait_painter(builtin_face.topology, builtin_face, (60, 50), yaw_degrees=10)(builtin_face.mean_shape)
    plain = portrait_painter(builtin_face.topology, None, (60, 50), yaw_degrees=10)(builtin_face.mean_shape)
    assert painted.shape == plain.shape == (60, 50, 3)
    assert np.abs(painted.astype(int) - plain).max() > 30  # brows and lips show


@pytest.mark.parametrize("name", ["nobody", "builtin"])
def test_a_model_of_an_unknown_face_or_another_topology_has_no_face(name):
    from types import SimpleNamespace

    from facewright.mesh.topology import Topology

    topology = Topology("other", 3, np.array([[0, 1, 2]], np.int32))
    assert face_of_model(SimpleNamespace(provenance={"face": name}, n_vertices=3, topology=topology)) is None


def test_the_machine_is_described():
    machine = describe_machine()
    assert machine["cores"] >= 1 and machine["numpy"] == np.__version__ and machine["processor"]
    found = describe_installation()
    assert found["machine"] == machine and {"builtin", "ict"} == {face["name"] for face in found["faces"]}


def test_extras_are_those_of_the_project_and_what_is_missing_is_named(monkeypatch):
    import tomllib

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = {k: v for k, v in project["optional-dependencies"].items() if k not in ("bench", "dev")}
    brought = {
        extra: {re.match(r"[\w-]+", text)[0].replace("-", "_") for text in texts}
        - {"open3d_cpu", "numpy", "scikit_image"}
        for extra, texts in extras.items()
    }
    assert {extra: set(packages) for extra, packages in describe.EXTRAS.items()} == brought
    there = describe.util.find_spec
    monkeypatch.setattr(describe.util, "find_spec", lambda name: None if name in ("open3d", "zarr") else there(name))
    found = describe_installation()
    assert not found["extras"]["capture"] and not found["extras"]["warehouse"]
    assert "open3d" in found["missing"]["capture"] and "zarr" in found["missing"]["warehouse"]
    assert "imagecodecs" not in found["missing"]["capture"] or there("imagecodecs") is None
    assert {"open3d", "zarr", "dask", "distributed", "mediapipe"} <= set(found["packages"])


def test_a_package_under_another_name_has_its_version(monkeypatch):
    def version(name):
        if name == "open3d-cpu":
            return "0.19.0"
        raise describe.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(describe.metadata, "version", version)
    packages = describe_installation()["packages"]
    assert packages["open3d"] == "0.19.0" and packages["zarr"] is None
