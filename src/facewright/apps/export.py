"""Export a rig: glTF with named morph targets, or one OBJ per shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.apps.rig_clip import RigClip, split_pieces
from facewright.errors import ValueRangeError
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

if TYPE_CHECKING:
    from facewright.io.gltf import GltfMesh

Progress = Callable[[str, int, int], None]

# Transparent films of ICT-FaceKit: without their own shaders they would hide the eyes.
OVERLAY_PARTS = ("eye_occlusion", "eye_blend", "lacrimal", "eyelashes")
# Linear base colour and roughness of each material where no vertex colours are given.
LOOKS: dict[str, tuple[tuple[float, float, float], float]] = {
    "skin": ((0.60, 0.36, 0.27), 0.55),
    "eyes": ((0.80, 0.78, 0.76), 0.15),
    "teeth": ((0.72, 0.66, 0.54), 0.30),
    "mouth": ((0.32, 0.08, 0.07), 0.50),
}
SMALLEST_MOVE_MM = 1e-3


class Rig(Protocol):
    """What can be exported: a neutral with named displacements, such as a `BlendshapeRig`."""

    @property
    def neutral(self) -> NDArray[np.floating[Any]]:
        """Positions (V, 3), millimetres."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the B shapes."""

    @property
    def deltas(self) -> NDArray[np.floating[Any]]:
        """Displacements (B, V, 3), millimetres."""


@dataclass(frozen=True, eq=False)
class ExportRequest:
    """What to export and how.

    Parameters
    ----------
    rig : Rig
        Neutral and named displacements.
    topology : Topology
        Of the rig; its parts choose the materials.
    out : Path
        ``.glb`` or ``.gltf``: one file. ``.obj`` or a folder: neutral and one OBJ per shape, in that folder.
    names : str or Path
        ``"facewright"`` keeps the rig's names; ``"arkit52"``, ``"facewarehouse46"`` or a map file renames and mixes the
        shapes by that map.
    texture : ndarray of shape (H, W, 3), uint8, optional
        Picture for the skin, laid out by the topology's uv.
    vertex_colors : ndarray of shape (V, 3), uint8, optional
        sRGB colours; on the skin only where there is no texture.
    clip : RigClip, optional
        Motion; `demo_clip` makes one.
    weights : ndarray of shape (B,), optional
        Weights of the rig's own shapes at which a glTF stands when it is opened; neutral where absent.
    image_format : {"jpeg", "png"}
        How a texture is stored in glTF.
    copyright : str
        Licence line of the file.
    """

    rig: Rig
    topology: Topology
    out: Path
    names: str | Path = "facewright"
    texture: NDArray[np.uint8] | None = None
    vertex_colors: NDArray[np.uint8] | None = None
    clip: RigClip | None = None
    weights: NDArray[np.floating[Any]] | None = None
    image_format: str = "jpeg"
    copyright: str = ""


@dataclass(frozen=True)
class ExportResult:
    """What was written.

    Parameters
    ----------
    paths : tuple of Path
        Files, the main one first.
    shape_names : tuple of str
        Names of the morph targets, in the file's order.
    n_vertices, n_faces : int
        Size of the mesh.
    n_bytes : int
        Size of all files together.
    empty_shapes : tuple of str
        Those of `shape_names` that move nothing, because the rig has nothing for them, such as ARKit's tongue and gaze.
    """

    paths: tuple[Path, ...]
    shape_names: tuple[str, ...]
    n_vertices: int
    n_faces: int
    n_bytes: int
    empty_shapes: tuple[str, ...] = ()


def export_rig(request: ExportRequest, progress: Progress | None = None) -> ExportResult:
    """Write a rig to glTF or to a folder of OBJ files.

    Parameters
    ----------
    request : ExportRequest
        What and how.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    ExportResult
        Files and sizes.

    Raises
    ------
    ShapeError
        If rig, topology, texture or colours do not fit each other.
    ValueRangeError
        If the naming scheme or a suffix is unknown, or the scheme needs shapes that the rig lacks.
    StoreError
        If a file cannot be written.
    """
    rig, topology = request.rig, request.topology
    V = topology.n_vertices
    check_shape("rig.neutral", rig.neutral, V, 3)
    check_shape("rig.deltas", rig.deltas, len(rig.names), V, 3)
    if request.vertex_colors is not None:
        check_shape("vertex_colors", request.vertex_colors, V, 3)
    if request.texture is not None and topology.uv is None:
        raise ValueRangeError(f"texture must have a topology with uv, got {topology.name!r} without.")
    if request.weights is not None:
        check_shape("weights", request.weights, len(rig.names))
    names, deltas, mix = _renamed(rig, request.names)
    suffix = request.out.suffix.lower()
    if suffix in (".glb", ".gltf"):
        return replace(_export_gltf(request, names, deltas, mix, progress), empty_shapes=_empty(names, deltas))
    if suffix not in ("", ".obj") or request.out.is_file():
        raise ValueRangeError(f"out must be a .glb or .gltf file or a folder for OBJ files, got {request.out}.")
    return replace(_export_obj_folder(request, names, deltas, progress), empty_shapes=_empty(names, deltas))


def demo_clip(names: tuple[str, ...], seconds_each: float = 1.2) -> RigClip:
    """Make a clip that goes through named expressions while the head turns a little.

    Parameters
    ----------
    names : tuple of str
        Shapes of the rig; those that the expressions need and the rig lacks stay still.
    seconds_each : float
        Time from one neutral to the next.
    """
    from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
    from facewright.faces.expressions import expression_weights

    acts = ("smile", "brow_raiser", "mouth_stretch", "anger", "lip_puckerer", "grin", "sadness", "eyes_closed")
    column = {name: i for i, name in enumerate(names)}
    times, weights = [0.0], [np.zeros(len(names))]
    for k, act in enumerate(acts):
        pose = np.zeros(len(names))
        for name, weight in zip(BLENDSHAPE_NAMES, expression_weights(act)):
            if name in column:
                pose[column[name]] = weight
        for share, amount in ((0.35, 1.0), (0.7, 1.0), (1.0, 0.0)):  # in, hold, out
            times.append((k + share) * seconds_each)
            weights.append(amount * pose)
    yaw = np.deg2rad(14.0) * np.sin(2 * np.pi * np.array(times) / times[-1])
    rotation = np.stack([np.cos(yaw / 2), 0 * yaw, np.sin(yaw / 2), 0 * yaw], axis=1)
    return RigClip("expressions", np.array(times), np.array(weights), rotation)


def face_looks(topology: Topology) -> tuple[tuple[str, ...], NDArray[np.int32]]:
    """Choose a look for every triangle by the part it lies in.

    Returns
    -------
    names : tuple of str
        Looks that occur, of `LOOKS`, skin first.
    index : ndarray of shape (F,), int32
        Index into `names`; -1 for transparent films that are not exported.
    """
    look_of_vertex = np.zeros(topology.n_vertices, dtype=np.int32)
    order = list(LOOKS)
    for part, (start, stop) in topology.parts.items():
        look_of_vertex[start:stop] = -1 if part.startswith(OVERLAY_PARTS) else order.index(_look(part))
    index = look_of_vertex[topology.faces[:, 0]]
    used = [i for i in range(len(order)) if (index == i).any()]
    renumber = np.full(len(order) + 1, -1, dtype=np.int32)
    renumber[used] = np.arange(len(used))
    return tuple(order[i] for i in used), renumber[index]


def _look(part: str) -> str:
    if "socket" in part or "gum" in part or "tongue" in part or "cavity" in part or part.startswith("mouth"):
        return "mouth"
    if "teeth" in part:
        return "teeth"
    return "eyes" if "eye" in part and "lid" not in part else "skin"


def _renamed(rig: Rig, scheme: str | Path) -> tuple[tuple[str, ...], NDArray[Any], NDArray[np.float64] | None]:
    """Apply a naming map: names, displacements, and the matrix (N, B) that turns the rig's weights into theirs."""
    if scheme == "facewright":
        return tuple(rig.names), rig.deltas, None
    from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, load_name_map

    chart = load_name_map(scheme)
    missing = sorted(set(BLENDSHAPE_NAMES) - set(rig.names))
    if missing:
        raise ValueRangeError(f"names {scheme} must have a rig with the 46 shapes, got one without {missing[0]}.")
    rows = [tuple(rig.names).index(name) for name in BLENDSHAPE_NAMES]
    deltas = np.tensordot(chart.to_ours.T.astype(np.float32), rig.deltas[rows], axes=1)
    mix = np.zeros((len(chart.names), len(rig.names)))
    mix[:, rows] = chart.from_ours
    return chart.names, deltas, mix


def _empty(names: tuple[str, ...], deltas: NDArray[Any]) -> tuple[str, ...]:
    return tuple(name for name, delta in zip(names, deltas) if not (np.abs(delta) >= SMALLEST_MOVE_MM).any())


def _export_gltf(
    request: ExportRequest,
    names: tuple[str, ...],
    deltas: NDArray[Any],
    mix: NDArray[np.float64] | None,
    progress: Progress | None,
) -> ExportResult:
    from facewright.io.gltf import GltfAnimation, GltfMesh, GltfScene, write_gltf
    from facewright.mesh.normals import vertex_normals

    topology = request.topology
    looks, index = face_looks(topology)
    shown = index >= 0
    faces = topology.faces[shown]
    n = int(faces.max(initial=-1)) + 1
    neutral = np.asarray(request.rig.neutral[:n], dtype=np.float64)
    normals = vertex_normals(neutral, faces)
    moves = np.where(np.abs(deltas[:, :n]) < SMALLEST_MOVE_MM, 0, deltas[:, :n]).astype(np.float32)
    turns = np.zeros_like(moves)
    for b in range(len(names)):
        if moves[b].any():
            turns[b] = vertex_normals(neutral + moves[b], faces) - normals
        if progress is not None:
            progress("shading shapes", b + 1, len(names))
    turns[np.abs(turns) < 1e-4] = 0
    mesh = GltfMesh(
        name=topology.name,
        vertices=neutral,
        faces=faces,
        materials=_materials(looks, request),
        face_materials=index[shown],
        uv=topology.uv,
        uv_faces=None if topology.uv is None or topology.uv_faces is None else topology.uv_faces[shown],
        normals=normals,
        vertex_colors=_colors(request, n),
        morph_names=names,
        morph_deltas=moves if names else None,
        morph_normals=turns if names else None,
        weights=request.weights if mix is None or request.weights is None else mix @ request.weights,
    )
    meshes: tuple[GltfMesh, ...] = (mesh,)
    animations: list[GltfAnimation] = []
    if request.clip is not None:
        clip = request.clip
        check_shape("clip.weights", clip.weights, len(clip.times), len(request.rig.names))
        weights = clip.weights if mix is None else clip.weights @ mix.T
        if clip.curves:
            mesh = _with_still_shapes(mesh, tuple(clip.curves))
            weights = np.concatenate([weights, np.stack(list(clip.curves.values()), axis=1)], axis=1)
        meshes = split_pieces(mesh, clip.pieces)
        animations.append(GltfAnimation(clip.name, clip.times, 0, weights, clip.rotation_wxyz, clip.translation))
        for number, piece in enumerate(clip.pieces, 1):
            animations.append(GltfAnimation(clip.name, clip.times, number, rotation_wxyz=piece.rotation_wxyz))
    scene = GltfScene(meshes, tuple(animations), copyright=request.copyright)
    write_gltf(request.out, scene, image_format=request.image_format)
    return ExportResult((request.out,), names, n, len(faces), request.out.stat().st_size)


def _with_still_shapes(mesh: GltfMesh, names: tuple[str, ...]) -> GltfMesh:
    """Return the mesh with further shapes that move nothing."""
    still = np.zeros((len(names), len(mesh.vertices), 3), np.float32)
    deltas, turns = (
        still if v is None else np.concatenate([v, still]) for v in (mesh.morph_deltas, mesh.morph_normals)
    )
    weights = None if mesh.weights is None else np.concatenate([mesh.weights, np.zeros(len(names))])
    all_names = (*mesh.morph_names, *names)
    return replace(mesh, morph_names=all_names, morph_deltas=deltas, morph_normals=turns, weights=weights)


def _materials(looks: tuple[str, ...], request: ExportRequest) -> tuple[Any, ...]:
    from facewright.io.gltf import GltfMaterial

    materials = []
    for look in looks:
        (r, g, b), roughness = LOOKS[look]
        texture = request.texture if look == "skin" else None
        painted = texture is not None or request.vertex_colors is not None
        color = (1.0, 1.0, 1.0, 1.0) if painted else (r, g, b, 1.0)
        materials.append(GltfMaterial(look, color, texture, roughness=roughness))
    return tuple(materials)


def _colors(request: ExportRequest, n: int) -> NDArray[np.uint8] | None:
    """Give the vertex colours, white on the skin where a texture covers it."""
    if request.vertex_colors is None:
        return None
    colors = request.vertex_colors[:n].copy()
    if request.texture is not None:
        looks, index = face_looks(request.topology)
        skin = request.topology.faces[index == looks.index("skin")] if "skin" in looks else np.empty(0, np.int32)
        colors[np.unique(skin[skin < n])] = 255
    return colors


def _export_obj_folder(
    request: ExportRequest, names: tuple[str, ...], deltas: NDArray[Any], progress: Progress | None
) -> ExportResult:
    from facewright.io.atomic import write_set_atomically
    from facewright.io.image import write_image
    from facewright.io.obj import write_obj
    from facewright.mesh.polygon_uv import polygon_uv

    folder = request.out.parent if request.out.suffix.lower() == ".obj" else request.out
    first = request.out.name if request.out.suffix.lower() == ".obj" else "neutral.obj"
    for name in names:
        if not name or name.startswith(".") or "/" in name or "\\" in name:
            raise ValueRangeError(f"names must be usable as file names, got {name!r}.")
    topology = request.topology
    faces, uv_faces = topology.faces, topology.uv_faces
    if topology.quads is not None:
        corners = None if uv_faces is None else polygon_uv(topology.quads, faces, uv_faces)
        if uv_faces is None or corners is not None:
            faces, uv_faces = topology.quads, corners
    files = [f"{name}.obj" if name else first for name in ("", *names)]
    texture = None if request.texture is None else "texture.png"
    with write_set_atomically(folder) as temporary:
        if request.texture is not None:
            write_image(temporary / "texture.png", request.texture)
        for k, name in enumerate(("", *names)):
            write_obj(
                temporary / files[k],
                request.rig.neutral if not name else request.rig.neutral + deltas[k - 1],
                faces,
                uv=topology.uv,
                uv_faces=uv_faces if topology.uv is not None else None,
                vertex_colors=request.vertex_colors if texture is None else None,
                texture=texture,
                comment=f"facewright: {name or 'neutral'}, millimetres\n{request.copyright}",
            )
            if progress is not None:
                progress("writing shapes", k + 1, len(names) + 1)
    paths = [folder / file for file in files] + ([folder / texture] if texture else [])
    n_bytes = sum(path.stat().st_size for path in paths)
    return ExportResult(tuple(paths), names, topology.n_vertices, len(faces), n_bytes)
