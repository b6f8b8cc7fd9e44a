"""Fixtures of the command line's tests: a small model of the built-in face, a small disk."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from facewright.cli.main import app

RUN = "from facewright.cli.main import run; run()"


@pytest.fixture(scope="session")
def small_model(tmp_path_factory):
    """A model file of the built-in face: 4 people, 3 x 6 components."""
    path = tmp_path_factory.mktemp("model") / "face.fwbm"
    args = ["model", "build", "-o", str(path), "--people", "4", "--identities", "3", "--expressions", "6", "--json"]
    result = CliRunner().invoke(app, args)
    assert result.exit_code == 0, result.output
    return path


@pytest.fixture
def invoke():
    """Run a command in this process."""
    return lambda *args: CliRunner().invoke(app, [str(a) for a in args])


@pytest.fixture
def refused(invoke):
    """Run a command that must be refused: one sentence on stderr, nothing on stdout, exit code 2; returns it."""

    def check(*args):
        result = invoke(*args)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        lines = result.stderr.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("facewright: ") and lines[0].endswith("."), result.stderr
        assert "mistake in facewright" not in lines[0]
        return lines[0]

    return check


@pytest.fixture
def command():
    """Return the argument list that runs a command in a process of its own."""
    return lambda *args: [sys.executable, "-c", RUN, *map(str, args)]


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a disk of 256 KB; skips where it cannot be made."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
        subprocess.run(mount, check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"needs root and tmpfs to make a small disk: {error}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=False, capture_output=True, timeout=20)
