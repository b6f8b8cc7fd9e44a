"""Topologies of mesh files: the same as a known one, a known face's, or a new one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, TopologyError
from facewright.io.mesh_data import MeshData
from facewright.mesh.topology import Topology

if TYPE_CHECKING:
    from facewright.faces.face import Face


def same_topology(mesh: MeshData, topology: Topology) -> bool:
    """Tell whether a mesh is of a topology: as many vertices and the same polygons, in whatever order.

    Polygons are compared where both have them, else triangles; a polygon may begin at any of its corners.
    """
    if mesh.n_vertices != topology.n_vertices:
        return False
    if mesh.polygons is not None and topology.quads is not None:
        return _same_rows(mesh.polygons, topology.quads)
    return _same_rows(mesh.faces, topology.faces)


def check_topology(mesh: MeshData, topology: Topology, where: Any, *, what: str = "the database's") -> None:
    """Raise TopologyError unless a mesh is of `topology`; the message tells how they differ."""
    if same_topology(mesh, topology):
        return
    found = f"{mesh.n_vertices} vertices and {len(mesh.faces)} triangles"
    expected = f"{topology.n_vertices} vertices and {len(topology.faces)} triangles"
    if found == expected:
        found = "as many, but other triangles between them"
    raise TopologyError(f"{where} must be of {what} topology {topology.name!r} with {expected}, got {found}.")


def topology_of_mesh(mesh: MeshData, name: str) -> Topology:
    """Return a mesh file's own topology; it has no masks and no landmarks, which no mesh file tells."""
    quads = mesh.polygons
    if quads is not None and quads.shape[1] != 4:
        quads = None if quads.shape[1] > 4 else np.pad(quads, ((0, 0), (0, 1)), constant_values=-1)
    has_uv = mesh.uv is not None and mesh.uv_faces is not None
    return Topology(
        name=name,
        n_vertices=mesh.n_vertices,
        faces=np.asarray(mesh.faces, dtype=np.int32),
        quads=None if quads is None else np.asarray(quads, dtype=np.int32),
        uv=mesh.uv if has_uv else None,
        uv_faces=mesh.uv_faces if has_uv else None,
        parts={"face": (0, mesh.n_vertices)},
    )


def find_face(mesh: MeshData) -> Face | None:
    """Return the installed face, whole or its skin, whose topology a mesh has; it brings masks and landmarks."""
    from facewright.faces import list_faces, load_face

    for info in list_faces():
        if not info.installed:
            continue
        try:
            face = load_face(info.name)
        except FacewrightError:  # an installed file that is damaged is no reason not to import meshes
            continue
        if same_topology(mesh, face.topology):
            return face
        if mesh.n_vertices == face.n_skin and same_topology(mesh, face.skin().topology):
            return face.skin()
    return None


def _same_rows(a: NDArray[Any], b: NDArray[Any]) -> bool:
    width = max(a.shape[1], b.shape[1])
    return len(a) == len(b) and np.array_equal(_canonical(a, width), _canonical(b, width))


def _canonical(rows: NDArray[Any], width: int) -> NDArray[np.int64]:
    """Begin each polygon at its smallest corner, and sort the polygons."""
    padded = np.full((len(rows), width), -1, dtype=np.int64)
    padded[:, : rows.shape[1]] = rows
    counts = (padded >= 0).sum(axis=1)
    first = np.where(padded >= 0, padded, np.iinfo(np.int64).max).argmin(axis=1)
    columns = np.arange(width)
    at = (first[:, None] + columns) % np.maximum(counts, 1)[:, None]
    turned = np.where(columns < counts[:, None], np.take_along_axis(padded, at, axis=1), -1)
    return turned[np.lexsort(turned.T[::-1])]
