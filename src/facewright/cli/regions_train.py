"""facewright regions train: a model of each region of a face."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, say_aside
from facewright.cli.wording import counted
from facewright.errors import ValueRangeError

if TYPE_CHECKING:
    from facewright.apps.train_regions import TrainResult


def train(
    data: Annotated[list[Path], typer.Argument(help="Performers' data (facewright mocap import), of one mesh.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The model to write.")] = Path("face.fwrm"),
    regions: Annotated[
        Path | None, typer.Option("--regions", help="Regions (facewright regions segment); else found from the data.")
    ] = None,
    components: Annotated[
        str, typer.Option("--components", help="PCA components of each region, or the share of motion to keep: 0.99.")
    ] = "15",
    holistic: Annotated[bool, typer.Option("--holistic", help="One region of the whole face.")] = False,
    blendshapes: Annotated[
        bool, typer.Option("--blendshapes", help="The template's blendshapes in each region, 0 to 1, instead of PCA.")
    ] = False,
    centred: Annotated[
        bool, typer.Option("--centred", help="PCA about the mean motion; by default about the neutral.")
    ] = False,
    clips: Annotated[
        list[str] | None, typer.Option("--clip", help="Only this clip; may be given several times.")
    ] = None,
    left_out: Annotated[
        list[str] | None,
        typer.Option("--leave-out", help="A clip to measure with, not to train with; may be given several times."),
    ] = None,
    rate: Annotated[float | None, typer.Option("--fps", help="Frames a second that recordings are thinned to.")] = None,
    neutral: Annotated[
        str | None, typer.Option("--neutral", help="Performer whose neutral the model poses; the first by default.")
    ] = None,
    beta: Annotated[float, typer.Option("--beta", help="Weight of the boundaries in what is measured.")] = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Learn a linear model of each region of a face; boundaries are shared, and agree as far as beta asks.

    \b
    Examples:
      facewright regions train m1.fwms --regions regions.json -o face.fwrm
      facewright regions train m1.fwms f1.fwms --components 0.98 --leave-out pride_05
      facewright regions train m1.fwms --holistic -o holistic.fwrm
      facewright regions train m1.fwms --blendshapes -o shapes.fwrm
    """
    from facewright.apps.train_regions import TrainOptions, TrainRequest, train_from_files

    options = TrainOptions(
        components=_components(components),
        holistic=holistic,
        basis="blendshapes" if blendshapes else "pca",
        centred=centred,
        frames_per_second=rate,
        clips=clips or (),
        left_out=left_out or (),
        neutral=neutral,
        beta=beta,
    )
    with progress_bar(as_json) as progress:
        result = train_from_files(TrainRequest(data, out, regions, options), progress)
    for remark in result.remarks:
        say_aside(remark)
    model = result.model
    payload: dict[str, Any] = {
        "path": out,
        "n_vertices": model.n_vertices,
        "n_frames": result.n_frames,
        "components": {name: len(basis) for name, basis in zip(model.regions.names, model.bases, strict=True)},
        "train_rms_mm": result.train_rms_mm,
        "left_out_rms_mm": result.left_out_rms_mm,
        "remarks": result.remarks,
    }
    finish(payload, as_json, lambda: _show(result, out))


def _components(text: str) -> int | float:
    """Read a number of components, or a share of motion."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if number >= 1.0 and number == int(number):
        return int(number)
    if not 0.0 < number < 1.0:
        raise ValueRangeError(f"--components must be a positive whole number or a share in (0, 1), got {text}.")
    return number


def _show(result: TrainResult, out: Path) -> None:
    model = result.model
    say(
        f"{counted(len(model.bases), 'region')} with {model.n_coefficients} coefficients from "
        f"{counted(result.n_frames, 'frame')} of {model.n_vertices} vertices."
    )
    for title, errors in (("trained with", result.train_rms_mm), ("left out", result.left_out_rms_mm)):
        if errors:
            say(f"Reconstruction, {title}: " + ", ".join(f"{name} {rms:.2f} mm" for name, rms in errors.items()))
    whole = len(model.bases) == 1
    say(f"Wrote {out}; next: facewright pose " + (f"REGIONS.fwrm --holistic {out}" if whole else str(out)))
