"""Why subjects could not be made: kept in the store until they are."""

from __future__ import annotations

from dataclasses import dataclass

from facewright.errors import FacewrightError
from facewright.warehouse.layout import failure_folder, group_content, group_document, subject_key
from facewright.warehouse.objects import Objects
from facewright.warehouse.subject import check_name


@dataclass(frozen=True)
class Failure:
    """Why a subject could not be made.

    Parameters
    ----------
    name : str
        The subject's name, also where it is not one that the store could take.
    kind : str
        Kind of failure, such as the error's class.
    reason : str
        One sentence.
    """

    name: str
    kind: str
    reason: str


def write_failure(objects: Objects, name: str, reason: str, kind: str) -> None:
    """Keep a failure, in place of an older one of that name."""
    content = {"name": name, "kind": kind, "reason": " ".join(reason.split()), "beside": _token(objects, name)}
    objects.put(f"{failure_folder(name)}/zarr.json", group_document(content))


def read_failures(objects: Objects) -> dict[str, Failure]:
    """Return the failures that still hold, sorted by name.

    A writer that is killed between making a subject visible and clearing its failure leaves one that no longer holds:
    it was recorded beside another state of the subject than there is now.
    """
    folders = [name for name in objects.names_in("failures") if name != "zarr.json"]
    found = {}
    for document in objects.get([f"failures/{folder}/zarr.json" for folder in folders]):
        if document is None:
            continue
        content = group_content(document, f"{objects.url}: a failure")
        name = str(content.get("name", ""))
        if _token(objects, name) == content.get("beside"):
            found[name] = Failure(name, str(content.get("kind", "")), str(content.get("reason", "")))
    return dict(sorted(found.items()))


def _token(objects: Objects, name: str) -> str | None:
    """Return the token of the subject as it is now; None where there is none, or its document is damaged."""
    try:
        check_name(name)
        document = objects.get([subject_key(name)])[0]
        return None if document is None else str(group_content(document, subject_key(name)).get("token"))
    except FacewrightError as error:
        if isinstance(error, OSError):
            raise
        return None
