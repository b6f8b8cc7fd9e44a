"""A person of a database in a few lines and one small table; everything is in the JSON form."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from facewright.cli.console import say, table
from facewright.cli.wording import counted, megabytes

# Column of the table -> where an expression's provenance has it.
_COLUMNS = {
    "frames": ("fusion", "n_fused"),
    "depth, mm": ("fit", "stage2_rms_mm"),
    "landmarks, mm": ("fit", "landmark_rms_mm"),
    "rig, mm": ("rig_residual_mm",),
    "landmarks by": ("landmarks",),
}
_MOST_NAMED = 12


def show_person(found: Mapping[str, Any], store: str) -> None:
    """Print what `show_warehouse` found of a person."""
    parts = [counted(len(found["expressions"]), "expression")]
    if "blendshapes" in found["arrays"]:
        parts.append(f"{found['arrays']['blendshapes'][0] - 1} blendshapes")
    parts.append(f"{megabytes(1e6 * found['uncompressed_megabytes'])} uncompressed")
    say(f"{found['name']} of {store}: {', '.join(parts)}.")
    provenance = found["provenance"]
    recorded = provenance.get("expressions")
    has_table = isinstance(recorded, Mapping) and set(recorded) == set(found["expressions"])
    rows = [
        ["attributes", _listed(found["attributes"]) or "none"],
        ["made from", _origin(provenance)],
        *([] if has_table else [["expressions", ", ".join(found["expressions"])]]),
        ["kept", _listed({name: _shape(entry) for name, entry in found["arrays"].items()})],
        ["digest", found["digest"]],
    ]
    missing = provenance.get("missing")
    if isinstance(missing, list) and missing:
        rows.insert(2, ["not recorded", ", ".join(map(str, missing[:_MOST_NAMED])) + _rest(len(missing))])
    table("", ["", "value"], rows)
    if has_table:
        _show_expressions(recorded)
    for note in found["notes"]:
        say(f"Note: {note}")
    say("Everything that is known of how it was made: --json.")
    if "picture" in found:
        say(f"Wrote {found['picture']}.")


def _show_expressions(recorded: Mapping[str, Any]) -> None:
    """Tell how well each expression was fitted: distances are root mean squares."""
    rows = [[name, *(_cell(facts, keys) for keys in _COLUMNS.values())] for name, facts in recorded.items()]
    table("Expressions: distance from depth, landmarks and rig (RMS)", ["expression", *_COLUMNS], rows)


def _cell(facts: Any, keys: tuple[str, ...]) -> str:
    for key in keys:
        facts = facts.get(key) if isinstance(facts, Mapping) else None
    if facts is None:
        return ""
    return f"{facts:.2f}" if isinstance(facts, float) else str(facts)


def _origin(provenance: Mapping[str, Any]) -> str:
    """Tell where a person comes from: the source, and the short facts beside it."""
    face = provenance.get("face")
    versions = provenance.get("versions")
    facts = {key: value for key, value in provenance.items() if isinstance(value, str | int | float)}
    source = str(facts.pop("source", "unknown"))
    if isinstance(face, Mapping) and "name" in face:
        facts["face"] = face["name"]
    if isinstance(versions, Mapping) and "facewright" in versions:
        facts["facewright"] = versions["facewright"]
    return ", ".join([source, *(f"{key} {value}" for key, value in facts.items())])


def _listed(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {_word(value)}" for key, value in values.items())


def _word(value: Any) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)


def _shape(entry: list[Any]) -> str:
    return " x ".join(map(str, entry[:-1]))


def _rest(number: int) -> str:
    return f" and {number - _MOST_NAMED} more" if number > _MOST_NAMED else ""
