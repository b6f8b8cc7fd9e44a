"""Look through a whole warehouse: damaged arrays, missing ones, and what killed writers left."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from facewright.errors import FacewrightError, FileFormatError, StoreError
from facewright.warehouse.entry import SubjectEntry
from facewright.warehouse.layout import GROUPS, ROOT, SECONDS_UNTIL_LEFT, failure_folder, is_token, token_age
from facewright.warehouse.objects import ObjectFacts, Objects
from facewright.warehouse.store import Warehouse

Progress = Callable[[str, int, int], None]

DAMAGED, LEFTOVER, YOUNG, FOREIGN = "damaged", "leftover", "in the making", "foreign"
_TEMPORARY = re.compile(r"\..+\.(part|new)(\.json)?")  # see write_atomically and LocalObjects.create


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be.

    Parameters
    ----------
    subject : str
        The subject it is about; empty where it is about the store.
    kind : {"damaged", "leftover", "in the making", "foreign"}
        Damaged contents; what a killed writer left; what a writer may be at work on; or something of another program.
    what : str
        One sentence.
    key : str
        Where it lies in the store.
    """

    subject: str
    kind: str
    what: str
    key: str


@dataclass(frozen=True)
class CheckReport:
    """What a check found and did.

    Parameters
    ----------
    n_subjects, n_arrays : int
        Looked at.
    n_bytes : int
        Size of the store.
    findings : tuple of Finding
        In order of subjects; before the repair.
    removed : tuple of str
        Keys that the repair removed.
    """

    n_subjects: int
    n_arrays: int
    n_bytes: int
    findings: tuple[Finding, ...]
    removed: tuple[str, ...]

    @property
    def damaged(self) -> tuple[str, ...]:
        """Names of damaged subjects."""
        return tuple(sorted({f.subject for f in self.findings if f.kind == DAMAGED and f.subject}))


def check_warehouse(
    warehouse: Warehouse,
    *,
    repair: bool = False,
    remove_damaged: bool = False,
    seconds_until_left: float = SECONDS_UNTIL_LEFT,
    progress: Progress | None = None,
) -> CheckReport:
    """Read every array of a database and compare it with its checksum; find what no reader would ever look at.

    Parameters
    ----------
    warehouse : Warehouse
        Open for writing if anything shall be removed.
    repair : bool
        Remove what killed writers left, where it is older than `seconds_until_left`.
    remove_damaged : bool
        Also take damaged subjects out of the database and record them as failures, so that a build makes them again.
    seconds_until_left : float
        Younger leftovers may be the work of a living writer and stay.
    progress : callable(stage, done, total), optional

    Returns
    -------
    CheckReport

    Raises
    ------
    StoreError
        If the store cannot be read, or is open for reading only where something shall be removed.
    """
    if (repair or remove_damaged) and warehouse.mode != "a":
        raise StoreError(f"{warehouse.url} is open for reading only; open it with mode 'a'.")
    objects = warehouse.objects
    facts = objects.facts("")
    findings = list(_check_topology(warehouse))
    names = sorted({key.split("/")[1] for key in facts if key.startswith("subjects/") and key.count("/") > 1})
    entries: list[SubjectEntry] = []
    n_arrays = n_subjects = 0
    for done, name in enumerate(names):
        if f"subjects/{name}/zarr.json" in facts:
            n_subjects += 1
            entry, damage = _check_subject(warehouse, name)
            findings += damage
            entries += [] if entry is None else [entry]
            n_arrays += 0 if entry is None else len(entry.arrays)
        if progress is not None:
            progress("checking subjects", done + 1, len(names))
    unread = {f.subject for f in findings} - {entry.name for entry in entries}
    known = _known_keys(warehouse, entries, facts)
    findings += _leftovers(facts, known, unread, seconds_until_left)
    findings.sort(key=lambda finding: (finding.subject, finding.kind, finding.key))
    removed = _repair(warehouse, findings, repair, remove_damaged)
    n_bytes = sum(fact.n_bytes for fact in facts.values())
    return CheckReport(n_subjects, n_arrays, n_bytes, tuple(findings), removed)


def _check_topology(warehouse: Warehouse) -> Iterable[Finding]:
    try:
        Warehouse.open(warehouse.url).topology  # noqa: B018  read again, not the one in memory
    except FileFormatError as error:
        yield Finding("", DAMAGED, str(error), "topology")


def _check_subject(warehouse: Warehouse, name: str) -> tuple[SubjectEntry | None, list[Finding]]:
    """Read all of a subject, one array at a time."""
    found: list[Finding] = []
    try:
        entry = warehouse.entry(name)
    except StoreError:  # removed meanwhile
        return None, []
    except FacewrightError as error:
        return None, [Finding(name, DAMAGED, str(error), f"subjects/{name}/zarr.json")]
    for field, description in entry.arrays.items():
        try:
            warehouse.read_field(entry, field)
            if field in ("meshes", "blendshapes") and list(description["shape"])[1:] != [warehouse.n_vertices, 3]:
                raise FileFormatError(f"{field} of subject {name!r} must have {warehouse.n_vertices} vertices.")
        except FileFormatError as error:
            if name not in warehouse or warehouse.entry(name).token != entry.token:  # written again meanwhile
                return None, []
            found.append(Finding(name, DAMAGED, str(error), f"{entry.folder}/{field}"))
    return entry, found


def _known_keys(warehouse: Warehouse, entries: list[SubjectEntry], facts: dict[str, ObjectFacts]) -> set[str]:
    """Return prefixes, ending in a slash, and keys that belong to the store."""
    names = {entry.name for entry in entries}
    known = {ROOT, *(f"{group}/zarr.json" for group in GROUPS)}
    known.add(f"topology/{warehouse.document['topology']['token']}/")
    known |= {f"subjects/{name}/zarr.json" for name in names} | {f"labels/{name}/zarr.json" for name in names}
    known |= {f"{entry.folder}/" for entry in entries}
    for name in warehouse.failures():
        known.add(f"{failure_folder(name)}/zarr.json")
    return known


def _leftovers(
    facts: dict[str, ObjectFacts], known: set[str], unread: set[str], seconds_until_left: float
) -> list[Finding]:
    """Find objects that nothing refers to; those below one token are told as one."""
    ages: dict[str, float | None] = {}
    found: list[Finding] = []
    for key, fact in facts.items():
        parts = key.split("/")
        prefixes = {"/".join(parts[:depth]) + "/" for depth in range(1, len(parts))}
        if key in known or prefixes & known:
            continue
        if parts[0] in ("subjects", "labels") and parts[1] in unread:  # its document is damaged: nothing is known
            continue
        at = {"subjects": 2, "topology": 1}.get(parts[0])
        if at is not None and len(parts) > at + 1 and is_token(parts[at]):
            ages["/".join(parts[: at + 1])] = token_age(parts[at])
        elif _TEMPORARY.fullmatch(parts[-1]) or (parts[0] in ("labels", "failures") and parts[2:] == ["zarr.json"]):
            ages[key] = None if fact.modified is None else time.time() - fact.modified
        else:
            found.append(Finding("", FOREIGN, f"{key} is of another program; it is left alone.", key))
    for key, age in ages.items():
        subject = key.split("/")[1] if key.startswith("subjects/") else ""
        if age is not None and age < seconds_until_left:
            found.append(Finding(subject, YOUNG, f"{key} was begun {age:.0f} s ago; a writer may be at it.", key))
        else:
            found.append(Finding(subject, LEFTOVER, f"{key} belongs to nothing; a writer was stopped.", key))
    return found


def _repair(warehouse: Warehouse, findings: list[Finding], repair: bool, remove_damaged: bool) -> tuple[str, ...]:
    removed: list[str] = []
    if repair:
        for finding in findings:
            if finding.kind == LEFTOVER:
                warehouse.objects.delete(finding.key)
                removed.append(finding.key)
        removed += _empty_places(warehouse.objects)
    if remove_damaged:
        damage: dict[str, Any] = {f.subject: f for f in reversed(findings) if f.kind == DAMAGED and f.subject}
        for name in sorted(damage):
            warehouse.remove_subject(name)
            warehouse.record_failure(name, damage[name].what, "Damaged")
            removed.append(f"subjects/{name}")
    return tuple(removed)


def _empty_places(objects: Objects) -> list[str]:
    """Remove folders of subjects that hold nothing any more (only file systems have such)."""
    removed = []
    for name in objects.names_in("subjects"):
        if name != "zarr.json" and not objects.facts(f"subjects/{name}"):
            objects.delete_empty(f"subjects/{name}")
            removed.append(f"subjects/{name}")
    return removed
