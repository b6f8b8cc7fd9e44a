"""Write docs/cli.md from the commands themselves; --check only compares."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import get_args, get_type_hints

from typer import Typer
from typer.models import ArgumentInfo, OptionInfo

from facewright.cli.main import app

PAGE = Path(__file__).resolve().parent.parent / "docs" / "cli.md"
INTRODUCTION = """\
# The command line

Made by `tools/make_cli_docs.py` from the commands themselves; do not edit.

Results go to stdout, progress and errors to stderr. `--json` prints one JSON object on stdout and nothing else there.
Exit codes: 0 done; 3 done but for what could not be (subjects of a build, listed with their reasons); 2 your input
(one sentence says what was expected and what was found; with `--json` also
`{"error": {"type", "message"}, "exit_code"}`); 130 interrupted by Ctrl-C; 1 a mistake in facewright itself
(`FACEWRIGHT_DEBUG=1` shows its traceback). Files appear whole or not at all.
"""


def make_page() -> str:
    """Return the text of docs/cli.md."""
    return "\n".join([INTRODUCTION, *(_section(name, function) for name, function in commands())])


def commands(parent: Typer = app, prefix: str = "facewright") -> list[tuple[str, Callable[..., None]]]:
    """List every command's full name and function."""
    found = [(f"{prefix} {info.name}", info.callback) for info in parent.registered_commands]
    for group in parent.registered_groups:
        found += commands(group.typer_instance, f"{prefix} {group.name}")
    return found


def _section(name: str, function: Callable[..., None]) -> str:
    text, _, examples = inspect.getdoc(function).partition("\b\nExamples:\n")
    hints = get_type_hints(function, include_extras=True)
    arguments, options = [], []
    for key, parameter in inspect.signature(function).parameters.items():
        if not hasattr(hints[key], "__metadata__"):  # the command's own context
            continue
        kind, details = hints[key].__origin__, hints[key].__metadata__[0]
        if isinstance(details, ArgumentInfo):
            shown = key.upper() if parameter.default is parameter.empty else f"[{key.upper()}]"
            arguments.append((shown, _help(details, parameter.default)))
        else:
            # Inside Annotated the first name is passed where the default would stand.
            first = [details.default] if isinstance(details.default, str) else []
            flags = ", ".join([*first, *(details.param_decls or ())] or [f"--{key.replace('_', '-')}"])
            options.append((flags + _value(kind, details), _help(details, parameter.default)))
    usage = " ".join([name, *(shown for shown, _ in arguments), *(["[OPTIONS]"] if options else [])])
    lines = [f"## {name}", "", text.strip(), "", "```", usage, "```", "", "| | |", "| --- | --- |"]
    lines += [f"| `{shown.strip('[]')}` | {note} |" for shown, note in arguments]
    lines += [f"| `{shown}` | {note} |" for shown, note in options]
    if examples:
        lines += ["", "```sh", *(line.strip() for line in examples.strip().splitlines()), "```"]
    return "\n".join([*lines, ""])


def _value(kind: object, details: OptionInfo) -> str:
    if kind is bool:
        return ""
    parts = [part for part in (get_args(kind) or (kind,)) if part is not type(None)]
    names = [(get_args(part) or (part,))[0].__name__ for part in parts]  # of a list, what it holds
    return " " + (details.metavar or {"str": "TEXT", "Path": "PATH"}.get(names[0], names[0])).upper()


def _help(details: ArgumentInfo | OptionInfo, default: object) -> str:
    text = (details.help or "").replace("|", "\\|")
    if default is inspect.Parameter.empty:
        return f"{text} Required." if isinstance(details, OptionInfo) else text
    return text if default is None or isinstance(default, bool) else f"{text} Default: `{default}`."


def main() -> int:
    """Write the page, or compare with --check."""
    page = make_page()
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(page, encoding="utf-8")
        return 0
    if not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != page:
        print("docs/cli.md must match the commands: run `make docs` (or tools/make_cli_docs.py).")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
