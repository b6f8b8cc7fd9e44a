"""``facewright capture fuse``: one recording becomes one smooth depth map, and on request a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, table
from facewright.cli.wording import counted

if TYPE_CHECKING:
    from facewright.apps.fuse_recording import FuseRecordingResult


def fuse(
    recording: Annotated[
        Path, typer.Argument(help="Folder (TUM style, or TrueDepth .ply frames), or .r3d, .bag, .mkv file.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")],
    mesh: Annotated[
        bool, typer.Option("--mesh", help="Fit a face to the fused depth as well; needs landmarks.")
    ] = False,
    face: Annotated[str, typer.Option("--faces", help="Template: builtin, ict, or a face of your own.")] = "builtin",
    frame: Annotated[
        str, typer.Option(help="Where the mesh is written: scan (on points.ply) or model (upright).")
    ] = "scan",
    turn: Annotated[
        int | None,
        typer.Option(help="Counter-clockwise quarter turns, for heads that lie on their side.", min=0, max=3),
    ] = None,
    engine: Annotated[str, typer.Option(help="Of the fusion: numba, or open3d.")] = "numba",
    detect: Annotated[
        bool, typer.Option("--detector/--no-detector", help="Find the face by its landmarks, or by the depth alone.")
    ] = True,
    task_file: Annotated[
        Path | None, typer.Option(help="MediaPipe face_landmarker.task file, for newer MediaPipe releases.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fuse one recording into a smooth depth map and tell how good it is; with --mesh fit a face to it.

    Writes depth.png (16 bit) with camera.json, color.png, points.ply, report.json and fusion.png; with --mesh also
    face.obj and fit.png, the distances in colour. Landmarks in a file beside the recording win over detected ones.

    \b
    Examples:
      facewright capture fuse captures/anna/smile --out fused
      facewright capture fuse truedepth_frames --out mannequin --mesh
      facewright capture fuse scan.r3d --out fused --mesh --faces ict --frame model
    """
    from facewright.apps.fuse_recording import FuseRecordingRequest, fuse_recording

    request = FuseRecordingRequest(
        recording=recording,
        out=out,
        quarter_turns=turn,
        engine=engine,
        mesh=mesh,
        face=face,
        frame=frame,
        detect=detect,
        task_file=task_file,
    )
    with progress_bar(as_json) as progress:
        result = fuse_recording(request, progress)

    def lines() -> None:
        table(f"Recording {recording}, fused", ["", "value"], _rows(result))
        for sentence in result.facts["warnings"]:
            say(f"Note: {sentence}")
        say(f"Wrote {', '.join(path.name for path in result.paths.values())} to {out}.")

    finish({**result.facts, "paths": result.paths}, as_json, lines)


def _rows(result: FuseRecordingResult) -> list[list[str]]:
    report, facts = result.fused.report, result.facts
    lost = f"; lost: {', '.join(map(str, report.lost))}" if report.lost else ""
    rows = [
        ["frames fused", f"{report.n_fused} of {report.n_frames}{lost}"],
        ["reference frame", str(facts["reference_frame"])],
        ["quarter turns", str(facts["quarter_turns"])],
        ["landmarks", _landmarks(facts["landmarks"])],
        ["head turns by up to", f"{report.turn_degrees:.1f} degrees"],
        ["noise of one frame", f"{report.raw_noise_mm:.2f} mm (RMS)"],
        ["frames off the fused surface", f"{report.consistency_mm:.2f} mm (median)"],
        ["drift of the tracking", f"{report.drift_mm:.2f} mm, {report.drift_degrees:.2f} degrees"],
        ["face covered", f"{100 * report.coverage:.0f} %"],
    ]
    if result.fit is not None:
        fit = result.fit.report
        rows += [
            ["mesh: matched", f"{100 * float(fit['matched_share']):.0f} % of what was seen"],
            ["mesh: off the fused surface", f"{float(fit['stage2_rms_mm']):.2f} mm (RMS)"],
            ["mesh: off the landmarks", f"{float(fit['landmark_rms_mm']):.1f} mm (RMS)"],
        ]
    return rows


def _landmarks(found: dict[str, Any]) -> str:
    return "none" if not found["found"] else f"{counted(found['found'], 'point')} ({found['from']})"
