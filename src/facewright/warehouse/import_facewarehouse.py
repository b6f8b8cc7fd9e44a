"""FaceWarehouse's published folders as subjects (150 people, 20 poses, 47 shapes; no real file was at hand)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError, StoreError, TopologyError
from facewright.faces.blendshape_names import load_name_map, read_json
from facewright.faces.expressions import EXPRESSION_NAMES
from facewright.io.facewarehouse_bs import N_LAND_POINTS, read_bs, read_land
from facewright.io.mesh_data import MeshData
from facewright.mesh.topology import Topology
from facewright.numeric.similarity import Similarity, estimate_similarity
from facewright.warehouse.import_units import UNITS, unit_of
from facewright.warehouse.mesh_topology import check_topology
from facewright.warehouse.subject import Subject

N_SHAPES = 46
USUAL_PICTURE = (480, 640)  # (height, width) of a pose's picture, where the picture itself is not there
# A pose that was turned or moved by more than this against the blendshapes is moved back onto them.
LARGEST_TURN, LARGEST_SHIFT_MM = np.deg2rad(1.0), 5.0
_TESTER = re.compile(r"tester_?(\d+)", re.IGNORECASE)


def tester_shape_names(root: str | Path) -> tuple[str, ...]:
    """Return the names of the 46 shapes below `root`, in their order.

    They are FaceWarehouse's own, unless ``testers.json`` says others, as our export writes it.

    Raises
    ------
    StoreError, FileFormatError
        If there is such a file and it cannot be read or does not name 46 shapes.
    """
    path = Path(root) / "testers.json"
    if not path.is_file():
        return load_name_map("facewarehouse46").names
    content = read_json(path)
    names = content.get("shapes") if isinstance(content, dict) else None
    if not isinstance(names, list) or len({str(name) for name in names}) != N_SHAPES or len(names) != N_SHAPES:
        raise FileFormatError(f"{path} must name {N_SHAPES} different shapes under 'shapes'.")
    return tuple(str(name) for name in names)


def list_testers(root: str | Path) -> list[Path]:
    """Return the folders ``Tester_1 .. Tester_150`` below `root`, by number; empty where there are none.

    Raises
    ------
    StoreError
        If `root` cannot be read.
    """
    try:
        found = [path for path in Path(root).iterdir() if _TESTER.fullmatch(path.name) and path.is_dir()]
    except OSError as error:
        raise StoreError(f"{root} must be a folder that can be read, got: {error.strerror or error}.") from error
    return sorted(found, key=lambda path: (int(_TESTER.fullmatch(path.name)[1]), path.name))  # type: ignore[index]


def read_tester_mesh(tester: Path) -> MeshData:
    """Read the mesh that tells a person's topology: the neutral shape, or the neutral pose.

    Raises
    ------
    FileFormatError
        If there is neither.
    """
    from facewright.io.obj import read_obj

    for path in (tester / "Blendshape" / "shape_0.obj", tester / "TrainingPose" / "pose_0.obj"):
        if path.is_file():
            mesh = read_obj(path)
            if len(mesh.faces) == 0:
                raise FileFormatError(f"{path} must be a mesh with faces, got points alone.")
            return mesh
    raise FileFormatError(f"{tester} must hold Blendshape/shape_0.obj or TrainingPose/pose_0.obj, got neither.")


def read_tester(tester: Path, topology: Topology, *, unit: str = "auto", pictures: bool = True) -> Subject:
    """Read one person.

    Parameters
    ----------
    tester : Path
        ``Tester_<number>`` with ``TrainingPose`` and, maybe, ``Blendshape``.
    topology : Topology
        That all meshes must have.
    unit : {"auto", "mm", "cm", "dm", "m"}
        Of the meshes; by default the one that makes the neutral as large as a face.
    pictures : bool
        Also read the poses' pictures, where every pose has one of one size.

    Returns
    -------
    Subject
        Shapes are in FaceWarehouse's own order, see `tester_shape_names`; the provenance tells which poses were
        missing or had to be moved onto the blendshapes.

    Raises
    ------
    StoreError, FileFormatError
        If a file cannot be read or is damaged.
    TopologyError
        If a mesh is of another topology.

    Notes
    -----
    Poses whose landmarks or pictures are absent keep NaN or nothing there. A pose is moved rigidly where it lies off
    the blendshapes' neutral by more than 1 degree or 5 mm and comes at least twice as near by it, judged by the half of
    the vertices that move least.
    """
    shapes, source = _read_shapes(tester, topology)
    poses = _read_poses(tester, topology)
    if shapes is None and "neutral" not in poses:
        raise FileFormatError(f"{tester} must hold TrainingPose/pose_0.obj or Blendshape/shape.bs, got neither.")
    neutral = poses["neutral"] if shapes is None else shapes[0]
    unit = unit_of(neutral, unit, tester)
    scale = UNITS[unit]
    frame = np.asarray(neutral, dtype=np.float64) * scale
    moved: dict[str, Any] = {}
    meshes: dict[str, NDArray[Any]] = {}
    for name in EXPRESSION_NAMES:
        if name in poses:
            meshes[name], motion = _onto(frame, poses[name] * scale)
            if motion is not None:
                moved[name] = motion
        elif name == "neutral":
            meshes[name] = frame
    names = tuple(meshes)
    provenance = {
        "source": "FaceWarehouse",
        "folder": tester.name,
        "unit": unit,
        "blendshapes": source,
        "missing_poses": [name for name in EXPRESSION_NAMES if name not in poses],
        "moved_poses": moved,
    }
    color, size = _read_pictures(tester, names) if pictures else (None, USUAL_PICTURE)
    return Subject(
        name=tester.name,
        expressions=names,
        meshes=np.stack([meshes[name] for name in names]).astype(np.float32),
        blendshapes=None if shapes is None else (scale * shapes).astype(np.float32),
        color=color,
        landmarks=_read_landmarks(tester, names, size),
        provenance=provenance,
    )


def _pose(tester: Path, name: str, suffix: str) -> Path:
    return tester / "TrainingPose" / f"pose_{EXPRESSION_NAMES.index(name)}.{suffix}"


def _read_shapes(tester: Path, topology: Topology) -> tuple[NDArray[np.float32] | None, str]:
    """Read the 47 shapes from ``shape.bs`` or from 47 OBJ files; None where there are none."""
    folder = tester / "Blendshape"
    path = folder / "shape.bs"
    if path.is_file():
        found = read_bs(path)
        if found.shapes.shape != (N_SHAPES + 1, topology.n_vertices, 3):
            n, v = found.shapes.shape[0] - 1, found.shapes.shape[1]
            raise TopologyError(
                f"{path} must hold {N_SHAPES} shapes of {topology.n_vertices} vertices, got {n} of {v} vertices."
            )
        _compare_with_obj(path, folder / "shape_0.obj", found.shapes[0], topology)
        return found.shapes, "shape.bs"
    paths = [folder / f"shape_{k}.obj" for k in range(N_SHAPES + 1)]
    there = [path for path in paths if path.is_file()]
    if not there:
        return None, "none"
    missing = sorted(set(paths) - set(there))
    if missing:
        raise FileFormatError(f"{folder} must hold shape.bs or shape_0.obj .. shape_46.obj, got no {missing[0].name}.")
    return np.stack([_positions(path, topology) for path in paths]).astype(np.float32), "shape_*.obj"


def _compare_with_obj(bs: Path, obj: Path, neutral: NDArray[np.float32], topology: Topology) -> None:
    """Refuse a shape.bs that does not agree with the mesh beside it: its blocks would have another meaning."""
    if not obj.is_file():
        return
    positions = _positions(obj, topology)
    extent = float(np.ptp(positions, axis=0).max())
    difference = float(np.abs(positions - neutral).max())
    if not difference <= 1e-3 * extent:
        raise FileFormatError(
            f"{bs} must begin with the mesh of {obj.name}, got positions that differ by up to {difference:.3g} of "
            f"{extent:.3g}."
        )


def _read_poses(tester: Path, topology: Topology) -> dict[str, NDArray[Any]]:
    paths = {name: _pose(tester, name, "obj") for name in EXPRESSION_NAMES}
    return {name: _positions(path, topology) for name, path in paths.items() if path.is_file()}


def _positions(path: Path, topology: Topology) -> NDArray[Any]:
    from facewright.io.obj import read_obj

    mesh = read_obj(path)
    check_topology(mesh, topology, path)
    return mesh.vertices


def _onto(frame: NDArray[np.float64], pose: NDArray[Any]) -> tuple[NDArray[Any], dict[str, float] | None]:
    """Move a pose rigidly onto the neutral by the vertices that move least, where it lies elsewhere; mm."""
    still, distance = np.ones(len(frame), dtype=bool), np.empty(0)
    motion = Similarity(1.0, np.eye(3), np.zeros(3))
    for _ in range(5):
        motion = estimate_similarity(pose[still], frame[still], with_scale=False)
        distance = np.linalg.norm(motion.apply(pose) - frame, axis=1)
        still = distance <= np.median(distance)
    before = np.linalg.norm(pose - frame, axis=1)
    if np.median(distance) > 0.5 * np.median(before):  # a wide expression, not another frame
        return pose, None
    angle = float(np.arccos(np.clip((np.trace(motion.rotation) - 1) / 2, -1, 1)))
    centre = pose[still].mean(axis=0)
    shift = float(np.linalg.norm(motion.apply(centre) - centre))
    if angle <= LARGEST_TURN and shift <= LARGEST_SHIFT_MM:
        return pose, None
    return motion.apply(pose), {"degrees": round(float(np.rad2deg(angle)), 3), "mm": round(shift, 3)}


def _read_pictures(tester: Path, names: tuple[str, ...]) -> tuple[NDArray[np.uint8] | None, tuple[int, int]]:
    """Read the pictures if there is one of one size for every pose; also their size."""
    from facewright.io.image import read_image

    paths = [_pose(tester, name, "png") for name in names]
    there = [path for path in paths if path.is_file()]
    if not there:
        return None, USUAL_PICTURE
    pictures = [read_image(path) for path in there]
    size = pictures[0].shape[0], pictures[0].shape[1]
    if len(there) < len(paths) or any(picture.shape != pictures[0].shape for picture in pictures):
        return None, size
    return np.stack(pictures), size


def _read_landmarks(tester: Path, names: tuple[str, ...], size: tuple[int, int]) -> NDArray[np.float64] | None:
    points = np.full((len(names), N_LAND_POINTS, 2), np.nan)
    for row, name in zip(points, names):
        path = _pose(tester, name, "land")
        if path.is_file():
            row[:] = read_land(path, size)
    return points if np.isfinite(points).any() else None


def looks_like_facewarehouse(root: str | Path) -> bool:
    """Tell whether a folder holds FaceWarehouse's folders."""
    try:
        testers = list_testers(root)
    except FacewrightError:
        return False
    return any((tester / part).is_dir() for tester in testers[:3] for part in ("TrainingPose", "Blendshape"))
