"""Builds of real recordings that are killed: the process that stands in elsewhere computes nothing that may differ."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from facewright.errors import FileFormatError, StoreError
from facewright.numeric.threads import thread_environment
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr", reason="needs the warehouse extra")
pytest.importorskip("distributed", reason="needs the warehouse extra")

RUN = "from facewright.cli.main import run; run()"


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """Three simulated people who act three expressions, with landmarks refined by hand."""
    from facewright.apps.simulate_captures import SimulateCapturesRequest, simulate_captures

    root = tmp_path_factory.mktemp("captures")
    acted = ("neutral", "smile", "mouth_stretch")
    simulate_captures(SimulateCapturesRequest(root, 3, "builtin", 3, expressions=acted, seed=11, landmarks="refined"))
    return root


def build(captures, out, threads, *options):
    """Start a build in a process of its own."""
    words = [sys.executable, "-c", RUN, "build", str(captures), "-o", str(out), "--least-expressions", "2", *options]
    environment = {**os.environ, **thread_environment(threads)}
    return subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def digests(url):
    try:
        warehouse = Warehouse.open(url)
    except (StoreError, FileFormatError):
        return {}
    return {name: warehouse.digest(name) for name in warehouse.subject_names()}


@pytest.mark.slow
def test_killed_builds_end_with_the_same_contents_with_any_number_of_threads(captures, tmp_path, rng):
    whole = build(captures, tmp_path / "whole.zarr", 1)
    begun = time.perf_counter()
    assert whole.wait() == 0, whole.stderr.read()
    seconds = time.perf_counter() - begun
    expected = digests(tmp_path / "whole.zarr")
    assert len(expected) == 3
    killed = 0
    for threads in (2, 1, 2):
        process = build(captures, tmp_path / "killed.zarr", threads)
        try:
            process.wait(rng.uniform(0.3, 0.9) * seconds)
        except subprocess.TimeoutExpired:
            killed += 1
        process.kill()
        process.wait()
        assert digests(tmp_path / "killed.zarr").items() <= expected.items()
    assert killed >= 1
    # the rest elsewhere: the captures have moved, and two workers share the cores
    moved = shutil.copytree(captures, tmp_path / "moved")
    rest = build(Path(moved), tmp_path / "killed.zarr", 2, "--workers", "2")
    assert rest.wait() == 0, rest.stderr.read()
    assert digests(tmp_path / "killed.zarr") == expected
