"""How every command speaks: one result on stdout, progress and errors on stderr, exit codes."""

from __future__ import annotations

import itertools
import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from facewright.errors import FacewrightError

EXIT_USER = 2
EXIT_BUG = 1
EXIT_INCOMPLETE = 3  # the command did its work, but not for everything it was given
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141

Progress = Callable[[str, int, int], None]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")]


class FacewrightGroup(typer.core.TyperGroup):
    """The root command: turns errors into one sentence and an exit code."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Parse and run; a mistake on the command line becomes one sentence as well."""
        words = list(sys.argv[1:] if args is None else args)
        _state["json"] = _wants_json(words)
        try:
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except Exception as error:
            if not hasattr(error, "format_message"):
                raise
            context = getattr(error, "ctx", None)
            hint = f" (see: {context.command_path} --help)" if context is not None else ""
            code = _explain("UsageError", _usage_sentence(error, words).rstrip(".") + hint + ".", EXIT_USER)
        if not standalone_mode:
            return code
        sys.exit(code if isinstance(code, int) else 0)

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command; no traceback reaches a user for what a user did."""
        try:
            return super().invoke(ctx)
        except FacewrightError as error:
            code = _explain(type(error).__name__, str(error), EXIT_USER)
        except KeyboardInterrupt:
            code = _explain("Interrupted", "Interrupted; nothing half-written was left behind.", EXIT_INTERRUPTED)
        except BrokenPipeError:  # the reader of our output has gone, such as `| head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            code = EXIT_BROKEN_PIPE
        except MemoryError:
            code = _explain("MemoryError", "Not enough memory: use fewer people or smaller input.", EXIT_USER)
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            code = _explain(type(error).__name__, f"{where}{error.strerror or error}.", EXIT_USER)
        except Exception as error:
            if (
                os.environ.get("FACEWRIGHT_DEBUG")
                or isinstance(error, (typer.Exit, typer.Abort))
                or hasattr(error, "ctx")
            ):
                raise
            sentence = (
                f"This is a mistake in facewright ({type(error).__name__}: {error}); "
                "run again with FACEWRIGHT_DEBUG=1 for the traceback to report."
            )
            code = _explain(type(error).__name__, sentence, EXIT_BUG)
        raise typer.Exit(code)


_state = {"json": False}


# What the libraries below say of a number (pydantic's wording, click's wording) -> what an option must be.
_NUMBER_RULES = (
    (r"range (\S+?)<=x<=(\S+?)\.?$", r"in [\1, \2]"),
    (r"greater than or equal to (\S+)|range x>=(\S+?)\.?$", r"at least \1\2"),
    (r"less than or equal to (\S+)|range x<=(\S+?)\.?$", r"at most \1\2"),
    (r"valid int", "a whole number"),
    (r"valid (?:number|float)", "a number"),
)


def _usage_sentence(error: Any, words: list[str]) -> str:
    """Say what an option must be and what it got, in our words where the message is about a number or a choice."""
    message = str(error.format_message()).replace("Value error, ", "")
    choice = re.search(r"Invalid value for (.+?): ('.*') is not one of ('.*')\.?$", message)
    if choice:
        names = re.findall(r"'([^']*)'", choice[1])
        return f"{names[0] if names else choice[1]} must be one of {choice[3].replace(chr(39), '')}, got {choice[2]}"
    for flag in getattr(getattr(error, "param", None), "opts", ()):
        given = [word.partition("=")[2] for word in words if word.startswith(f"{flag}=")]
        given += [after for word, after in itertools.pairwise(words) if word == flag]
        for pattern, rule in _NUMBER_RULES:
            found = re.search(pattern, message)
            if found and given:
                return f"{flag} must be {found.expand(rule)}, got {given[-1]}"
    return message


def _wants_json(args: list[str]) -> bool:
    """Tell whether stdout is to hold JSON; `evaluate --json FILE` writes a file, unless that is ``-``."""
    if "--json" not in args:
        return False
    return args[0] != "evaluate" or args[args.index("--json") + 1 :][:1] == ["-"]


def _explain(kind: str, sentence: str, code: int) -> int:
    """Say what went wrong: one sentence on stderr, with --json also an object on stdout; returns `code`."""
    sentence = " ".join(sentence.split())
    with suppress(OSError):
        sys.stderr.write(f"facewright: {sentence}\n")
        if _state["json"]:
            sys.stdout.write(json.dumps({"error": {"type": kind, "message": sentence}, "exit_code": code}) + "\n")
            sys.stdout.flush()
    return code


def finish(payload: Mapping[str, Any], as_json: bool, lines: Callable[[], None]) -> None:
    """Print a command's result: the payload as one JSON object, or `lines` for people."""
    if as_json:
        sys.stdout.write(json.dumps(plain(payload), allow_nan=False) + "\n")
    else:
        lines()
    sys.stdout.flush()


def plain(value: Any) -> Any:
    """Turn paths, NumPy numbers and arrays, and non-finite floats (null) into what JSON has."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def say(text: str) -> None:
    """Print one line for people."""
    from rich.console import Console

    Console(soft_wrap=True, highlight=False).print(text, markup=False)


def say_aside(text: str) -> None:
    """Print one line for people on stderr, where the result is not: how the work goes."""
    from rich.console import Console

    Console(stderr=True, soft_wrap=True, highlight=False).print(text, markup=False)


def table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """Print a table for people; the first column is text, the others align right where they are numbers."""
    from rich.console import Console
    from rich.table import Table

    sheet = Table(title=title, title_justify="left", header_style="bold")
    for k, column in enumerate(columns):
        numeric = k > 0 and all(_is_number(row[k]) for row in rows)
        sheet.add_column(column, justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        sheet.add_row(*row)
    width = None if sys.stdout.isatty() else 120
    Console(width=width, highlight=False).print(sheet, markup=False)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "") or "0")
    except ValueError:
        return False
    return True


@contextmanager
def progress_bar(as_json: bool = False) -> Iterator[Progress | None]:
    """Draw progress on stderr while the body runs; nothing where nobody watches (no terminal, or --json)."""
    if as_json or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[str, Any] = {}
        last: Any = None

        def report(stage: str, done: int, total: int) -> None:
            nonlocal last
            if stage not in tasks:
                # Steps of one whole ("fitting" 2 of 6, "writing" 3 of 6) share a line; other stages get their own.
                same = last is not None and 0 < done <= total == bar.tasks[last].total
                same = same and bar.tasks[last].completed <= done and not bar.tasks[last].finished
                last = last if same else bar.add_task(stage, total=total)
                tasks[stage] = last
            bar.update(tasks[stage], description=stage, completed=done, total=total)

        yield report
