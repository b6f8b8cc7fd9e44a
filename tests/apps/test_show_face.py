"""Describing faces, painting people, describing the machine."""

import numpy as np
import pytest

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
