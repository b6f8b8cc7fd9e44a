"""facewright build on the command line: exit codes, JSON, full disks, Ctrl-C; with a stand-in for the process."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from facewright.apps.build import capture_warnings
from facewright.capture.captures import SubjectCapture, list_captures
from facewright.cli.build import duration
from facewright.faces.expressions import EXPRESSION_NAMES
from facewright.warehouse.build import BuildStep, SubjectOutcome
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")
pytest.importorskip("distributed")

WAREHOUSE_TESTS = str(Path(__file__).parents[1] / "warehouse")
sys.path.insert(0, WAREHOUSE_TESTS)
import fake_process  # noqa: E402
from build_fixtures import contents, read_everything, write_captures  # noqa: E402

LAUNCH = (
    f"import sys; sys.path.insert(0, {WAREHOUSE_TESTS!r}); import fake_process; "
    "import facewright.warehouse.process_subject as real; real.process_subject = fake_process.process_subject; "
    "from facewright.cli.main import run; run()"
)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr("facewright.warehouse.process_subject.process_subject", fake_process.process_subject)


@pytest.fixture
def captures(tmp_path):
    return write_captures(tmp_path / "captures", "anna", "ben")


def test_all_built_exits_with_0_and_again_too(invoke, captures, tmp_path):
    out = tmp_path / "faces.zarr"
    first = invoke("build", captures, "-o", out, "--json")
    assert first.exit_code == 0, first.output
    found = json.loads(first.stdout)
    assert found["built"] == ["anna", "ben"] and found["failed"] == {} and found["path"] == str(out)
    assert found["warnings"] == ["anna, ben (2 of 2 subjects) lack 19 of 20 expressions."] and found["notes"] == {}
    again = invoke("build", captures, "-o", out)
    assert again.exit_code == 0 and "0 built, 2 already there, 0 failed" in again.stdout
    assert "1 of 2: anna already there" in again.stderr


def test_failures_are_listed_and_the_exit_code_is_3(invoke, captures, tmp_path):
    write_captures(captures, "refused-1", "Anna")
    write_captures(captures, "nobody", expressions=("smile",))
    out = tmp_path / "faces.zarr"
    result = invoke("build", captures, "-o", out, "--json")
    assert result.exit_code == 3
    found = json.loads(result.stdout)
    assert found["built"] == ["ben"]
    assert set(found["failed"]) == {"refused-1", "Anna", "anna", "nobody"} == set(Warehouse.open(out).failures())
    assert found["failed"]["refused-1"] == {
        "kind": "DegenerateError",
        "reason": "the neutral of refused-1 must show a face, got a wall.",
    }
    assert "name of its own" in found["failed"]["anna"]["reason"]
    assert "neutral" in found["failed"]["nobody"]["reason"]
    spoken = invoke("build", captures, "-o", out)
    assert spoken.exit_code == 3
    assert "got a wall" in spoken.stdout and "0 built, 1 already there, 4 failed" in spoken.stdout
    left = invoke("build", captures, "-o", out, "--skip-failed", "--json")
    assert left.exit_code == 0 and json.loads(left.stdout)["already_there"] == ["ben"]
    only = invoke("build", captures, "-o", out, "--only", "refused-1", "--json")
    assert only.exit_code == 3 and list(json.loads(only.stdout)["failed"]) == ["refused-1"]


def test_notes_of_built_subjects_are_told_with_paths_as_the_user_gave_them(invoke, captures, tmp_path, monkeypatch):
    write_captures(captures, "noted-1", "refused-1")
    monkeypatch.chdir(tmp_path)
    result = invoke("build", "captures", "-o", "faces.zarr")
    assert result.exit_code == 3
    lines = result.stderr.splitlines()
    assert lines[0] == "anna, ben, noted-1, refused-1 (4 of 4 subjects) lack 19 of 20 expressions."  # before the work
    at = next(k for k, line in enumerate(lines) if "noted-1 built" in line)
    assert lines[at + 1] == "  noted-1: grin is left out: captures/noted-1/grin/depth/0.1.png must be a whole picture."
    assert lines[at + 2].startswith("  noted-1: neutral, smile: Depths of the recording look like metres")
    assert str(tmp_path) not in result.stderr and "3 built (1 with notes)" in result.stdout
    found = json.loads(invoke("build", captures, "-o", "other.zarr", "--json").stdout)
    assert list(found["notes"]) == ["noted-1"] and len(found["notes"]["noted-1"]) == 3
    assert f"{captures}/noted-1/grin" in found["notes"]["noted-1"][0]


def test_a_terminal_sees_notes_too(monkeypatch):
    from facewright.cli import build as command

    monkeypatch.setattr(command.sys, "stderr", _Terminal())
    with command._following(False) as (_, on_step, tell):
        tell("first")
        outcome = SubjectOutcome(
            "noted-1", "built", seconds=2.0, notes=("smile is left out: dark.", "neutral: one frame.")
        )
        on_step(BuildStep(outcome, 1, 2, 0, 3.0))
    text = command.sys.stderr.getvalue()
    assert "first" in text and "noted-1: smile is left out: dark." in text and "noted-1: neutral: one frame." in text


def test_a_log_tells_now_and_then_where_a_subject_is(capsys):
    from facewright.cli.build import _at_times

    often, seldom = _at_times(0.0), _at_times(1000.0)
    often("smile", 3, 20)
    seldom("grin", 4, 20)
    assert capsys.readouterr().err == "  smile, 3 of 20\n"


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def captured(name, *missing, problems=(), warnings=()):
    """A capture that lacks some expressions, with the sentence that `list_captures` says of it."""
    path = Path("/data/captures") / name
    recordings = {e: path / e for e in EXPRESSION_NAMES if e not in missing}
    lacks = (f"{path} lacks {len(missing)} of 20 expressions.",) if missing else ()
    return SubjectCapture(name, path, {}, recordings, problems, (*lacks, *warnings))


def test_missing_expressions_of_many_subjects_are_one_line():
    many = [captured(f"p-{k:03d}", *EXPRESSION_NAMES[1 : 2 + k % 4]) for k in range(150)]
    (line,) = capture_warnings(many)
    assert line == "p-000, p-001, p-002, p-003, p-004 and 145 more (150 of 150 subjects) lack 1 to 4 of 20 expressions."
    assert capture_warnings([captured("anna"), captured("ben", "grin", "smile")]) == (
        "ben lacks 2 of 20 expressions: smile, grin.",
    )
    assert capture_warnings([captured("anna"), captured("ben", "grin", problems=("ben is twice.",))]) == ()


def test_other_warnings_of_captures_are_told_and_then_counted():
    ignored = [captured("anna", warnings=[f"/data/captures/anna/{k} is no recording." for k in range(8)])]
    lines = capture_warnings(ignored)
    assert len(lines) == 6 and lines[0].endswith("anna/0 is no recording.") and lines[-1].startswith("3 more")


def test_what_list_captures_says_of_missing_expressions_is_not_told_twice(captures):
    assert len(capture_warnings(list_captures(captures))) == 1


def test_mistakes_end_in_one_sentence(refused, invoke, captures, tmp_path):
    out = tmp_path / "faces.zarr"
    assert "must be a folder of captures" in refused("build", tmp_path / "none", "-o", out)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "one folder for each subject" in refused("build", empty, "-o", out)
    assert "one subject's recordings: give" in refused("build", captures / "anna", "-o", out)
    assert "only must name subjects" in refused("build", captures, "-o", out, "--only", "zoe")
    assert "workers must be" in refused("build", captures, "-o", out, "--workers", 2, "--scheduler", "tcp://h:1")
    assert "other processes reach" in refused("build", captures, "-o", "memory://x", "--workers", 1)
    assert "face must be" in refused("build", captures, "-o", out, "--faces", "nobody")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "letter.txt").write_text("dear")
    assert "letter.txt" in refused("build", captures, "-o", foreign)
    model = tmp_path / "faces.fwbm"
    model.write_bytes(b"model")
    told = refused("build", captures, "-o", model)
    assert told == f"facewright: {model} must be a database or a place for a new one, got a file."
    assert model.read_bytes() == b"model"
    assert invoke("build", captures, "--workers", -1).exit_code == 2
    assert not out.exists() or contents(out) == {}


def test_a_database_of_another_face_is_refused(refused, captures, tmp_path):
    from build_fixtures import tiny_topology

    Warehouse.create(tmp_path / "tiny.zarr", tiny_topology())
    assert "must be a database of" in refused("build", captures, "-o", tmp_path / "tiny.zarr")


def test_a_full_disk_is_one_sentence_and_the_store_stays_usable(captures, tmp_path):
    """On a disk with room for a few subjects: some are written, the build says why it stops, and goes on later."""
    disk = tmp_path / "disk"
    disk.mkdir()
    try:
        mount = ["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", str(disk)]
        subprocess.run(mount, check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"needs root and tmpfs to make a small disk: {error}")
    try:
        names = [f"person-{k}" for k in range(8)]
        write_captures(captures, *names)
        command = [sys.executable, "-c", LAUNCH, "build", str(captures), "-o", str(disk / "faces.zarr"), "--json"]
        result = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert result.returncode == 2, result.stderr
        lines = result.stderr.strip().splitlines()
        assert len(lines) == 1 and "no space left" in lines[0], lines
        assert json.loads(result.stdout)["error"]["type"] == "StoreError"
        there = contents(disk / "faces.zarr")
        assert 1 <= len(there) < 10 and set(read_everything(disk / "faces.zarr")) == set(there)
        subprocess.run(["mount", "-o", "remount,size=200m", str(disk)], check=True, capture_output=True, timeout=20)
        result = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert result.returncode == 0, result.stderr
        found = contents(disk / "faces.zarr")
        assert set(found) == {"anna", "ben", *names} and there.items() <= found.items()
    finally:
        subprocess.run(["umount", str(disk)], check=False, capture_output=True, timeout=20)


@pytest.mark.parametrize(
    ("stop", "workers"),
    [
        (signal.SIGINT, 0),
        pytest.param(signal.SIGTERM, 0, marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, 2, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 2, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_stopped_by_a_signal_exits_with_130_and_goes_on_later(captures, tmp_path, stop, workers):
    names = [f"person-{k}" for k in range(6)]
    write_captures(captures, *names)
    out = tmp_path / "faces.zarr"
    command = [sys.executable, "-c", LAUNCH, "build", str(captures), "-o", str(out), "--workers", str(workers)]
    environment = {**os.environ, "FAKE_PROCESS_SECONDS": "1.5"}
    process = subprocess.Popen(
        command,
        env=environment,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )
    deadline = time.time() + 60
    while time.time() < deadline and not (out.exists() and list(out.glob("subjects/*/zarr.json"))):
        time.sleep(0.05)
    if stop is signal.SIGINT:
        os.killpg(process.pid, stop)  # as a terminal does: to all processes
    else:
        process.send_signal(stop)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and output == ""
    last = errors.strip().splitlines()[-1]
    assert last == "facewright: Interrupted; nothing half-written was left behind."
    assert "Traceback" not in errors
    there = contents(out)
    assert 1 <= len(there) < 8 and Warehouse.open(out).failures() == {}
    result = subprocess.run([*command[:-1], "0", "--json"], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0
    assert set(contents(out)) == {"anna", "ben", *names} and there.items() <= contents(out).items()


def test_durations_are_read_at_a_glance():
    assert [duration(s) for s in (0.2, 99, 100, 5400, 7500)] == ["0 s", "99 s", "2 min", "90 min", "2 h 05 min"]


# --- models of databases -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    from facewright.faces import load_face
    from facewright.warehouse.generated import GeneratedSubjects

    face = load_face("builtin")
    store = Warehouse.create(tmp_path_factory.mktemp("store") / "faces.zarr", face)
    people = GeneratedSubjects(face, 6, seed=1)
    for number in range(6):
        store.write_subject(people.subject(number))
    return store.url


def test_a_model_of_a_database(invoke, database, tmp_path):
    from facewright.models.bilinear_store import load_bilinear

    out = tmp_path / "faces.fwbm"
    result = invoke("model", "build", database, "-o", out, "--hold-out", 1, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert (found["people"], found["identities"], found["expressions"]) == (5, 5, 47)
    assert 0.1 < found["unseen_rms_mm"] < 20
    model = load_bilinear(out)
    assert model.provenance["source"] == "database" and model.provenance["n_people"] == 5
    store = Warehouse.open(database)
    names = [name for name in store.subject_names() if name != "generated-00002"]  # the one held out
    truth = store.read_array(names[0], "blendshapes")
    found = model.blendshapes(model.identity_weights[0])
    np.testing.assert_allclose(found.neutral, truth[0], atol=0.05)  # mm; all components are kept
    assert model.expression_names == store.blendshape_names
    assert "6 people" in invoke("model", "build", database, "-o", out).stdout


def test_models_of_databases_refuse_what_does_not_fit(refused, database, tmp_path):
    out = tmp_path / "m.fwbm"
    assert "--people must be given without a database" in refused("model", "build", database, "-o", out, "--people", 9)
    assert "--hold-out must be given with a database" in refused("model", "build", "-o", out, "--hold-out", 1)
    assert "at least two people" in refused("model", "build", database, "-o", out, "--hold-out", 5)
    assert "at least two people" in refused("model", "build", database, "-o", out, "--where", "age > 200")
    assert "must be a facewright database" in refused("model", "build", tmp_path / "none.zarr", "-o", out)
    assert "does not exist" in refused("model", "build", database, "-o", tmp_path / "none" / "m.fwbm")
    assert not out.exists()
