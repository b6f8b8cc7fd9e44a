"""The command ``facewright``: the verbs, and the entry that turns errors into exit codes."""

from __future__ import annotations

import signal
import sys
from typing import Annotated

import typer

from facewright import __version__
from facewright.cli import (
    animate,
    build,
    capture,
    demo,
    edit,
    evaluate,
    export,
    faces,
    fit,
    fit_scan,
    info,
    mocap,
    model,
    pose,
    regions,
    retarget,
    simulate,
    track,
    transfer,
    warehouse,
)
from facewright.cli.console import EXIT_INTERRUPTED, FacewrightGroup

app = typer.Typer(
    name="facewright",
    cls=FacewrightGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"facewright {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """3D faces that move: depth captures, scans and photos become databases, models and rigs.

    Start with: facewright demo.
    """


app.command("demo")(demo.demo)
app.add_typer(faces.app, name="faces")
app.add_typer(model.app, name="model")
app.command("build")(build.build)
app.command("fit")(fit.fit)
app.command("fit-scan")(fit_scan.fit_scan)
app.command("edit")(edit.edit)
app.command("transfer")(transfer.transfer)
app.command("track")(track.track)
app.command("retarget")(retarget.retarget)
app.command("animate")(animate.animate)
app.command("export")(export.export)
app.add_typer(regions.app, name="regions")
app.command("pose")(pose.pose)
app.add_typer(simulate.app, name="simulate")
app.add_typer(capture.app, name="capture")
app.add_typer(warehouse.app, name="warehouse")
app.add_typer(mocap.app, name="mocap")
app.command("evaluate")(evaluate.evaluate)
app.command("info")(info.info)


def run() -> None:
    """Run the command line; the entry point of the installed script."""
    # A polite kill ends like Ctrl-C: temporary files are removed on the way out.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        app()
    except KeyboardInterrupt:  # before or after the command itself
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    run()
