"""Write people of a warehouse as folders of files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from facewright.errors import StoreError
from facewright.numeric.check import check_choice

Progress = Callable[[str, int, int], None]
LAYOUTS = ("meshes", "facewarehouse")


@dataclass(frozen=True)
class ExportPeopleRequest:
    """Whom to export and how.

    Parameters
    ----------
    store : str
        Database.
    out : Path
        Folder for the people's folders.
    where : tuple of str
        Conditions on attributes, see `facewright.warehouse.query`.
    subjects : tuple of str
        Names; everybody where there are neither names nor conditions.
    layout : {"meshes", "facewarehouse"}
    mesh_format : {"obj", "ply"}
        For the layout of meshes.
    shape_names : str, optional
        Naming scheme of the shapes, for the layout of FaceWarehouse.
    pictures : bool
        Also write pictures.
    """

    store: str
    out: Path
    where: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    layout: str = "meshes"
    mesh_format: str = "obj"
    shape_names: str | None = None
    pictures: bool = True

    def __post_init__(self) -> None:
        check_choice("layout", self.layout, LAYOUTS)
        check_choice("mesh_format", self.mesh_format, ("obj", "ply"))


def export_people(request: ExportPeopleRequest, progress: Progress | None = None) -> list[Path]:
    """Export people; returns their folders.

    Raises
    ------
    StoreError
        If there is no such database or person, nobody meets the conditions, or a folder is there already.
    ValueRangeError
        If a condition or the naming scheme is wrong.
    """
    from facewright.warehouse.export import export_facewarehouse, export_mesh_folders
    from facewright.warehouse.store import Warehouse

    warehouse = Warehouse.open(request.store)
    names = warehouse.subject_names(request.where)
    for name in request.subjects:
        warehouse.entry(name)  # an unknown one is told before anything is written
    if request.subjects:
        names = [name for name in names if name in request.subjects]
    if not names:
        raise StoreError(f"{request.store} has nobody to export for these conditions.")
    if request.layout == "facewarehouse":
        return export_facewarehouse(
            warehouse,
            request.out,
            names,
            shape_names=request.shape_names,
            pictures=request.pictures,
            progress=progress,
        )
    return export_mesh_folders(
        warehouse, request.out, names, mesh_format=request.mesh_format, pictures=request.pictures, progress=progress
    )
