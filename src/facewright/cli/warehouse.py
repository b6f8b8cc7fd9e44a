"""facewright warehouse: look into a database of people, check it, label it, export and import."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from facewright.cli.console import EXIT_USER, JsonOption, finish, progress_bar, say, table
from facewright.cli.person_summary import show_person
from facewright.cli.wording import counted, megabytes

app = typer.Typer(no_args_is_help=True, help="Look into a database of people, and keep it.", rich_markup_mode="rich")
StoreArgument = Annotated[str, typer.Argument(help="Database: a folder, or a URL such as s3://bucket/faces.zarr.")]
WhereOption = Annotated[
    list[str] | None,
    typer.Option("--where", "-w", help="Only people for whom this holds, such as age>30 or sex=f; repeatable."),
]


@app.command("ls")
def list_command(
    store: StoreArgument,
    where: WhereOption = None,
    failures: Annotated[bool, typer.Option("--failures", help="List those who failed, and why.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the people of a database; only their attributes are read. Sizes are in memory; files are smaller.

    \b
    Examples:
      facewright warehouse ls faces.zarr
      facewright warehouse ls faces.zarr --where 'age>30' --where sex=f
      facewright warehouse ls faces.zarr --failures
    """
    from facewright.warehouse.query import explain_nobody
    from facewright.warehouse.store import Warehouse

    warehouse = Warehouse.open(store)
    if failures:
        found = [{"name": f.name, "kind": f.kind, "reason": f.reason} for f in warehouse.failures().values()]
        rows = [[f["name"], f["kind"], f["reason"]] for f in found]
        finish({"failures": found}, as_json, lambda: table("Failures", ["subject", "kind", "reason"], rows))
        return
    entries = warehouse.entries(where or ())
    people = [
        {
            "name": entry.name,
            "attributes": entry.attributes,
            "expressions": len(entry.expressions),
            "blendshapes": "blendshapes" in entry.arrays,
            "uncompressed_megabytes": round(entry.n_bytes / 1e6, 3),
        }
        for entry in entries
    ]
    n_failed = len(warehouse.failures())
    hints = [] if entries or not where else explain_nobody(where, [e.attributes for e in warehouse.entries()])

    def show() -> None:
        keys = sorted({key for entry in entries for key in entry.attributes})
        columns = ["subject", *keys, "expressions", "blendshapes", "MB in memory"]
        rows = [
            [e.name, *(str(e.attributes.get(key, "")) for key in keys), str(len(e.expressions))]
            + ["yes" if "blendshapes" in e.arrays else "no", f"{e.n_bytes / 1e6:.1f}"]
            for e in entries
        ]
        if entries or not where:
            table(f"{store}: {counted(len(entries), 'person', 'people')}", columns, rows)
        for sentence in hints:
            say(sentence)
        if n_failed and not where:
            say(f"{n_failed} failed: facewright warehouse ls {store} --failures tells why.")

    finish({"subjects": people, "failures": n_failed, "hints": hints}, as_json, show)


@app.command("show")
def show(
    store: StoreArgument,
    subject: Annotated[str | None, typer.Argument(help="A person; the database itself where left out.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture to write: the person's expressions and blendshapes.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Describe a database or a person and, with --out, draw the person; --json tells all of how a person was made.

    \b
    Examples:
      facewright warehouse show faces.zarr
      facewright warehouse show faces.zarr anna -o anna.png
    """
    from facewright.apps.warehouse_show import ShowWarehouseRequest, show_warehouse

    with progress_bar(as_json) as progress:
        found = show_warehouse(ShowWarehouseRequest(store, subject, out), progress)

    def lines() -> None:
        if subject is not None:
            show_person(found, store)
        else:
            table(store, ["", "value"], [[key.replace("_", " "), _short(value)] for key, value in found.items()])

    finish(found, as_json, lines)


@app.command("check")
def check(
    store: StoreArgument,
    repair: Annotated[bool, typer.Option("--repair", help="Remove what killed writers left, if older than --age.")] = (
        False
    ),
    remove_damaged: Annotated[
        bool, typer.Option("--remove-damaged", help="Take damaged people out, so that a build makes them again.")
    ] = False,
    age: Annotated[float, typer.Option(help="Minutes after which an unfinished write counts as left.", min=0)] = 60.0,
    as_json: JsonOption = False,
) -> None:
    """Read every array of a database and compare it with its checksum; exit code 2 if something is damaged.

    Tells the size of its files, which are compressed: `ls` and `show` tell sizes in memory.

    \b
    Examples:
      facewright warehouse check faces.zarr
      facewright warehouse check faces.zarr --repair
      facewright warehouse check faces.zarr --remove-damaged
    """
    from facewright.warehouse.check import DAMAGED, check_warehouse
    from facewright.warehouse.store import Warehouse

    warehouse = Warehouse.open(store, "a" if repair or remove_damaged else "r")
    with progress_bar(as_json) as progress:
        report = check_warehouse(
            warehouse,
            repair=repair,
            remove_damaged=remove_damaged,
            seconds_until_left=60.0 * age,
            progress=progress,
        )
    findings = [{"subject": f.subject, "kind": f.kind, "what": f.what} for f in report.findings]
    damaged = sum(finding["kind"] == DAMAGED for finding in findings)
    payload = {
        "subjects": report.n_subjects,
        "arrays": report.n_arrays,
        "stored_megabytes": round(report.n_bytes / 1e6, 3),
        "damaged_subjects": report.damaged,
        "findings": findings,
        "removed": report.removed,
    }

    def lines() -> None:
        if findings:
            table("Findings", ["subject", "kind", "what"], [[f["subject"], f["kind"], f["what"]] for f in findings])
        say(
            f"{counted(report.n_subjects, 'person', 'people')}, {counted(report.n_arrays, 'array')}, "
            f"{megabytes(report.n_bytes)} stored, compressed: "
            + (f"{damaged} damaged." if damaged else "all as they were written.")
        )
        if report.removed:
            say(f"Removed {len(report.removed)}.")

    finish(payload, as_json, lines)
    if damaged and not (remove_damaged and all(f["subject"] for f in findings if f["kind"] == DAMAGED)):
        raise typer.Exit(EXIT_USER)


@app.command("label")
def label(
    store: StoreArgument,
    subject: Annotated[str, typer.Argument(help="A person.")],
    attributes: Annotated[list[str], typer.Argument(help="key=value, such as age=34; key= takes one away.")],
    as_json: JsonOption = False,
) -> None:
    """Set attributes of a person; they stay when the person is built again.

    \b
    Examples:
      facewright warehouse label faces.zarr anna age=34 sex=f
      facewright warehouse label faces.zarr anna glasses=true 'hair colour=brown'
      facewright warehouse label faces.zarr anna age=
    """
    from facewright.errors import ValueRangeError
    from facewright.warehouse.query import parse_value
    from facewright.warehouse.store import Warehouse

    values: dict[str, Any] = {}
    for text in attributes:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise ValueRangeError(f"attribute must be key=value, such as age=34, got {text!r}.")
        values[key.strip()] = parse_value(value) if value.strip() else None
    found = Warehouse.open(store, "a").set_labels(subject, values)
    rows = [[key, str(value)] for key, value in found.items()]
    finish({"name": subject, "attributes": found}, as_json, lambda: table(subject, ["attribute", "value"], rows))


@app.command("rm")
def remove(
    store: StoreArgument,
    subjects: Annotated[list[str], typer.Argument(help="People, or failures, to remove.")],
    as_json: JsonOption = False,
) -> None:
    """Remove people with everything that is kept of them; it cannot be undone.

    \b
    Examples:
      facewright warehouse rm faces.zarr anna
    """
    from facewright.warehouse.store import Warehouse

    warehouse = Warehouse.open(store, "a")
    for name in subjects:
        warehouse.remove_subject(name)
    finish({"removed": subjects}, as_json, lambda: say(f"Removed {', '.join(subjects)}."))


@app.command("export")
def export(
    store: StoreArgument,
    out: Annotated[Path, typer.Argument(help="Folder for the people's folders.")],
    where: WhereOption = None,
    subject: Annotated[list[str] | None, typer.Option("--subject", "-s", help="Only this person; repeatable.")] = None,
    layout: Annotated[str, typer.Option(help="meshes or facewarehouse.")] = "meshes",
    mesh_format: Annotated[str, typer.Option("--format", help="obj or ply, for meshes.")] = "obj",
    names: Annotated[
        str | None, typer.Option(help="Naming scheme of the shapes for facewarehouse, such as facewarehouse46.")
    ] = None,
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Also write pictures.")] = True,
    as_json: JsonOption = False,
) -> None:
    """Write people as folders of meshes, or laid out as FaceWarehouse's folders.

    \b
    Examples:
      facewright warehouse export faces.zarr meshes
      facewright warehouse export faces.zarr meshes --where 'age<18' --format ply
      facewright warehouse export faces.zarr fw --layout facewarehouse --names facewarehouse46
    """
    from facewright.apps.warehouse_export import ExportPeopleRequest, export_people

    request = ExportPeopleRequest(
        store, out, tuple(where or ()), tuple(subject or ()), layout, mesh_format, names, pictures
    )
    with progress_bar(as_json) as progress:
        folders = export_people(request, progress)
    finish({"folders": folders}, as_json, lambda: say(f"Wrote {counted(len(folders), 'person', 'people')} to {out}."))


@app.command("import")
def import_(
    folder: Annotated[Path, typer.Argument(help="Folder with one folder for each person.")],
    store: StoreArgument,
    layout: Annotated[str, typer.Option(help="auto, facewarehouse or meshes.")] = "auto",
    faces: Annotated[
        str | None, typer.Option("--faces", help="Face whose topology a new database gets; else the meshes' own.")
    ] = None,
    unit: Annotated[str, typer.Option(help="auto, mm, cm, dm or m.")] = "auto",
    pictures: Annotated[bool, typer.Option("--pictures/--no-pictures", help="Also take pictures.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace people who are there.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Import FaceWarehouse's published folders, or folders of meshes named after expressions.

    \b
    Examples:
      facewright warehouse import FaceWarehouse facewarehouse.zarr
      facewright warehouse import meshes faces.zarr --faces ict --unit cm
    """
    from facewright.apps.warehouse_import import ImportRequest, import_people

    request = ImportRequest(folder, store, layout, faces, unit, pictures, overwrite)
    with progress_bar(as_json) as progress:
        report = import_people(request, progress)
    payload = {
        "layout": report.layout,
        "imported": report.imported,
        "already_there": report.already_there,
        "failed": report.failed,
    }

    def lines() -> None:
        if report.failed:
            table("Failed", ["subject", "reason"], [[name, reason] for name, reason in report.failed.items()])
        there = f", {len(report.already_there)} were there" if report.already_there else ""
        imported = counted(len(report.imported), "person", "people")
        say(f"Imported {imported} into {store}{there}; {len(report.failed)} failed.")

    finish(payload, as_json, lines)
    if report.failed and not report.imported and not report.already_there:
        raise typer.Exit(EXIT_USER)


def _short(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_short(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return str(value)
