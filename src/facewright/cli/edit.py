"""facewright edit: change attributes of the person in a photograph."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, table
from facewright.cli.photo_options import (
    FaceOption,
    FocalOption,
    LandmarksOption,
    ModelOption,
    TaskFileOption,
    say_remarks,
)
from facewright.errors import ValueRangeError

if TYPE_CHECKING:
    from facewright.apps.edit_photo import AttributeSummary, EditResult


def edit(
    photo: Annotated[Path | None, typer.Argument(help="The photograph; not needed with --list.")] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            "-s",
            metavar="NAME=VALUE",
            help="Attribute and its change in standard deviations of the population, -4 to 4; may be given several "
            "times.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture to write.")] = Path("edited.png"),
    sheet: Annotated[
        Path | None, typer.Option("--sheet", help="Write a sheet of every attribute at -2, -1, +1 and +2.")
    ] = None,
    list_them: Annotated[bool, typer.Option("--list", help="List the model's attributes, and stop.")] = False,
    regression: Annotated[
        bool,
        typer.Option(
            "--regression", help="Follow eq. 12 of FaceWarehouse as it stands, which misses what is asked for a little."
        ),
    ] = False,
    model: ModelOption = None,
    face: FaceOption = 0,
    landmarks: LandmarksOption = None,
    task_file: TaskFileOption = None,
    focal: FocalOption = None,
    as_json: JsonOption = False,
) -> None:
    """Change attributes of the person in a photograph: a longer face, a wider mouth, fuller cheeks.

    The attributes named change by as much as asked for; the others stay as far as people vary that way.

    \b
    Examples:
      facewright edit portrait.jpg --set "face length=+1.5" --set "mouth width=-1" -o longer.png
      facewright edit portrait.jpg --sheet sheet.png
      facewright edit --list
      facewright edit group.jpg --face 1 --set "nose width=-2" -o second.jpg --model people.fwbm
    """
    if list_them:
        _list(model, as_json)
        return
    from facewright.apps.edit_photo import EditRequest, edit_photo

    if photo is None:
        raise ValueRangeError("a photo must be given, got none (facewright edit PHOTO --set NAME=VALUE).")
    deviations = parse_changes(changes or [])
    if not deviations and sheet is None:
        raise ValueRangeError(
            "--set or --sheet must say what to do, got neither; facewright edit --list shows the attributes."
        )
    request = EditRequest(
        photo=photo,
        deviations=deviations,
        out=out if deviations else None,
        sheet=sheet,
        model=model,
        face_index=face,
        landmarks=landmarks,
        task_file=task_file,
        focal_length=focal,
        form="regression" if regression else "least change",
    )
    with progress_bar(as_json) as progress:
        result = edit_photo(request, progress)
    say_remarks(result.remarks)
    payload: dict[str, Any] = {"paths": result.paths, "remarks": result.remarks}
    if result.edit is not None:
        payload |= {
            "asked": deviations,
            "change_in_deviations": result.edit.change,
            "before_mm": result.edit.before,
            "after_mm": result.edit.after,
            "likelihood_distance": result.edit.likelihood_distance,
            "smallest_jacobian": result.smallest_jacobian,
        }
    finish(payload, as_json, lambda: _show(photo, result))


def parse_changes(texts: list[str]) -> dict[str, float]:
    """Read ``NAME=VALUE`` texts.

    Raises
    ------
    ValueRangeError
        If a text is not of that form, its value is no number, or a name is given twice.

    Examples
    --------
    >>> parse_changes(["face length=+1.5", "mouth width = -1"])
    {'face length': 1.5, 'mouth width': -1.0}
    """
    changes: dict[str, float] = {}
    for text in texts:
        name, sign, value = text.rpartition("=")
        name = name.strip()
        try:
            number: float | None = float(value)
        except ValueError:
            number = None
        if number is not None and not math.isfinite(number):
            raise ValueRangeError(f"--set must give a finite number of standard deviations, got {text!r}.")
        if not sign or not name or number is None:
            hint = f'; for a kind of people write "{name}: {value.strip()}=+1"' if sign and name and value else ""
            raise ValueRangeError(
                f'--set must be an attribute, =, and a number of standard deviations, such as "face length=+1.5", got '
                f"{text!r}{hint}."
            )
        if name in changes:
            raise ValueRangeError(f"attribute {name!r} must be given once, got it twice.")
        changes[name] = number
    return changes


def _list(model: Path | None, as_json: bool) -> None:
    from facewright.apps.edit_photo import list_attributes

    with progress_bar(as_json) as progress:
        attributes = list_attributes(model, progress)
    payload = {"attributes": [vars(attribute) for attribute in attributes]}

    def show() -> None:
        rows = [
            [a.name, a.meaning, f"{a.mean:.1f}", f"{a.standard_deviation:.1f}", f"{a.r_squared:.2f}", _also(a)]
            for a in attributes
        ]
        columns = ["attribute", "what it is", "mean", "sd", "R2", "with +1 also"]
        table(f"Attributes of {attributes[0].n_people} people, mm", columns, rows)

    finish(payload, as_json, show)


def _also(attribute: AttributeSummary) -> str:
    """Name the attributes that move along by a tenth or more, the most first."""
    moved = sorted(attribute.also.items(), key=lambda item: -abs(item[1]))
    return ", ".join(f"{name} {change:+.1f}" for name, change in moved[:2] if abs(change) >= 0.1)


def _show(photo: Path, result: EditResult) -> None:
    if result.edit is not None:
        change = result.edit.change
        rows = [
            [name, f"{result.edit.before[name]:.1f}", f"{result.edit.after[name]:.1f}", f"{change[name]:+.2f}"]
            for name in sorted(change, key=lambda name: -abs(change[name]))
            if abs(change[name]) >= 0.05
        ]
        table(f"{photo}, edited", ["attribute", "before, mm", "after, mm", "change, sd"], rows)
    for what, path in result.paths.items():
        say(f"{what}: {path}")
