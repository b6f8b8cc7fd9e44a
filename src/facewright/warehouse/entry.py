"""What a warehouse says of a subject without reading its arrays."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from facewright.errors import FileFormatError
from facewright.warehouse.layout import FIELDS, group_content, is_token, label_key, subject_key
from facewright.warehouse.objects import Objects


@dataclass(frozen=True)
class SubjectEntry:
    """A subject's small document: everything but arrays.

    Parameters
    ----------
    name : str
        The subject's name.
    token : str
        Folder of its arrays.
    expressions : tuple of str
        Expressions that are there, the neutral first.
    arrays : mapping of str to mapping
        Shape, dtype and SHA-256 of each array that is there, by the field's name in `Subject`.
    own_attributes : mapping
        Attributes that were written with the subject.
    labels : mapping
        Attributes set later; null takes an attribute away.
    provenance : mapping
        Versions, parameters, residuals.
    """

    name: str
    token: str
    expressions: tuple[str, ...]
    arrays: Mapping[str, Mapping[str, Any]]
    own_attributes: Mapping[str, Any] = field(default_factory=dict)
    labels: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def attributes(self) -> dict[str, Any]:
        """Attributes as they hold now: those of the subject, overruled by the labels."""
        both = {**self.own_attributes, **self.labels}
        return {key: value for key, value in both.items() if value is not None}

    @property
    def folder(self) -> str:
        """Key of the folder of its arrays."""
        return f"subjects/{self.name}/{self.token}"

    @property
    def digest(self) -> str:
        """SHA-256 over the contents: expressions, arrays, own attributes and provenance, but not name and labels."""
        content = {
            "expressions": list(self.expressions),
            "arrays": {key: dict(entry) for key, entry in self.arrays.items()},
            "attributes": dict(self.own_attributes),
            "provenance": dict(self.provenance),
        }
        text = json.dumps(content, sort_keys=True, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def n_bytes(self) -> int:
        """Bytes of the arrays in memory."""
        from facewright.warehouse.arrays import checked_description

        total = 0
        for key, entry in self.arrays.items():
            shape, dtype, _ = checked_description(entry, key)
            size = dtype.itemsize
            for axis in shape:
                size *= axis
            total += size
        return total

    def content(self) -> dict[str, Any]:
        """Return what the document holds."""
        return {
            "token": self.token,
            "digest": self.digest,
            "expressions": list(self.expressions),
            "arrays": {key: dict(entry) for key, entry in self.arrays.items()},
            "attributes": dict(self.own_attributes),
            "provenance": dict(self.provenance),
        }


def entry_from_content(name: str, content: Mapping[str, Any], labels: Mapping[str, Any], where: str) -> SubjectEntry:
    """Return the entry that a document holds.

    Raises
    ------
    FileFormatError
        If a part is missing or of another kind, or the contents do not match the digest.
    """
    try:
        entry = SubjectEntry(
            name=name,
            token=str(content["token"]),
            expressions=tuple(str(item) for item in content["expressions"]),
            arrays={str(key): dict(value) for key, value in content["arrays"].items()},
            own_attributes=dict(content["attributes"]),
            labels=dict(labels),
            provenance=dict(content["provenance"]),
        )
        good = content["digest"] == entry.digest and is_token(entry.token)
        good = good and "meshes" in entry.arrays and set(entry.arrays) <= set(FIELDS)
    except (KeyError, TypeError, ValueError, AttributeError):
        good = False
    if not good:
        raise FileFormatError(
            f"{where} is corrupt: the document of subject {name!r} does not match its checksum; take it out by "
            "facewright warehouse check --remove-damaged and make it again."
        )
    return entry


def read_entries(objects: Objects, names: Sequence[str]) -> list[SubjectEntry]:
    """Read the documents of subjects, in the order of `names`; those that are not there are left out.

    Raises
    ------
    StoreError
        If the store cannot be read.
    FileFormatError
        If a document is damaged; the message names the subject.
    """
    documents = objects.get([subject_key(name) for name in names])
    labelled = sorted(set(objects.names_in("labels")) & set(names))
    labels = dict(zip(labelled, objects.get([label_key(name) for name in labelled])))
    entries = []
    for name, document in zip(names, documents):
        if document is None:
            continue
        where = f"{objects.url}: subject {name!r}"
        set_later: Any = {}
        later = labels.get(name)
        if later is not None:
            set_later = group_content(later, f"{where}, labels").get("labels")
        content = group_content(document, where)
        entries.append(entry_from_content(name, content, set_later if isinstance(set_later, dict) else {}, where))
    return entries
