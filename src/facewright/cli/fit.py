"""facewright fit: a photograph becomes a 3D face."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, table


def fit(
    photo: Annotated[Path, typer.Argument(help="The photograph.")],
    model: Annotated[Path, typer.Option("--model", "-m", help="Model file, see: facewright model build.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("fit"),
    landmarks: Annotated[
        Path | None,
        typer.Option(help="Points file (.pts, .ljson, .json); its points win over detected ones, point by point."),
    ] = None,
    detect: Annotated[
        bool, typer.Option("--detect/--no-detect", help="Run the landmark detector, or use the points file alone.")
    ] = True,
    task_file: Annotated[
        Path | None, typer.Option(help="MediaPipe face_landmarker.task file, for newer MediaPipe releases.")
    ] = None,
    face: Annotated[int, typer.Option(help="Which of several faces; 0 is the largest.", min=0)] = 0,
    perspective: Annotated[
        bool, typer.Option("--perspective/--weak-perspective", help="Refine under a pinhole camera, or do not.")
    ] = True,
    focal: Annotated[
        float | None, typer.Option(help="Focal length in pixels; from the photo's EXIF data, or guessed, if absent.")
    ] = None,
    texture: Annotated[int, typer.Option(help="Side of the texture in pixels.", min=16, max=8192)] = 1024,
    as_json: JsonOption = False,
) -> None:
    """Fit a face in a photograph: parameters (JSON), mesh (OBJ), rig with the photo as texture (GLB), overlay picture.

    \b
    Examples:
      facewright fit portrait.jpg --model face.fwbm
      facewright fit group.jpg --model face.fwbm --face 1 --out second
      facewright fit portrait.jpg --model face.fwbm --landmarks points.pts --no-detect
    """
    from facewright.apps.fit_photo import FitPhotoRequest, fit_photo

    request = FitPhotoRequest(
        photo=photo,
        model=model,
        out=out,
        landmarks=landmarks,
        detect=detect,
        task_file=task_file,
        face_index=face,
        perspective=perspective,
        focal_length=focal,
        texture_size=texture,
    )
    with progress_bar(as_json) as progress:
        result = fit_photo(request, progress)
    yaw, pitch, roll = result.fit.head_angles_degrees
    payload = {
        "paths": result.paths,
        "faces_found": result.n_faces,
        "reprojection_iod": result.fit.reprojection_iod,
        "fit_ms": result.fit_ms,
        "head_degrees": {"yaw": yaw, "pitch": pitch, "roll": roll},
    }

    def show() -> None:
        rows = [[key, str(path)] for key, path in result.paths.items()]
        table(f"{photo}, fitted", ["what", "file"], rows)
        others = f"; {result.n_faces} faces found, --face chooses" if result.n_faces > 1 else ""
        say(
            f"Points are off by {100 * result.fit.reprojection_iod:.1f} % of the distance between the eyes; "
            f"head turned by {yaw:.0f}, {pitch:.0f}, {roll:.0f} degrees (yaw, pitch, roll); "
            f"{result.fit_ms:.0f} ms{others}."
        )

    finish(payload, as_json, show)
