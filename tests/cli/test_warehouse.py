"""facewright warehouse: every verb answers people and programs, and says in one sentence what is wrong."""

import json

import numpy as np
import pytest
from PIL import Image

from facewright.faces.expressions import EXPRESSION_WEIGHTS
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

pytest.importorskip("zarr")


@pytest.fixture(scope="module")
def faces(tmp_path_factory, builtin_face):
    """A database of two people, three expressions and blendshapes each, with a picture of each expression."""
    store = Warehouse.create(tmp_path_factory.mktemp("store") / "faces.zarr", builtin_face)
    for k, (name, sex) in enumerate([("anna", "f"), ("bert", "m")]):
        neutral = builtin_face.mean_shape + builtin_face.identity_basis[k]
        shapes = np.concatenate([neutral[None], neutral + builtin_face.blendshape_deltas]).astype(np.float32)
        meshes = neutral + np.tensordot(EXPRESSION_WEIGHTS[[0, 2, 17]], builtin_face.blendshape_deltas, 1)
        store.write_subject(
            Subject(
                name=name,
                expressions=("neutral", "smile", "grin"),
                meshes=meshes.astype(np.float32),
                blendshapes=shapes,
                color=np.full((3, 48, 64, 3), 40 * k + 90, np.uint8),
                attributes={"age": 30 + 10 * k, "sex": sex},
                provenance={"source": "test"} if name == "bert" else _provenance(name),
            )
        )
    store.record_failure("carl", "no face was found", "NoFaceError")
    return store.url


def _provenance(name):
    """As `process_subject` writes it: each warning of fusion stands twice, one expression was dropped."""
    unsteady = "Frames differ by {} mm: the expression was not held."

    def facts(expression, residual, *warnings):
        return {
            "recording": expression,
            "landmarks": "detector" if expression == "smile" else "sidecar",
            "fusion": {"n_fused": 24, "raw_noise_mm": 2.2, "warnings": list(warnings)},
            "fit": {"stage2_rms_mm": residual, "landmark_rms_mm": 1.5},
            "rig_residual_mm": 0.31,
            "warnings": list(warnings),
        }

    return {
        "source": "captures",
        "versions": {"facewright": "0.1.0", "numpy": "1.26.4"},
        "face": {"name": "builtin", "topology": "abc"},
        "expressions": {
            "neutral": facts("neutral", 0.217),
            "smile": facts("smile", 0.228, unsteady.format(1.5)),
            "grin": facts("grin", 0.239, unsteady.format(2.5)),
        },
        "failed": {"anger": {"kind": "NoFaceError", "reason": "anger must show a face."}},
        "missing": ["sadness"],
    }


def _json(invoke, *args):
    result = invoke("warehouse", *args, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_ls(invoke, faces):
    found = _json(invoke, "ls", faces)
    assert [subject["name"] for subject in found["subjects"]] == ["anna", "bert"] and found["failures"] == 1
    assert found["subjects"][0]["attributes"] == {"age": 30, "sex": "f"}
    assert [s["name"] for s in _json(invoke, "ls", faces, "--where", "age>30", "-w", "sex=m")["subjects"]] == ["bert"]
    assert _json(invoke, "ls", faces, "--failures")["failures"][0]["reason"] == "no face was found"
    text = invoke("warehouse", "ls", faces).stdout
    assert "anna" in text and "age" in text and "--failures tells why" in text
    assert "NoFaceError" in invoke("warehouse", "ls", faces, "--failures").stdout


def test_show(invoke, faces, tmp_path):
    found = _json(invoke, "show", faces)
    assert found["subjects"] == 2 and found["face"] == "builtin" and found["attributes"] == ["age", "sex"]
    person = _json(invoke, "show", faces, "anna", "-o", tmp_path / "anna.png")
    assert person["expressions"] == ["neutral", "smile", "grin"] and person["provenance"] == _provenance("anna")
    with Image.open(tmp_path / "anna.png") as picture:
        assert picture.width > 1500 and picture.height > 1000
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    # rows of ten: pictures, expressions, then the neutral and 46 shapes; what was never drawn stays white
    rows = [pixels[k * 252 + 6 : k * 252 + 230] for k in range(7)]
    assert all((row[:, 6:190] < 250).any() for row in rows)
    assert (rows[0][:, 3 * 190 + 6 :] == 255).all() and (rows[1][:, 3 * 190 + 6 :] == 255).all()


def test_show_of_a_person_is_a_summary(invoke, faces):
    text = invoke("warehouse", "show", faces, "anna").stdout
    lines = text.splitlines()
    assert lines[0].startswith("anna of ") and "3 expressions, 46 blendshapes" in lines[0] and len(lines) < 40
    assert "MB uncompressed" in lines[0] and "captures, face builtin, facewright 0.1.0" in text and "sadness" in text
    smile = next(line for line in lines if line.startswith("│ smile"))
    assert [cell.strip() for cell in smile.split("│")[2:-1]] == ["24", "0.23", "1.50", "0.31", "detector"]
    assert "sidecar" in next(line for line in lines if line.startswith("│ grin"))
    notes = [line for line in lines if line.startswith("Note: ")]
    assert notes == [
        "Note: anger is left out: anger must show a face.",
        "Note: smile, grin: Frames differ by 1.5 to 2.5 mm: the expression was not held.",
    ]
    assert text.count("was not held") == 1 and "raw_noise_mm" not in text and "numpy" not in text
    assert _json(invoke, "show", faces, "anna")["notes"] == [note.removeprefix("Note: ") for note in notes]
    plain = invoke("warehouse", "show", faces, "bert").stdout  # made by something else
    assert "digest" in plain and "neutral, smile, grin" in plain and "Note: " not in plain and "test" in plain


def test_ls_says_why_nobody_fits(invoke, faces):
    assert _json(invoke, "ls", faces)["hints"] == []
    result = invoke("warehouse", "ls", faces, "--where", "sex=female", "-w", "age>=31")
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [
        "0 of 2 people fit sex = female: sex is f, m.",
        "1 of 2 people fit age >= 31: age is 30 to 40.",
    ]
    found = _json(invoke, "ls", faces, "--where", "sex=female")
    assert found["subjects"] == [] and found["hints"] == ["0 of 2 people fit sex = female: sex is f, m."]


def test_sizes_say_what_they_are_and_one_is_one_person(invoke, faces):
    text = invoke("warehouse", "ls", faces, "-w", "sex=f").stdout
    assert "1 person" in text and "in memory" in text
    listed = sum(s["uncompressed_megabytes"] for s in _json(invoke, "ls", faces)["subjects"])
    assert _json(invoke, "show", faces)["uncompressed_megabytes"] == pytest.approx(listed, abs=0.01)
    stored = _json(invoke, "check", faces)["stored_megabytes"]
    assert 0 < stored < listed
    assert f"{stored:.1f} MB stored, compressed" in invoke("warehouse", "check", faces).stdout


def test_label_and_check(invoke, faces):
    found = _json(invoke, "label", faces, "anna", "glasses=true", "hair colour=brown", "age=")
    assert found["attributes"] == {"sex": "f", "glasses": True, "hair colour": "brown"}
    assert "glasses" not in invoke("warehouse", "label", faces, "anna", "age=30", "glasses=", "hair colour=").stdout
    report = _json(invoke, "check", faces)
    assert report["findings"] == [] and report["subjects"] == 2
    assert "all as they were written" in invoke("warehouse", "check", faces, "--repair").stdout


def test_check_of_a_damaged_store(invoke, faces, tmp_path):
    import shutil

    copy = tmp_path / "copy.zarr"
    shutil.copytree(faces, copy)
    path = copy / Warehouse.open(copy).entry("bert").folder / "meshes" / "c.0.0.0"
    path.write_bytes(path.read_bytes()[:-50])
    result = invoke("warehouse", "check", copy, "--json")
    assert result.exit_code == 2 and json.loads(result.stdout)["damaged_subjects"] == ["bert"]
    assert "damaged" in invoke("warehouse", "check", copy).stdout
    assert invoke("warehouse", "check", copy, "--remove-damaged").exit_code == 0
    assert invoke("warehouse", "check", copy).exit_code == 0
    assert [s["name"] for s in _json(invoke, "ls", copy)["subjects"]] == ["anna"]


def test_export_import_rm(invoke, faces, tmp_path):
    assert len(_json(invoke, "export", faces, tmp_path / "out", "--where", "sex=f")["folders"]) == 1
    new = tmp_path / "new.zarr"
    assert _json(invoke, "import", tmp_path / "out", new)["imported"] == ["anna"]
    assert "0 failed" in invoke("warehouse", "import", tmp_path / "out", new, "--overwrite").stdout
    assert Warehouse.open(new).read_subject("anna").meshes.tobytes() == (
        Warehouse.open(faces).read_subject("anna").meshes.tobytes()
    )
    args = ("export", faces, tmp_path / "fw", "--layout", "facewarehouse", "-s", "bert", "--names", "facewarehouse46")
    _json(invoke, *args)
    assert (tmp_path / "fw" / "Tester_1" / "TrainingPose" / "pose_17.png").is_file()
    assert _json(invoke, "import", tmp_path / "fw", tmp_path / "fw.zarr")["layout"] == "facewarehouse"
    assert _json(invoke, "rm", new, "anna")["removed"] == ["anna"]
    assert _json(invoke, "ls", new)["subjects"] == []


def test_an_import_of_nobody_fails(invoke, faces, tmp_path):
    (tmp_path / "people" / "zoe").mkdir(parents=True)
    (tmp_path / "people" / "zoe" / "neutral.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    result = invoke("warehouse", "import", tmp_path / "people", faces)
    assert result.exit_code == 2 and "zoe" in result.stdout
    assert invoke("warehouse", "rm", faces, "zoe").exit_code == 0  # the recorded failure


def test_refusals(refused, faces, tmp_path):
    assert "got nothing there" in refused("warehouse", "ls", tmp_path / "absent")
    assert "no subject 'nobody'" in refused("warehouse", "show", faces, "nobody")
    assert "needs a subject" in refused("warehouse", "show", faces, "-o", tmp_path / "x.png")
    assert "does not exist" in refused("warehouse", "show", faces, "anna", "-o", tmp_path / "absent" / "x.png")
    assert "some subject has" in refused("warehouse", "ls", faces, "--where", "weight>3")
    assert "such as age>30" in refused("warehouse", "ls", faces, "--where", "age")
    assert "key=value" in refused("warehouse", "label", faces, "anna", "age")
    assert "no subject 'nobody'" in refused("warehouse", "label", faces, "nobody", "age=3")
    assert "no subject 'nobody'" in refused("warehouse", "rm", faces, "nobody")
    assert "nobody to export" in refused("warehouse", "export", faces, tmp_path / "o", "--where", "age>90")
    assert "no subject 'x'" in refused("warehouse", "export", faces, tmp_path / "o", "-s", "x")
    assert "layout must be one of" in refused("warehouse", "export", faces, tmp_path / "o", "--layout", "zip")
    assert "mesh_format must be one of" in refused("warehouse", "export", faces, tmp_path / "o", "--format", "stl")
    assert "absent" in refused("warehouse", "import", tmp_path / "absent", faces)
    assert not (tmp_path / "o").exists()
