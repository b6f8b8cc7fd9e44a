"""Bring people from other databases into a warehouse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from facewright.errors import FacewrightError, StoreError, TopologyError
from facewright.numeric.check import check_choice

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.io.mesh_data import MeshData
    from facewright.mesh.topology import Topology
    from facewright.warehouse.store import Warehouse
    from facewright.warehouse.subject import Subject

Progress = Callable[[str, int, int], None]
LAYOUTS = ("auto", "facewarehouse", "meshes")


@dataclass(frozen=True)
class ImportRequest:
    """What to import.

    Parameters
    ----------
    folder : Path
        ``Tester_1 ..`` of FaceWarehouse, or one folder of meshes for each person.
    store : str
        Database, made where there is none.
    layout : {"auto", "facewarehouse", "meshes"}
        How `folder` is laid out.
    face : str, optional
        Face whose topology a new database gets; by default that of the first mesh, with the masks and landmarks of an
        installed face where it is the same.
    unit : {"auto", "mm", "cm", "dm", "m"}
        Of the files.
    pictures : bool
        Also take pictures.
    overwrite : bool
        Replace subjects that are there; otherwise they stay as they are.
    """

    folder: Path
    store: str
    layout: str = "auto"
    face: str | None = None
    unit: str = "auto"
    pictures: bool = True
    overwrite: bool = False

    def __post_init__(self) -> None:
        check_choice("layout", self.layout, LAYOUTS)


@dataclass(frozen=True)
class ImportReport:
    """What became of the people.

    Parameters
    ----------
    layout : str
        How the folder was laid out.
    imported, already_there : tuple of str
        Subjects written, and those that were in the database before.
    failed : dict of str to str
        Reasons, by subject; the database keeps them, too.
    """

    layout: str
    imported: tuple[str, ...] = ()
    already_there: tuple[str, ...] = ()
    failed: dict[str, str] = field(default_factory=dict)


def import_people(request: ImportRequest, progress: Progress | None = None) -> ImportReport:
    """Import every person of a folder; one that cannot be read is recorded and stops nobody else.

    Parameters
    ----------
    request : ImportRequest
    progress : callable(stage, done, total), optional

    Raises
    ------
    StoreError
        If the folder cannot be read or the database cannot be written.
    FileFormatError
        If the folder is laid out in no known way, or holds no mesh from which a new database could take its topology.
    TopologyError
        If the meshes are not of the face that was asked for.
    """
    from facewright.warehouse.import_facewarehouse import list_testers, looks_like_facewarehouse
    from facewright.warehouse.import_mesh_folders import list_mesh_folders

    layout = request.layout
    if layout == "auto":
        layout = "facewarehouse" if looks_like_facewarehouse(request.folder) else "meshes"
    folders = list_testers(request.folder) if layout == "facewarehouse" else list_mesh_folders(request.folder)
    if not folders:
        raise StoreError(f"{request.folder} must hold folders Tester_1, Tester_2 ..., got none.")
    warehouse = _store(request, layout, folders)
    there = set(warehouse.subject_names())
    imported, already, failed = [], [], {}
    for done, folder in enumerate(folders):
        if folder.name in there and not request.overwrite:
            already.append(folder.name)
        else:
            try:
                subject = _read(request, layout, folder, warehouse)
            except FacewrightError as error:
                warehouse.record_failure(folder.name, str(error), type(error).__name__)
                failed[folder.name] = str(error)
            else:
                warehouse.write_subject(subject, overwrite=request.overwrite)
                imported.append(folder.name)
        if progress is not None:
            progress("importing people", done + 1, len(folders))
    return ImportReport(layout, tuple(imported), tuple(already), failed)


def _read(request: ImportRequest, layout: str, folder: Path, warehouse: Warehouse) -> Subject:
    if layout == "facewarehouse":
        from facewright.warehouse.import_facewarehouse import read_tester

        return read_tester(folder, warehouse.topology, unit=request.unit, pictures=request.pictures)
    from facewright.warehouse.import_mesh_folders import open_mesh_folder, read_mesh_subject

    return read_mesh_subject(
        open_mesh_folder(folder), warehouse.topology, warehouse.blendshape_names[1:], unit=request.unit
    )


def _store(request: ImportRequest, layout: str, folders: list[Path]) -> Warehouse:
    """Open the database, or make one for the topology of the first person who has a readable mesh."""
    from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
    from facewright.warehouse.import_facewarehouse import tester_shape_names
    from facewright.warehouse.layout import ROOT
    from facewright.warehouse.objects import open_objects
    from facewright.warehouse.store import Warehouse

    if open_objects(request.store).get([ROOT])[0] is not None:
        warehouse = Warehouse.open(request.store, "a")
        if layout == "facewarehouse":
            _check_shapes(warehouse, tester_shape_names(request.folder), request.folder)
        return warehouse
    face = _face_of(request, layout, folders)
    theirs = tester_shape_names(request.folder)
    names = theirs if layout == "facewarehouse" or _has_shapes(folders, theirs) else BLENDSHAPE_NAMES
    return Warehouse.create(request.store, face, blendshape_names=names, exist_ok=True)


def _check_shapes(warehouse: Warehouse, names: tuple[str, ...], folder: Path) -> None:
    """Refuse shapes of other meanings: in one tensor they would be mixed up, row by row."""
    found = warehouse.blendshape_names[1:]
    if found != names:
        k = next(k for k, pair in enumerate(zip(found, names)) if pair[0] != pair[1])
        raise TopologyError(
            f"{folder} must hold the shapes of the database {warehouse.url}, whose shape {k + 1} is {found[k]}, got "
            f"{names[k]}; import into a database of its own."
        )


def _face_of(request: ImportRequest, layout: str, folders: list[Path]) -> Face | Topology:
    from facewright.faces import load_face
    from facewright.warehouse.mesh_topology import check_topology, find_face, same_topology, topology_of_mesh

    mesh, path = _first_mesh(layout, folders)
    if request.face is None:
        return find_face(mesh) or topology_of_mesh(mesh, layout)
    face = load_face(request.face)
    if not same_topology(mesh, face.topology) and same_topology(mesh, face.skin().topology):
        return face.skin()
    check_topology(mesh, face.topology, path, what="the face's")
    return face


def _has_shapes(folders: list[Path], names: tuple[str, ...]) -> bool:
    """Tell whether the first folder of meshes with blendshapes has those of these names."""
    from facewright.warehouse.import_mesh_folders import open_mesh_folder

    for folder in folders:
        try:
            found = set(open_mesh_folder(folder).blendshapes) - {"neutral"}
        except FacewrightError:
            continue
        if found:
            return found == set(names)
    return False


def _first_mesh(layout: str, folders: list[Path]) -> tuple[MeshData, Path]:
    from facewright.warehouse.import_facewarehouse import read_tester_mesh
    from facewright.warehouse.import_mesh_folders import open_mesh_folder, read_mesh

    first: FacewrightError | None = None
    for folder in folders:
        try:
            if layout == "facewarehouse":
                return read_tester_mesh(folder), folder
            path = open_mesh_folder(folder).expressions["neutral"]
            return read_mesh(path), path
        except FacewrightError as error:
            first = first or error
    assert first is not None
    raise first
