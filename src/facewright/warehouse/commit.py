"""Write a subject so that it is there as a whole or not at all, whatever happens to the writer."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError, StoreError, ValueRangeError
from facewright.warehouse.arrays import describe_array, encode_group
from facewright.warehouse.entry import SubjectEntry
from facewright.warehouse.layout import (
    DTYPES,
    FIELDS,
    SECONDS_UNTIL_LEFT,
    array_chunks,
    failure_folder,
    group_content,
    group_document,
    is_token,
    json_value,
    new_token,
    subject_key,
    token_age,
)
from facewright.warehouse.objects import Objects
from facewright.warehouse.query import KEY
from facewright.warehouse.subject import Subject


def commit_subject(objects: Objects, subject: Subject, *, overwrite: bool) -> SubjectEntry:
    """Write all arrays under a fresh token, then make them visible by one small object.

    A writer that dies before the last step leaves a folder that no reader looks at (`check` with repair removes it).
    Of two writers of one subject, both write their own folders and one document wins; without `overwrite` the
    document is created only where none is, and the second writer is told so.

    Raises
    ------
    StoreError
        If the subject is there already and `overwrite` is False, or the store cannot be written, such as for a full
        disk; then nothing of it stays.
    ValueRangeError
        If attributes or provenance hold what JSON cannot.
    """
    key = subject_key(subject.name)
    arrays = stored_arrays(subject)
    token = new_token()
    entry = SubjectEntry(
        name=subject.name,
        token=token,
        expressions=tuple(subject.expressions),
        arrays={name: describe_array(array) for name, array in arrays.items()},
        own_attributes=checked_attributes(subject.attributes),
        provenance=json_value("provenance", subject.provenance),
    )
    document = group_document(entry.content())
    before = objects.get([key])[0]
    if before is not None and not overwrite:
        raise _exists(objects, subject.name)
    visible = False
    try:
        chunks = {name: array_chunks(name, array.shape) for name, array in arrays.items()}
        objects.put_all(encode_group(entry.folder, arrays, chunks))
        if overwrite:
            objects.put(key, document)
        elif not objects.create(key, document):
            raise _exists(objects, subject.name)
        visible = True
    finally:
        if not visible:
            with suppress(FacewrightError):
                objects.delete(entry.folder)
    older = _token_of(before)
    if older is not None:  # a token that was replaced never comes back, so that its arrays can go
        with suppress(FacewrightError):
            objects.delete(f"subjects/{subject.name}/{older}")
    return entry


def remove_subject(objects: Objects, name: str) -> bool:
    """Remove a subject, its labels, a recorded failure, and what killed writers left of it; tells if there was any.

    What another writer began within the last hour is left alone: it may be about to become visible.
    """
    failures = objects.names_in("failures")
    failure = failure_folder(name)
    found = failure.rpartition("/")[2] in failures
    objects.delete(failure)
    if name not in objects.names_in("subjects"):
        return found
    key = subject_key(name)
    document = objects.get([key])[0]
    current = _token_of(document)
    damaged = document is not None and current is None  # which arrays are its own is not known: all go
    objects.delete(key)  # from here on it is gone
    for token in objects.names_in(f"subjects/{name}"):
        if damaged or token == current or not is_token(token) or token_age(token) > SECONDS_UNTIL_LEFT:
            objects.delete(f"subjects/{name}/{token}")
    objects.delete_empty(f"subjects/{name}")
    objects.delete(f"labels/{name}")
    return found or document is not None


def stored_arrays(subject: Subject) -> dict[str, NDArray[Any]]:
    """Return a subject's arrays in the types they are stored in; refuses values that would change by that."""
    arrays: dict[str, NDArray[Any]] = {}
    for name in FIELDS:
        given = getattr(subject, name)
        if given is None:
            continue
        array = np.ascontiguousarray(given, dtype=DTYPES.get(name, "float64"))
        if DTYPES.get(name) == "uint8" and np.asarray(given).dtype != np.uint8:
            raise ValueRangeError(f"{name} of subject {subject.name!r} must be uint8, got {np.asarray(given).dtype}.")
        if min(array.shape) > 0:
            arrays[name] = array
    return arrays


def checked_attributes(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes as JSON values, in order of their names.

    Raises
    ------
    ValueRangeError
        If a name cannot stand in a condition, or a value is not text, a finite number, or true or false.
    """
    checked = {}
    for name in sorted(attributes):
        value = json_value(f"attribute {name}", attributes[name])
        if not isinstance(name, str) or re.fullmatch(KEY, name) is None or len(name) > 128:
            raise ValueRangeError(
                f"attribute must have a name without < > = ! and without blanks at its ends, got {name!r}."
            )
        if not isinstance(value, str | int | float):
            raise ValueRangeError(f"attribute {name} must be text, a finite number, true or false, got {value!r}.")
        checked[name] = value
    return checked


def _exists(objects: Objects, name: str) -> StoreError:
    return StoreError(f"{objects.url} has subject {name!r} already; overwrite it, or give another name.")


def _token_of(document: bytes | None) -> str | None:
    """Return the token that a document names, None where it is none or a damaged one."""
    if document is None:
        return None
    try:
        token = str(group_content(document, "").get("token"))
    except FileFormatError:
        return None
    return token if is_token(token) else None
