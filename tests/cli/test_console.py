"""Progress on a terminal: stages get lines, steps of one whole share one; JSON has plain values only."""

import io
import json
import sys
from pathlib import Path

import numpy as np

from facewright.cli.console import finish, plain, progress_bar, table


class _Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_lines(monkeypatch):
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar() as report:
        report("simulating", 1, 2)
        report("simulating", 2, 2)
        report("reading", 0, 3)
        report("fitting", 1, 3)
        report("writing", 3, 3)
    last = [line for line in terminal.getvalue().splitlines() if "3/3" in line or "2/2" in line][-2:]
    assert "simulating" in last[0] and "2/2" in last[0]
    assert "writing" in last[1] and "3/3" in last[1]
    assert "fitting" not in last[0] + last[1] and "reading" not in last[0] + last[1]


def test_no_progress_for_programs(monkeypatch):
    monkeypatch.setattr(sys, "stderr", _Terminal())
    with progress_bar(as_json=True) as report:
        assert report is None
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress_bar() as report:
        assert report is None


def test_plain_values(capsys):
    value = {"a": np.float32(0.5), "b": np.arange(2), "c": Path("x"), 4: (float("nan"), None, True), "d": np.inf}
    expected = {"a": 0.5, "b": [0, 1], "c": "x", "4": [None, None, True], "d": None}
    assert plain(value) == expected
    finish(value, True, lambda: None)
    assert json.loads(capsys.readouterr().out) == expected


def test_tables_show_brackets_as_they_are(capsys):
    table("Title", ["name", "value"], [["[bold]", "1.5"], ["b", "-2"]])
    out = capsys.readouterr().out
    assert "[bold]" in out and "Title" in out
