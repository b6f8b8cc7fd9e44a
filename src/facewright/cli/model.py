"""facewright model: build, describe and look at bilinear models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, table

app = typer.Typer(no_args_is_help=True, help="Build and look at bilinear face models.", rich_markup_mode="rich")
ModelArgument = Annotated[Path, typer.Argument(help="A model file, as `facewright model build` writes it.")]


@app.command("build")
def build(
    out: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")] = Path("face.fwbm"),
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    people: Annotated[int, typer.Option(help="Simulated people.", min=2)] = 150,
    identities: Annotated[int, typer.Option(help="Identity components kept.", min=1)] = 50,
    expressions: Annotated[int, typer.Option(help="Expression components kept; below 47, lids stay ajar.", min=1)] = 47,
    seed: Annotated[int, typer.Option(help="Seed of the simulated people.", min=0)] = 0,
    skin: Annotated[bool, typer.Option("--skin", help="Leave out eyes, teeth and mouth cavity.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Build the bilinear model of a face from simulated people, and check it on people it has not seen.

    \b
    Examples:
      facewright model build
      facewright model build -o small.fwbm --people 40 --identities 20 --expressions 15
      facewright model build -o ict.fwbm --faces ict --skin
    """
    from facewright.apps.build_model import BuildModelRequest, build_model

    request = BuildModelRequest(
        out=out,
        face=faces,
        n_people=people,
        n_identity=min(identities, people),
        n_expression=expressions,
        seed=seed,
        skin_only=skin,
    )
    with progress_bar(as_json) as progress:
        result = build_model(request, progress)
    model = result.model
    payload = {
        "path": result.path,
        "bytes": result.n_bytes,
        "vertices": model.n_vertices,
        "identities": model.n_identity,
        "expressions": model.n_expression,
        "simulate_seconds": round(result.simulate_seconds, 3),
        "decompose_seconds": round(result.decompose_seconds, 3),
        "unseen_rms_mm": result.unseen_rms_mm,
    }
    finish(
        payload,
        as_json,
        lambda: say(
            f"Wrote {result.path} ({result.n_bytes / 1e6:.1f} MB): {model.n_vertices} vertices, {model.n_identity} x "
            f"{model.n_expression} components; {result.simulate_seconds:.1f} s to simulate, "
            f"{result.decompose_seconds:.1f} s to decompose; {result.unseen_rms_mm:.2f} mm RMS on unseen people."
        ),
    )


@app.command("info")
def info(path: ModelArgument, as_json: JsonOption = False) -> None:
    """Describe a model file.

    \b
    Examples:
      facewright model info face.fwbm
      facewright model info face.fwbm --json
    """
    from facewright.models.bilinear_store import load_bilinear

    model = load_bilinear(path)
    payload = {
        "path": path,
        "bytes": path.stat().st_size,
        "topology": model.topology.name,
        "fingerprint": model.topology.fingerprint,
        "vertices": model.n_vertices,
        "identities": model.n_identity,
        "expressions": model.n_expression,
        "training_people": len(model.identity_weights),
        "shapes": list(model.expression_names),
        "provenance": dict(model.provenance),
    }
    rows = [[key.replace("_", " "), _short(value)] for key, value in payload.items()]
    finish(payload, as_json, lambda: table("Bilinear model", ["", "value"], rows))


@app.command("explore")
def explore(
    path: ModelArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture to write.")] = Path("model.png"),
    modes: Annotated[int, typer.Option(help="Modes drawn, one row each.", min=1, max=20)] = 4,
    side: Annotated[str, typer.Option(help="Which weights to vary: identity, expression or both.")] = "both",
    as_json: JsonOption = False,
) -> None:
    """Draw the leading modes: identity from -2 to +2 standard deviations, expression over its whole range.

    \b
    Examples:
      facewright model explore face.fwbm --out modes.png
      facewright model explore face.fwbm --side identity --modes 8
    """
    from facewright.apps.explore_model import ExploreRequest, explore_model
    from facewright.models.bilinear_store import load_bilinear

    request = ExploreRequest(model=load_bilinear(path), out=out, n_modes=modes, side=side)
    with progress_bar(as_json) as progress:
        explore_model(request, progress)
    finish({"picture": out}, as_json, lambda: say(f"Wrote {out}."))


def _short(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}: {item}" for key, item in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
