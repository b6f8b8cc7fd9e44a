"""facewright transfer: carry a face component of one photo into another."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say
from facewright.cli.photo_options import ModelOption, TaskFileOption, say_remarks


class Component(StrEnum):
    """What can be carried over."""

    mouth = "mouth"
    eyes = "eyes"
    brows = "brows"
    nose = "nose"
    face = "face"


def transfer(
    target: Annotated[Path, typer.Argument(help="The photo to change.")],
    reference: Annotated[Path, typer.Argument(help="A photo of the same person with the wanted expression.")],
    component: Annotated[Component, typer.Option("--component", "-c", help="What to carry over.")] = Component.mouth,
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture to write.")] = Path("transferred.png"),
    model: ModelOption = None,
    face: Annotated[int, typer.Option("--face", help="Which face of the target; 0 is the largest.", min=0)] = 0,
    reference_face: Annotated[
        int, typer.Option("--reference-face", help="Which face of the reference; 0 is the largest.", min=0)
    ] = 0,
    landmarks: Annotated[
        Path | None, typer.Option("--landmarks", help="Points file of the target; its points win over detected ones.")
    ] = None,
    reference_landmarks: Annotated[
        Path | None, typer.Option("--reference-landmarks", help="Points file of the reference.")
    ] = None,
    task_file: TaskFileOption = None,
    as_json: JsonOption = False,
) -> None:
    """Carry the mouth, the eyes, the brows, the nose or the whole face of a photo into another of the same person.

    Chin and cheeks follow; what is far from the face stays as it is, to the last bit.

    \b
    Examples:
      facewright transfer serious.jpg smiling.jpg --component mouth -o smile.png
      facewright transfer blinking.jpg awake.jpg --component eyes -o awake.png
      facewright transfer group.jpg portrait.jpg --face 2 --component face -o better.jpg
    """
    from facewright.apps.transfer_component import TransferRequest, transfer_component

    request = TransferRequest(
        target=target,
        reference=reference,
        component=component.value,
        out=out,
        model=model,
        target_face=face,
        reference_face=reference_face,
        target_landmarks=landmarks,
        reference_landmarks=reference_landmarks,
        task_file=task_file,
    )
    with progress_bar(as_json) as progress:
        result = transfer_component(request, progress)
    say_remarks(result.remarks)
    payload = {
        "out": out,
        "component": component.value,
        "pixels_from_reference": int(result.mask.sum()),
        "pixels_touched": int(result.touched.sum()),
        "remarks": list(result.remarks),
    }
    share = 100 * float(result.mask.mean())
    finish(payload, as_json, lambda: say(f"{out}: {component.value} of {reference}, {share:.1f} % of the picture."))
