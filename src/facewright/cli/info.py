"""facewright info: versions, machine, extras, store."""

from __future__ import annotations

from facewright.cli.console import JsonOption, finish, table


def info(as_json: JsonOption = False) -> None:
    """Show versions, the machine, which extras and faces are installed, and where faces are kept.

    \b
    Examples:
      facewright info
      facewright info --json
    """
    from facewright.apps.describe import describe_installation

    found = describe_installation()

    def show() -> None:
        rows = [["facewright", found["facewright"]], ["python", found["python"]]]
        rows += [[name, version or "not installed"] for name, version in found["packages"].items()]
        table("Versions", ["package", "version"], rows)
        table("Machine", ["", "value"], [[key, str(value)] for key, value in found["machine"].items()])
        rows = [[f"extra {name}", _extra_text(name, found["missing"].get(name, []))] for name in found["extras"]]
        rows += [
            [f"face {f['name']}", "yes" if f["installed"] else f"no: facewright faces install {f['name']}"]
            for f in found["faces"]
        ]
        table("Installed", ["what", "installed"], [*rows, ["faces are kept in", found["store"]]])

    finish(found, as_json, show)


def _extra_text(extra: str, missing: list[str]) -> str:
    if not missing:
        return "yes"
    return f"no, without {', '.join(missing)}: pip install 'facewright[{extra}]'"
