"""``facewright fit-scan``: the template on a scan of a head."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, table


def fit_scan(
    mesh: Annotated[Path, typer.Argument(help="The scan: OBJ or PLY, of any unit and orientation.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("fit-scan"),
    face: Annotated[str, typer.Option("--faces", help="Template: builtin, ict, or a face of your own.")] = "builtin",
    landmarks: Annotated[
        Path | None,
        typer.Option(
            help="Points placed on the scan (.ljson, .json, .csv): 74, 68 or 5; else the detector finds them."
        ),
    ] = None,
    texture: Annotated[
        Path | None, typer.Option(help="Texture of the scan, where its material does not name it.")
    ] = None,
    unit: Annotated[
        str, typer.Option(help="Unit of the scan: mm, cm, m, in; auto decides by the face's size.")
    ] = "auto",
    frame: Annotated[
        str, typer.Option(help="Where the mesh is written: scan (on the scan, its unit) or model (upright, mm).")
    ] = "scan",
    region: Annotated[
        str, typer.Option(help="What is matched: face, or head for bald or capped heads with ears and neck.")
    ] = "face",
    texture_size: Annotated[int, typer.Option(help="Side of the texture in pixels.", min=16, max=8192)] = 1024,
    task_file: Annotated[
        Path | None, typer.Option(help="MediaPipe face_landmarker.task file, for newer MediaPipe releases.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a face to a scan: mesh (OBJ) on the scan, parameters (JSON), texture, picture of the distances.

    \b
    Examples:
      facewright fit-scan head.obj --out anna
      facewright fit-scan head.ply --faces ict --unit m --frame model
      facewright fit-scan head.obj --landmarks points.csv
    """
    from facewright.apps.fit_scan import FitScanRequest
    from facewright.apps.fit_scan import fit_scan as run

    request = FitScanRequest(
        mesh=mesh,
        out=out,
        face=face,
        landmarks=landmarks,
        texture=texture,
        unit=unit,
        frame=frame,
        region=region,
        texture_size=texture_size,
        task_file=task_file,
    )
    with progress_bar(as_json) as progress:
        result = run(request, progress)
    report, placement = result.fit.report, result.found.placement
    payload = {
        "paths": result.paths,
        "unit": placement.unit,
        "size": placement.size,
        "looks": result.found.looks,
        "mesh_frame": frame,
        "residuals": report,
    }

    def show() -> None:
        rows = [[key, str(path)] for key, path in result.paths.items()]
        table(f"{mesh}, fitted", ["what", "file"], rows)
        how = f"taken for {placement.unit}" if unit == "auto" else f"given in {placement.unit}"
        say(
            f"The scan is {how}; the face is {placement.size:.2f} times the mean face's size. The two are "
            f"{report['stage2_rms_mm']:.2f} mm apart (RMS) over the {100 * float(report['matched_share']):.0f} % of "
            f"the face where the scan was matched, {report['landmark_rms_mm']:.1f} mm at the landmarks."
        )

    finish(payload, as_json, show)
