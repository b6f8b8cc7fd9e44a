"""The docs check finds each kind of fault, and the docs have none."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("check_docs", TOOLS / "check_docs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_links(tool, tmp_path, monkeypatch):
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    (tmp_path / "a.md").write_text("# The head\n\n## Eye `lids`, closed\n")
    (tmp_path / "b.png").write_bytes(b"")
    page = tmp_path / "page.md"
    good = (
        '[a](a.md) [b](a.md#the-head) [c](a.md#eye-lids-closed) ![d](b.png) [e](https://example.org) <img src="b.png">'
    )
    assert tool.check_links(page, good + "\n```\n[x](none.md)\n```\n") == []
    bad = "[a](none.md) [b](a.md#foot) ![c](none.png) [d](../outside.md)"
    assert len(tool.check_links(page, bad)) == 4


def test_names(tool):
    assert (
        tool.check_names(
            "`facewright.io.obj.read_obj` `facewright.models.bilinear.BilinearModel.synthesise(w_id, w_exp)`"
        )
        == []
    )
    assert tool.check_names("`facewright.mesh.topology.Topology.faces`") == []  # a field of a dataclass
    faults = tool.check_names("`facewright.io.obj.read_object` `facewright.nonsense`")
    assert len(faults) == 2 and "read_object" in faults[0]


def test_commands(tool):
    verbs = {"fit": set(), "model": {"build", "info"}}
    good = (
        "`facewright fit photo.jpg`\n```sh\nfacewright model build -o m.fwbm\n```\nProse about facewright and people."
    )
    assert tool.check_commands(good, verbs) == []
    assert len(tool.check_commands("`facewright fitt a`, `facewright model bild`", verbs)) == 2


@pytest.mark.parametrize(
    "text", ["see /home/me/data", "in /opt/shared", "https://mirror.example.org/wheels", "--index" + "-url x"]
)
def test_what_is_of_one_machine(tool, text):
    assert len(tool.check_foreign(text)) >= 1


def test_what_is_of_everybody(tool):
    assert tool.check_foreign("https://github.com/x/y, /tmp/tour, ~/.local, `pip install .`, docs/opt/home") == []


def test_the_docs_hold():
    done = subprocess.run([sys.executable, TOOLS / "check_docs.py"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
