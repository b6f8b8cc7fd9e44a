"""The command line: every verb helps, answers in JSON, and says in one sentence what is wrong."""

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from facewright import __version__
from facewright.cli.main import app

VERBS = [
    ["demo"],
    ["faces", "list"],
    ["faces", "install"],
    ["faces", "show"],
    ["mocap", "import"],
    ["model", "build"],
    ["pose"],
    ["regions", "segment"],
    ["regions", "train"],
    ["simulate", "performance"],
    ["model", "info"],
    ["model", "explore"],
    ["build"],
    ["fit"],
    ["fit-scan"],
    *([verb] for verb in ("edit", "transfer", "track", "retarget", "animate")),
    *(["simulate", verb] for verb in ("captures", "people")),
    ["export"],
    *(["capture", verb] for verb in ("show", "landmarks", "fuse")),
    *(["warehouse", verb] for verb in ("ls", "show", "check", "label", "rm", "export", "import")),
    ["evaluate"],
    ["info"],
]


def _invoke(*args):
    return CliRunner().invoke(app, [str(a) for a in args])


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
def test_every_verb_helps_with_examples(verb):
    result = _invoke(*verb, "--help")
    assert result.exit_code == 0
    assert "Examples:" in result.stdout and f"facewright {' '.join(verb)}" in result.stdout


def test_the_list_of_verbs_is_whole():
    from typer.models import CommandInfo

    found = [[c.name] for c in app.registered_commands]
    for group in app.registered_groups:
        found += [[group.name, c.name] for c in group.typer_instance.registered_commands]
    assert isinstance(app.registered_commands[0], CommandInfo)
    assert sorted(found) == sorted(VERBS)


def test_version_and_bare_call():
    assert _invoke("--version").stdout == f"facewright {__version__}\n"
    assert "Commands" in _invoke().output


@pytest.mark.parametrize("module", ["facewright", "facewright.cli.main"])
def test_the_module_is_the_command(module):
    done = subprocess.run([sys.executable, "-m", module, "edit", "--none"], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "No such option: --none" in done.stderr


def test_info_and_faces_list_as_json(monkeypatch, tmp_path):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    info = json.loads(_invoke("info", "--json").stdout)
    assert info["facewright"] == __version__ and info["machine"]["cores"] >= 1
    assert info["store"] == str(tmp_path / "faces")
    faces = {f["name"]: f for f in json.loads(_invoke("faces", "list", "--json").stdout)["faces"]}
    assert faces["builtin"]["installed"] is True and faces["ict"]["installed"] is False
    assert "ict" in _invoke("faces", "list").stdout and "numpy" in _invoke("info").stdout


def test_faces_show(tmp_path):
    result = _invoke("faces", "show", "builtin", "--json")
    assert json.loads(result.stdout)["blendshapes"] == 46
    assert "blendshapes" in _invoke("faces", "show").stdout


def test_model_info_and_explore(small_model, tmp_path):
    info = json.loads(_invoke("model", "info", small_model, "--json").stdout)
    assert info["training_people"] == 4 and len(info["shapes"]) == 47
    assert "provenance" in _invoke("model", "info", small_model).stdout
    result = _invoke("model", "explore", small_model, "--out", tmp_path / "m.png", "--modes", 1)
    assert result.exit_code == 0 and (tmp_path / "m.png").is_file()


@pytest.mark.parametrize("source", [[], ["--seed", "2"], ["--model"], ["--model", "--person", "1"]], ids=" ".join)
def test_export_from_every_source(small_model, tmp_path, source):
    source = [item for word in source for item in ((word, str(small_model)) if word == "--model" else (word,))]
    result = _invoke("export", tmp_path / "a.glb", *source, "--animate", "--names", "arkit52", "--json")
    assert result.exit_code == 0, result.output
    payload = json.loads(result.stdout)
    assert payload["paths"] == [str(tmp_path / "a.glb")] and len(payload["shapes"]) == 52
    assert payload["bytes"] == (tmp_path / "a.glb").stat().st_size
    assert payload["driven_shapes"] + len(payload["empty_shapes"]) == 52 and "tongueOut" in payload["empty_shapes"]
    assert "jawOpen" not in payload["empty_shapes"]


def test_export_says_which_shapes_move_nothing(tmp_path):
    assert "move nothing" not in _invoke("export", tmp_path / "a.glb").stdout
    told = _invoke("export", tmp_path / "a.glb", "--names", "arkit52").stdout
    assert "52 named shapes" in told and "move nothing" in told and "tongueOut" in told


def test_export_of_fitted_identity(small_model, tmp_path, refused):
    fit = tmp_path / "fit.json"
    model_id = json.loads(_invoke("model", "info", small_model, "--json").stdout)["provenance"]["model_id"]
    good = {"identity_weights": [1.0, 0.2, -0.3], "model": {"model_id": model_id}}
    fit.write_text(json.dumps(good))
    assert _invoke("export", tmp_path / "a.gltf", "--model", small_model, "--fit", fit).exit_code == 0
    for origin in ({}, None, {"model_id": "0123456789abcdef"}, {"model_id": 7}):  # size and mesh fit, the person not
        fit.write_text(json.dumps(good | {"model": origin}))
        sentence = refused("export", tmp_path / "b.glb", "--model", small_model, "--fit", fit)
        assert "fit.json" in sentence and "model_id" in sentence and "run facewright fit" in sentence
    fit.write_text(json.dumps({"identity_weights": [1.0, 0.2]}))
    assert "of 3 numbers" in refused("export", tmp_path / "b.glb", "--model", small_model, "--fit", fit)
    fit.write_text("[]")
    assert "identity_weights" in refused("export", tmp_path / "b.glb", "--model", small_model, "--fit", fit)
    assert not (tmp_path / "b.glb").exists()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["nonsense"], "No such command"),
        (["fit", "--nonsense"], "No such option"),
        (["model", "info"], "PATH"),
        (["model", "build", "-o", "m.fwbm", "--people", "one"], "--people must be a whole number, got one"),
        (["model", "build", "-o", "m.fwbm", "--people", "1"], "--people must be at least 2, got 1"),
        (["model", "build", "-o", "m.fwbm", "--people=0.5"], "--people must be a whole number, got 0.5"),
        (["fit", "none.jpg", "--model", "m.fwbm", "--texture", "9000"], "9000"),
        (["fit", "none.jpg", "--model", "m.fwbm", "--focal", "far"], "--focal must be a number, got far"),
        (["model", "build", "-o", "/proc/m.fwbm", "--people", "2", "--identities", "2"], "/proc/m.fwbm cannot be"),
        (["faces", "install", "ict", "--from", __file__], "or the compact .npz, got a file that is no whole zip"),
        (["model", "build", "-o", "m.fwbm", "--expressions", "48"], "n_expression must be in [1, 47], got 48"),
        (["model", "build", "-o", "none/m.fwbm"], "none does not exist"),
        (["model", "info", "none.fwbm"], "none.fwbm"),
        (["model", "explore", "none.fwbm"], "none.fwbm"),
        (["faces", "show", "nobody"], "got 'nobody'"),
        (["faces", "show", "none.npz"], "none.npz"),
        (["export", "a.fbx"], "a.fbx"),
        (["export", "a.glb", "--names", "maya"], "maya"),
        (["export", "a.glb", "--person", "1"], "model must be given"),
        (["export", "a.glb", "--model", "m", "--seed", "1"], "seed must be left out"),
        (["export", "a.glb", "--texture", "none.png"], "none.png"),
        (["evaluate", "nonsense"], "suite must be one of"),
        (["faces", "install", "nobody"], "got 'nobody'"),
        (["faces", "install", "ict", "--from", "none.zip"], "none.zip"),
        (["fit", "photo.jpg"], "--model"),
        (["fit", "none.jpg", "--model", "m.fwbm"], "none.jpg"),
        (["fit", "none.jpg", "--model", "m.fwbm", "--texture", "8"], "texture"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_mistakes_take_one_sentence(args, words, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    sentence = refused(*args)
    assert words.lower() in sentence.lower() and "Input should" not in sentence and ".facewright-" not in sentence
    assert not list(tmp_path.iterdir())


def test_mistakes_as_json():
    result = _invoke("faces", "show", "nobody", "--json")
    assert result.exit_code == 2
    error = json.loads(result.stdout)
    assert error["error"]["type"] == "MissingFaceError" and error["exit_code"] == 2
    assert error["error"]["message"] in result.stderr
    assert json.loads(_invoke("model", "info", "--json").stdout)["error"]["type"] == "UsageError"


def test_evaluate_writes_its_file(tmp_path, monkeypatch):
    from facewright.evaluation import suites

    calls = []

    def run_suite(suite, faces, seed, subjects=None, progress=None):
        calls.append((suite, faces, seed, subjects))
        return {"per_expression_ms": 9.5, "rms_mm": 0.25}

    monkeypatch.setattr(suites, "run_suite", run_suite)
    file = tmp_path / "transfer.json"
    result = _invoke("evaluate", "transfer", "--seed", 4, "--subjects", 2, "--json", file)
    assert result.exit_code == 0 and "<= 15" not in result.stdout and "yes" not in result.stdout
    assert "Targets are for the face ict" in result.stdout
    payload = json.loads(file.read_text())
    assert payload["suite"] == "transfer" and payload["metrics"]["rms_mm"] == 0.25 and payload["machine"]["numpy"]
    assert calls == [("transfer", "builtin", 4, 2)]
    for options in ([], ["--subjects", 3]):
        told = _invoke("evaluate", "transfer", "--faces", "ict", *options).stdout
        assert "<= 15" in told and "yes" in told and "Targets are" not in told
    assert json.loads(_invoke("evaluate", "transfer", "--json", "-").stdout)["metrics"]["per_expression_ms"] == 9.5
    assert "does not exist" in _invoke("evaluate", "transfer", "--json", tmp_path / "none" / "a.json").stderr


def test_a_mistake_of_our_own_is_owned_up(monkeypatch):
    from facewright.apps import describe

    def broken():
        raise RuntimeError("first\nsecond")

    monkeypatch.setattr(describe, "describe_installation", broken)
    result = _invoke("info")
    assert result.exit_code == 1 and "RuntimeError: first second" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    monkeypatch.setenv("FACEWRIGHT_DEBUG", "1")
    assert isinstance(_invoke("info").exception, RuntimeError)


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "Interrupted"),
        (MemoryError(), 2, "memory"),
        (PermissionError(13, "no", "f"), 2, "f: no"),
    ],
)
def test_interruption_memory_and_system_errors(monkeypatch, error, code, words):
    from facewright.apps import describe

    def broken():
        raise error

    monkeypatch.setattr(describe, "describe_installation", broken)
    result = _invoke("info")
    assert result.exit_code == code and words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_reader_that_goes_away_is_no_error():
    command = f"{sys.executable} -c 'from facewright.cli.main import run; run()' info --json | head -c 1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60)
    assert result.stdout == "{" and result.stderr == ""


def test_no_progress_where_nobody_watches():
    result = _invoke("faces", "list")
    assert result.stderr == ""


def test_info_names_what_is_missing(monkeypatch):
    from facewright.apps import describe

    there = describe.util.find_spec
    monkeypatch.setattr(describe.util, "find_spec", lambda name: None if name == "zarr" else there(name))
    text = _invoke("info").stdout
    assert "zarr" in text and "pip install 'facewright[warehouse]'" in text and "open3d" in text


def test_help_speaks_of_captures_databases_and_scans():
    text = " ".join(_invoke("--help").stdout.split())
    assert "captures" in text and "databases" in text and "scans" in text
    assert "depth camera" in " ".join(_invoke("demo", "--help").stdout.split())


def test_the_demo_says_its_stages_where_nobody_sees_bars(monkeypatch, tmp_path):
    from dataclasses import dataclass

    from facewright.apps import demo

    @dataclass
    class Result:
        seconds: float = 1.0

    def run(out, seed, progress):
        if progress is not None:
            for stage, done in (("writing captures", 0), ("writing captures", 1), ("drawing", 1)):
                progress(stage, done, 1)
        return Result()

    monkeypatch.setattr(demo, "run_demo", run)
    assert _invoke("demo", "--out", tmp_path / "d").stderr.splitlines() == ["writing captures ...", "drawing ..."]
    quiet = _invoke("demo", "--out", tmp_path / "d", "--json")
    assert quiet.stderr == "" and json.loads(quiet.stdout) == {"seconds": 1.0}
