"""Subjects as folders of files: plain meshes, or laid out as FaceWarehouse publishes its own."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import StoreError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, load_name_map
from facewright.faces.expressions import EXPRESSION_NAMES
from facewright.io.facewarehouse_bs import write_bs, write_land
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_choice
from facewright.warehouse.import_mesh_folders import BLENDSHAPE_FOLDER
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

Progress = Callable[[str, int, int], None]
MESH_FORMATS = ("obj", "ply")


def export_mesh_folders(
    warehouse: Warehouse,
    out: Path,
    names: Sequence[str],
    *,
    mesh_format: str = "obj",
    pictures: bool = True,
    progress: Progress | None = None,
) -> list[Path]:
    """Write each subject as ``OUT/<subject>/<expression>.obj``, ``blendshapes/<name>.obj`` and ``subject.json``.

    Importing the folders again gives the same meshes, bit by bit.

    Parameters
    ----------
    warehouse : Warehouse
    out : Path
        Folder; made where it does not exist.
    names : sequence of str
        Subjects.
    mesh_format : {"obj", "ply"}
    pictures : bool
        Also write the reference frames' pictures as ``<expression>.png``, where there are any.
    progress : callable(stage, done, total), optional

    Returns
    -------
    list of Path
        The subjects' folders. Each appears whole or not at all.

    Raises
    ------
    StoreError
        If a subject or its folder is there already, or something cannot be written.
    """
    check_choice("mesh_format", mesh_format, MESH_FORMATS)
    topology = warehouse.topology
    folders = []
    for done, name in enumerate(names):
        subject = warehouse.read_subject(name, fields=("blendshapes", "color") if pictures else ("blendshapes",))
        with _whole_folder(out / name) as folder:
            for expression, vertices in zip(subject.expressions, subject.meshes):
                _write_mesh(folder / f"{_file_name(expression)}.{mesh_format}", vertices, topology)
            if subject.blendshapes is not None:
                (folder / BLENDSHAPE_FOLDER).mkdir()
                for shape, vertices in zip(warehouse.blendshape_names, subject.blendshapes):
                    _write_mesh(folder / BLENDSHAPE_FOLDER / f"{_file_name(shape)}.{mesh_format}", vertices, topology)
            if subject.color is not None:
                _write_pictures(subject, {e: folder / f"{_file_name(e)}.png" for e in subject.expressions})
            _write_json(folder / "subject.json", subject.attributes)
            _write_json(folder / "provenance.json", subject.provenance)
        folders.append(out / name)
        if progress is not None:
            progress("exporting subjects", done + 1, len(names))
    return folders


def export_facewarehouse(
    warehouse: Warehouse,
    out: Path,
    names: Sequence[str],
    *,
    shape_names: str | Path | None = None,
    pictures: bool = True,
    progress: Progress | None = None,
) -> list[Path]:
    """Write each subject as FaceWarehouse does: ``Tester_<number>/TrainingPose/pose_<k>.obj``, ``Blendshape/shape.bs``.

    Parameters
    ----------
    warehouse : Warehouse
    out : Path
        Folder; made where it does not exist. ``testers.json`` there tells whose each number is, and the shapes' names.
    names : sequence of str
        Subjects; the first becomes ``Tester_1``.
    shape_names : str or Path, optional
        Naming scheme, such as ``"facewarehouse46"``, into which the shapes are mixed by its map; by default they are
        written as they are.
    pictures : bool
        Also write pictures, where there are any; landmarks (``.land``) are written where a pose has all 74.
    progress : callable(stage, done, total), optional

    Returns
    -------
    list of Path
        The subjects' folders. Each appears whole or not at all.

    Raises
    ------
    StoreError
        If a subject or its folder is there already, or something cannot be written.
    ValueRangeError
        If the naming scheme does not start from the shapes of this database.
    """
    topology = warehouse.topology
    mix, written_names = _shape_mix(warehouse, shape_names)
    polygons = topology.faces if topology.quads is None else topology.quads
    fields = ("blendshapes", "landmarks", "color", "intrinsics")
    folders = []
    for done, name in enumerate(names):
        subject = warehouse.read_subject(name, fields=fields)
        with _whole_folder(out / f"Tester_{done + 1}") as folder:
            (folder / "TrainingPose").mkdir()
            _write_poses(subject, folder / "TrainingPose", topology, pictures)
            if subject.blendshapes is not None:
                shapes = subject.blendshapes
                if mix is not None:
                    deltas = np.tensordot(mix, shapes[1:].astype(np.float64) - shapes[0], axes=1)
                    shapes = np.concatenate([shapes[:1], (shapes[0] + deltas).astype(np.float32)])
                (folder / "Blendshape").mkdir()
                write_bs(folder / "Blendshape" / "shape.bs", shapes, len(polygons))
                for k, vertices in enumerate(shapes):
                    _write_mesh(folder / "Blendshape" / f"shape_{k}.obj", vertices, topology)
        folders.append(out / f"Tester_{done + 1}")
        if progress is not None:
            progress("exporting subjects", done + 1, len(names))
    testers = {f"Tester_{k + 1}": name for k, name in enumerate(names)}
    _write_json(out / "testers.json", {"testers": testers, "shapes": list(written_names), "unit": "mm"})
    return folders


def _shape_mix(
    warehouse: Warehouse, shape_names: str | Path | None
) -> tuple[NDArray[np.float64] | None, tuple[str, ...]]:
    """Return the matrix that turns the database's displacements into those of a naming scheme, and their names."""
    own = warehouse.blendshape_names[1:]
    if shape_names is None:
        return None, own
    chart = load_name_map(shape_names)
    if own == chart.names:
        return None, own
    if own != BLENDSHAPE_NAMES:
        raise ValueRangeError(
            f"shape_names {shape_names} must start from shapes {BLENDSHAPE_NAMES[0]} .. {BLENDSHAPE_NAMES[-1]}, got "
            f"a database with {own[0]} .. {own[-1]}."
        )
    if len(chart.names) != len(own):
        raise ValueRangeError(f"shape_names must be a scheme of {len(own)} shapes, got one of {len(chart.names)}.")
    return chart.to_ours.T, chart.names


def _write_poses(subject: Subject, folder: Path, topology: Topology, pictures: bool) -> None:
    for k, expression in enumerate(EXPRESSION_NAMES):
        if expression not in subject.expressions:
            continue
        row = subject.expressions.index(expression)
        _write_mesh(folder / f"pose_{k}.obj", subject.meshes[row], topology)
        if subject.color is None:
            continue
        if pictures:
            _write_pictures(subject, {expression: folder / f"pose_{k}.png"})
        if subject.landmarks is not None and np.isfinite(subject.landmarks[row]).all():
            height, width = subject.color.shape[1:3]
            write_land(folder / f"pose_{k}.land", subject.landmarks[row], (height, width))


def _write_pictures(subject: Subject, paths: dict[str, Path]) -> None:
    from facewright.io.image import write_image

    assert subject.color is not None
    for expression, path in paths.items():
        write_image(path, subject.color[subject.expressions.index(expression)])


def _write_mesh(path: Path, vertices: NDArray[np.float32], topology: Topology) -> None:
    faces, uv_faces = topology.faces, topology.uv_faces
    if topology.quads is not None:
        from facewright.mesh.polygon_uv import polygon_uv

        faces = topology.quads
        uv_faces = None if uv_faces is None else polygon_uv(topology.quads, topology.faces, uv_faces)
    if path.suffix == ".ply":
        from facewright.io.ply import write_ply

        write_ply(path, vertices, faces)
        return
    from facewright.io.obj import write_obj

    has_uv = topology.uv is not None and uv_faces is not None
    write_obj(path, vertices, faces, uv=topology.uv if has_uv else None, uv_faces=uv_faces if has_uv else None)


def _write_json(path: Path, content: object) -> None:
    from facewright.io.atomic import write_atomically

    with write_atomically(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _file_name(name: str) -> str:
    if not name or name.startswith(".") or any(c in name for c in "/\\:\0"):
        raise ValueRangeError(f"expression must be usable as a file name to be exported, got {name!r}.")
    return name


@contextmanager
def _whole_folder(target: Path) -> Iterator[Path]:
    """Yield a folder that becomes `target` at the end, or vanishes."""
    if target.exists():
        raise StoreError(f"{target} must not be there yet; export to another folder or remove it.")
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(6)}.part")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        temporary.rename(target)
    except StoreError as error:
        raise StoreError(str(error).replace(str(temporary), str(target))) from error
    except OSError as error:
        raise StoreError(f"{target} cannot be written: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
