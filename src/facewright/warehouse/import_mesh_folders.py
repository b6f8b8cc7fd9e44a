"""Folders of meshes as subjects: one folder a person, one OBJ or PLY an expression."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError
from facewright.io.mesh_data import MeshData
from facewright.mesh.topology import Topology
from facewright.warehouse.import_units import UNITS, unit_of
from facewright.warehouse.mesh_topology import check_topology
from facewright.warehouse.subject import Subject, check_name

SUFFIXES = (".obj", ".ply")
BLENDSHAPE_FOLDER = "blendshapes"


@dataclass(frozen=True)
class MeshFolder:
    """One person's files.

    Parameters
    ----------
    name : str
        The folder's name.
    path : Path
        The folder.
    expressions : mapping of str to Path
        Expression -> mesh file, the neutral first.
    blendshapes : mapping of str to Path
        Blendshape -> mesh file; empty where there are none.
    """

    name: str
    path: Path
    expressions: Mapping[str, Path]
    blendshapes: Mapping[str, Path]


def list_mesh_folders(root: str | Path) -> list[Path]:
    """Return the folders of `root` that hold meshes, sorted by name.

    Raises
    ------
    StoreError
        If `root` cannot be read.
    FileFormatError
        If there is none.
    """
    root = Path(root)
    folders = [path for path in _entries(root) if path.is_dir() and any(map(_is_mesh, _entries(path)))]
    if not folders:
        hint = f": it looks like one person, give {root.parent}" if any(map(_is_mesh, _entries(root))) else ""
        raise FileFormatError(
            f"{root} must hold one folder for each person with meshes (.obj or .ply) named after expressions in it, "
            f"got none{hint}."
        )
    return folders


def open_mesh_folder(path: Path) -> MeshFolder:
    """Tell which meshes a person's folder holds: ``<expression>.obj`` and ``blendshapes/<name>.obj``.

    Raises
    ------
    FileFormatError
        If there is no neutral, or one mesh is there twice.
    ValueRangeError
        If the folder's name cannot be a subject's.
    """
    check_name(path.name)
    expressions = _meshes(path)
    if "neutral" not in expressions:
        raise FileFormatError(f"{path} must hold neutral.obj or neutral.ply, got {', '.join(expressions) or 'none'}.")
    ordered = {"neutral": expressions.pop("neutral"), **_in_usual_order(expressions)}
    folder = path / BLENDSHAPE_FOLDER
    return MeshFolder(path.name, path, ordered, _meshes(folder) if folder.is_dir() else {})


def read_mesh_subject(
    folder: MeshFolder, topology: Topology, blendshape_names: tuple[str, ...], *, unit: str = "auto"
) -> Subject:
    """Read a person whose meshes are all of one topology.

    Parameters
    ----------
    folder : MeshFolder
    topology : Topology
        That all meshes must have, vertex by vertex.
    blendshape_names : tuple of str
        The 46 names without the neutral; all or none of them must be there.
    unit : {"auto", "mm", "cm", "dm", "m"}
        Of the files; by default the one that makes the neutral as large as a face.

    Returns
    -------
    Subject
        Attributes are those of ``subject.json``.

    Raises
    ------
    StoreError, FileFormatError
        If a file is missing, unreadable or damaged.
    TopologyError
        If a mesh is of another topology.
    ValueRangeError
        If the size is not that of a face.
    """
    neutral = read_mesh(folder.expressions["neutral"])
    check_topology(neutral, topology, folder.expressions["neutral"])
    unit = unit_of(neutral.vertices, unit, folder.expressions["neutral"])
    scale = UNITS[unit]
    names = tuple(folder.expressions)
    meshes = np.empty((len(names), topology.n_vertices, 3), dtype=np.float32)
    meshes[0] = scale * neutral.vertices
    for row, name in zip(meshes[1:], names[1:]):
        row[:] = scale * _positions(folder.expressions[name], topology)
    blendshapes = _read_blendshapes(folder, topology, blendshape_names, scale, meshes[0])
    provenance = {"source": "mesh folder", "folder": folder.path.name, "unit": unit}
    attributes = read_attributes(folder.path / "subject.json")
    return Subject(folder.name, names, meshes, blendshapes, attributes=attributes, provenance=provenance)


def read_mesh(path: Path) -> MeshData:
    """Read an OBJ or PLY file by its suffix."""
    if path.suffix.lower() == ".ply":
        from facewright.io.ply import read_ply

        return read_ply(path)
    from facewright.io.obj import read_obj

    return read_obj(path)


def read_attributes(path: Path) -> dict[str, Any]:
    """Read a ``subject.json`` of attributes; empty where there is none.

    Raises
    ------
    StoreError, FileFormatError
        If it cannot be read or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        raise FileFormatError(f"{path} must be a JSON file of attributes, got {error}.") from error
    if not isinstance(content, dict) or not all(isinstance(value, str | int | float) for value in content.values()):
        raise FileFormatError(f"{path} must hold one JSON object of texts, numbers and truth values.")
    return content


def _read_blendshapes(
    folder: MeshFolder, topology: Topology, names: tuple[str, ...], scale: float, neutral: NDArray[np.float32]
) -> NDArray[np.float32] | None:
    if not folder.blendshapes:
        return None
    found = set(folder.blendshapes) - {"neutral"}
    if found != set(names):
        missing, extra = sorted(set(names) - found), sorted(found - set(names))
        what = f"without {missing[0]}" if missing else f"with {extra[0]} beside them"
        raise FileFormatError(
            f"{folder.path / BLENDSHAPE_FOLDER} must hold the {len(names)} blendshapes {names[0]} .. {names[-1]}, "
            f"got {len(found)}, {what}."
        )
    shapes = np.empty((len(names) + 1, topology.n_vertices, 3), dtype=np.float32)
    shapes[0] = neutral
    if "neutral" in folder.blendshapes:
        shapes[0] = scale * _positions(folder.blendshapes["neutral"], topology)
    for row, name in zip(shapes[1:], names):
        row[:] = scale * _positions(folder.blendshapes[name], topology)
    return shapes


def _positions(path: Path, topology: Topology) -> NDArray[np.floating[Any]]:
    mesh = read_mesh(path)
    check_topology(mesh, topology, path)
    return mesh.vertices


def _meshes(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in _entries(folder):
        if not _is_mesh(path):
            continue
        if path.stem in found:
            raise FileFormatError(
                f"{folder} must hold one mesh {path.stem}, got {found[path.stem].name} and {path.name}."
            )
        found[path.stem] = path
    return found


def _is_mesh(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES and path.is_file()


def _in_usual_order(expressions: Mapping[str, Path]) -> dict[str, Path]:
    from facewright.faces.expressions import EXPRESSION_NAMES

    rank = {name: k for k, name in enumerate(EXPRESSION_NAMES)}
    return dict(sorted(expressions.items(), key=lambda item: (rank.get(item[0], len(rank)), item[0])))


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise StoreError(f"{folder} must be a folder that can be read, got: {error.strerror or error}.") from error
