"""facewright regions: divide a face into regions that move together, and learn a model of each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli import regions_train
from facewright.cli.console import JsonOption, finish, progress_bar, say, say_aside
from facewright.cli.wording import counted

if TYPE_CHECKING:
    from facewright.apps.segment_regions import SegmentResult

app = typer.Typer(help="Divide a face into regions that move together, and learn a model of each.")
app.command("train")(regions_train.train)


@app.command("segment")
def segment(
    data: Annotated[list[Path], typer.Argument(help="Performers' data (facewright mocap import), of one mesh.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The file of regions to write.")] = Path("regions.json"),
    picture: Annotated[Path | None, typer.Option("--picture", help="Also draw the regions.")] = None,
    clips: Annotated[
        list[str] | None, typer.Option("--clip", help="Only this clip; may be given several times.")
    ] = None,
    correlation_share: Annotated[
        float, typer.Option("--lambda", help="Weight of correlation against distance, 0 to 1 (eq. 12).")
    ] = 0.7,
    threshold: Annotated[float, typer.Option("--threshold", help="Correlations below it count nothing.")] = 0.7,
    radius: Annotated[float, typer.Option("--radius", help="How far nearness reaches, mm (r of eq. 11).")] = 10.0,
    rate: Annotated[float, typer.Option("--fps", help="Frames a second that recordings are thinned to.")] = 15.0,
    restarts: Annotated[int, typer.Option("--restarts", help="Runs of k-means for each number of regions.")] = 20,
    n_regions: Annotated[
        int | None, typer.Option("--regions", help="Exactly so many; by default as many as stay compact.")
    ] = None,
    max_regions: Annotated[int, typer.Option("--max-regions", help="Look no further.")] = 40,
    ragged: Annotated[
        float,
        typer.Option(
            "--ragged",
            help="Share of a region's vertices that may lie in none of its triangles and join a neighbour; 0 is the "
            "paper's letter.",
        ),
    ] = 0.2,
    symmetric: Annotated[bool, typer.Option("--symmetric", help="Treat left and right alike.")] = False,
    seed: Annotated[int, typer.Option("--seed", help="Of k-means.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Divide a face into regions of vertices that move alike and lie together.

    Boundaries are shared by the regions that meet there. The file is JSON: names and vertices may be edited.

    \b
    Examples:
      facewright regions segment m1.fwms -o regions.json --picture regions.png
      facewright regions segment m1.fwms f1.fwms --clip range_of_motion --regions 13
      facewright regions segment m1.fwms --lambda 0.4 --radius 15
    """
    from facewright.apps.segment_regions import SegmentOptions, SegmentRequest, segment_data

    options = SegmentOptions(
        correlation_share=correlation_share,
        threshold=threshold,
        radius_mm=radius,
        frames_per_second=rate,
        restarts=restarts,
        n_regions=n_regions,
        max_regions=max_regions,
        ragged_share=ragged,
        symmetric=symmetric,
        seed=seed,
    )
    with progress_bar(as_json) as progress:
        result = segment_data(SegmentRequest(data, out, picture, clips or (), options), progress)
    for remark in result.remarks:
        say_aside(remark)
    refused = result.segmentation.refused
    payload: dict[str, Any] = {
        "paths": result.paths,
        "n_regions": len(result.regions.members),
        "vertices": {name: len(ids) for name, ids in zip(result.regions.names, result.regions.members, strict=True)},
        "compact": result.segmentation.chosen.compact,
        "first_not_compact": None if refused is None else refused.n_clusters,
        "pieces": result.pieces.tolist(),
        "symmetry": result.symmetry,
        "shared_vertices": int((result.regions.count > 1).sum()),
        "n_frames": result.n_frames,
        "remarks": result.remarks,
    }
    finish(payload, as_json, lambda: _show(result))


def _show(result: SegmentResult) -> None:
    regions, refused = result.regions, result.segmentation.refused
    say(
        f"{len(regions.members)} regions from {result.n_frames} frames; {int((regions.count > 1).sum())} of "
        f"{regions.n_vertices} vertices are shared; symmetry {result.symmetry:.2f} (1 is perfect)."
    )
    if refused is not None:
        say(f"With {refused.n_clusters}, {counted(len(refused.loose), 'region')} would not be compact.")
    for path in result.paths:
        say(f"Wrote {path}")
