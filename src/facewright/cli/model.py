"""facewright model: build, describe and look at bilinear models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from facewright.cli.console import JsonOption, finish, progress_bar, say, say_aside, table
from facewright.cli.wording import counted
from facewright.errors import ValueRangeError

if TYPE_CHECKING:
    from facewright.apps.build_database_model import BuildDatabaseModelRequest
    from facewright.models.bilinear import BilinearModel

app = typer.Typer(no_args_is_help=True, help="Build and look at bilinear face models.", rich_markup_mode="rich")
ModelArgument = Annotated[Path, typer.Argument(help="A model file, as `facewright model build` writes it.")]


@app.command("build")
def build(
    context: typer.Context,
    database: Annotated[
        str | None,
        typer.Argument(help="Database of people, as `facewright build` makes it; simulated people if absent."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")] = Path("face.fwbm"),
    faces: Annotated[str, typer.Option("--faces", help="Face: builtin, ict, or the path of a .npz file.")] = "builtin",
    people: Annotated[int, typer.Option(help="Simulated people.", min=2)] = 150,
    identities: Annotated[int, typer.Option(help="Identity components kept.", min=1)] = 50,
    expressions: Annotated[int, typer.Option(help="Expression components kept; below 47, lids stay ajar.", min=1)] = 47,
    seed: Annotated[int, typer.Option(help="Seed of the simulated people.", min=0)] = 0,
    skin: Annotated[
        bool, typer.Option("--skin", help="Simulated people without eyes, teeth and mouth cavity.")
    ] = False,
    where: Annotated[
        list[str] | None, typer.Option(help='People of the database to use, such as "age > 30"; may be repeated.')
    ] = None,
    hold_out: Annotated[
        int, typer.Option(help="People of the database left out, on whom the model is checked.", min=0)
    ] = 0,
    workers: Annotated[int, typer.Option(help="Worker processes that read the database; 0: this one.", min=0)] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Address of an existing Dask scheduler.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Build the bilinear model of a database's people, or of simulated ones, and check it on people it has not seen.

    \b
    Examples:
      facewright model build
      facewright model build -o small.fwbm --people 40 --identities 20 --expressions 15
      facewright model build -o ict.fwbm --faces ict --skin
      facewright model build faces.zarr -o faces.fwbm --hold-out 5
    """
    only_simulated, only_database = ("faces", "people", "seed", "skin"), ("where", "hold_out", "workers", "scheduler")
    _refuse_given(context, only_simulated if database is not None else only_database, database is not None)
    if database is None:
        _build_simulated(out, faces, people, identities, expressions, seed, skin, as_json)
    else:
        from facewright.apps.build_database_model import BuildDatabaseModelRequest

        request = BuildDatabaseModelRequest(
            database=database,
            out=out,
            n_identity=identities,
            n_expression=expressions,
            where=tuple(where or ()),
            n_held_out=hold_out,
            workers=workers,
            scheduler=scheduler,
        )
        _build_from_database(request, as_json)


def _refuse_given(context: typer.Context, names: tuple[str, ...], from_database: bool) -> None:
    """Refuse options of the other way to build a model."""
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            flag = f"--{name.replace('_', '-')}"
            which = "without a database, for simulated people" if from_database else "with a database"
            raise ValueRangeError(f"{flag} must be given {which}, got it {'with' if from_database else 'without'} one.")


def _build_from_database(request: BuildDatabaseModelRequest, as_json: bool) -> None:
    from facewright.apps.build_database_model import build_database_model

    with progress_bar(as_json) as progress:
        result = build_database_model(request, progress, on_dashboard=None if as_json else say_aside)
    model = result.model
    payload = {
        **_sizes(result.path, result.n_bytes, model),
        "people": len(model.identity_weights),
        "without_blendshapes": result.n_without_blendshapes,
        "decompose_seconds": round(result.decompose_seconds, 3),
        "unseen_rms_mm": result.unseen_rms_mm,
    }
    without = result.n_without_blendshapes
    left_out = f" ({counted(without, 'more has', 'more have')} no blendshapes)" if without else ""
    unseen = f"; {result.unseen_rms_mm:.2f} mm RMS on people held out" if result.unseen_rms_mm is not None else ""
    finish(
        payload,
        as_json,
        lambda: say(
            f"Wrote {result.path} ({result.n_bytes / 1e6:.1f} MB): "
            f"{counted(len(model.identity_weights), 'person', 'people')}{left_out}, "
            f"{model.n_vertices} vertices, {model.n_identity} x {model.n_expression} components; "
            f"{result.decompose_seconds:.1f} s{unseen}."
        ),
    )


def _build_simulated(
    out: Path, faces: str, people: int, identities: int, expressions: int, seed: int, skin: bool, as_json: bool
) -> None:
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
        **_sizes(result.path, result.n_bytes, model),
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


def _sizes(path: Path, n_bytes: int, model: BilinearModel) -> dict[str, Any]:
    return {
        "path": path,
        "bytes": n_bytes,
        "vertices": model.n_vertices,
        "identities": model.n_identity,
        "expressions": model.n_expression,
    }


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
