"""The root document of a warehouse: made last when a store is made, read first when it is opened."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

from facewright.errors import FileFormatError, StoreError
from facewright.mesh.topology import Topology
from facewright.warehouse.layout import GROUPS, KIND, ROOT, VERSION, group_document, new_token
from facewright.warehouse.objects import Objects


def make_root(objects: Objects, topology: Topology, facts: dict[str, Any]) -> dict[str, Any] | None:
    """Write the topology, the groups and last the root document, unless another process was faster.

    Returns
    -------
    dict or None
        The document; None where there is one of another process.

    Raises
    ------
    StoreError
        If the place holds something else or cannot be written.
    """
    from facewright.warehouse.topology_arrays import encode_topology

    foreign = [name for name in objects.names_in("") if name not in GROUPS]  # a killed `create` is no hindrance
    if foreign:
        raise StoreError(f"{objects.url} must be a new or empty place for a database, got one with {foreign[0]!r}.")
    parts, topology_document = encode_topology(topology, new_token())
    document = {"kind": KIND, "version": VERSION, **facts, "topology": topology_document}
    made = False
    try:
        objects.put_all(parts)
        for group in GROUPS:
            objects.put(f"{group}/zarr.json", group_document())
        made = objects.create(ROOT, group_document(document))
    finally:
        if not made:
            with suppress(StoreError):
                objects.delete(f"topology/{topology_document['token']}")
    return document if made else None


def read_root(objects: Objects) -> dict[str, Any]:
    """Read and check the root document.

    Raises
    ------
    StoreError
        If there is none, or it cannot be read.
    FileFormatError
        If what is there is foreign, damaged or of another version.
    """
    (found,) = objects.get([ROOT])
    if found is None:
        raise _no_store(objects)
    return _checked(objects.url, found)


def _no_store(objects: Objects) -> StoreError | FileFormatError:
    if any(found is not None for found in objects.get([".zgroup", ".zarray"])):
        return FileFormatError(f"{objects.url} must be a facewright database (Zarr version 3), got Zarr version 2.")
    names = objects.names_in("")
    if names and set(names) <= set(GROUPS):
        return StoreError(f"{objects.url} must be a database, got one whose making was stopped; make it again.")
    if names:
        return FileFormatError(f"{objects.url} must be a facewright database, got something else: no {ROOT} in it.")
    return StoreError(f"{objects.url} must be a facewright database, got nothing there; facewright build makes one.")


def _checked(url: str, document: bytes) -> dict[str, Any]:
    """Return the document's content; foreign stores and other versions are told apart."""
    try:
        whole = json.loads(document)
        node = whole["node_type"]
        content = whole.get("attributes", {}).get("facewright")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(f"{url} must be a facewright database, got a damaged {ROOT}.") from error
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise FileFormatError(f"{url} must be a facewright database, got another Zarr {node}.")
    version = content.get("version")
    if version != VERSION:
        remedy = "upgrade facewright." if isinstance(version, int) and version > VERSION else "build it again."
        raise FileFormatError(f"{url} is a database of version {version}, this facewright reads {VERSION}; {remedy}")
    names = [content.get(key) for key in ("expression_names", "blendshape_names")]
    topology = content.get("topology")
    if not all(isinstance(group, list) for group in names) or not isinstance(topology, dict):
        raise FileFormatError(f"{url} is damaged: its {ROOT} does not tell names and topology.")
    if not isinstance(topology.get("n_vertices"), int) or "face" not in content:
        raise FileFormatError(f"{url} is damaged: its {ROOT} does not tell the face and its number of vertices.")
    return content
