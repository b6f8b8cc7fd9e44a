"""Writing glTF: meshes are split where materials and texture seams need it, and can be put together again."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.io.gltf_buffers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, BufferWriter, pack_document
from facewright.io.gltf_scene import GltfAnimation, GltfMaterial, GltfMesh, GltfScene

SOURCE_ATTRIBUTE = "_SOURCE_VERTEX"
MM_PER_METRE = 1000.0


def write_gltf(path: str | Path, scene: GltfScene, *, image_format: str = "png", sparse: bool = True) -> None:
    """Write a scene as .glb (binary) or .gltf (one JSON file with everything embedded), whole.

    Parameters
    ----------
    path : str or Path
        Ends in .glb or .gltf.
    scene : GltfScene
        Meshes, materials, animations, in millimetres; written in metres.
    image_format : {"png", "jpeg"}
        How textures are stored; JPEG loses a little and is about ten times smaller.
    sparse : bool
        Store only the vertices that a morph target moves, where that is smaller.

    Raises
    ------
    ValueRangeError
        If the suffix or `image_format` is unknown.
    StoreError
        If the file cannot be written.

    Notes
    -----
    glTF has one index per corner for position and texture, and one material per primitive, so vertices on seams and
    between materials are duplicated and triangles are grouped by material. The attribute ``_SOURCE_VERTEX`` keeps the
    vertex that each comes from; `read_gltf` uses it to give the original vertices in the original order.
    """
    path = Path(path)
    if path.suffix.lower() not in (".glb", ".gltf"):
        raise ValueRangeError(f"path must end in .glb or .gltf, got {path.name!r}.")
    if image_format not in ("png", "jpeg"):
        raise ValueRangeError(f"image_format must be png or jpeg, got {image_format!r}.")
    data = _SceneWriter(scene, image_format, sparse).serialise(binary=path.suffix.lower() == ".glb")
    with write_atomically(path) as temporary:
        temporary.write_bytes(data)


class _SceneWriter:
    def __init__(self, scene: GltfScene, image_format: str, sparse: bool) -> None:
        self.scene = scene
        self.image_format = image_format
        self.sparse = sparse
        self.buffer = BufferWriter()
        self.images: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.material_index: dict[int, int] = {}
        self.times: dict[bytes, int] = {}

    def serialise(self, *, binary: bool) -> bytes:
        from facewright import __version__

        meshes = [self._mesh(mesh) for mesh in self.scene.meshes]
        animations = self._animations()
        asset = {"version": "2.0", "generator": f"facewright {__version__}"}
        if self.scene.copyright:
            asset["copyright"] = self.scene.copyright
        document: dict[str, Any] = {
            "asset": asset,
            "scene": 0,
            "scenes": [{"nodes": [i for i, mesh in enumerate(self.scene.meshes) if mesh.parent is None]}],
            "nodes": [self._node(i) for i in range(len(meshes))],
            "meshes": meshes,
            "accessors": self.buffer.accessors,
            "bufferViews": self.buffer.views,
        }
        if self.materials:
            document["materials"] = self.materials
        if self.images:
            document["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}]
            document["images"] = self.images
            document["textures"] = [{"source": i, "sampler": 0} for i in range(len(self.images))]
        if animations:
            document["animations"] = animations
        if self.scene.extras:
            document["extras"] = dict(self.scene.extras)
        return pack_document(document, bytes(self.buffer.data), binary=binary)

    def _node(self, index: int) -> dict[str, Any]:
        mesh = self.scene.meshes[index]
        node: dict[str, Any] = {"mesh": index, "name": mesh.name}
        origin = _pivot(mesh) - (np.zeros(3) if mesh.parent is None else _pivot(self.scene.meshes[mesh.parent]))
        if origin.any():
            node["translation"] = (origin / MM_PER_METRE).tolist()
        children = [i for i, other in enumerate(self.scene.meshes) if other.parent == index]
        return node | ({"children": children} if children else {})

    def _mesh(self, mesh: GltfMesh) -> dict[str, Any]:
        owner = np.zeros(len(mesh.faces), np.int64) if mesh.face_materials is None else mesh.face_materials
        primitives = []
        loose = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.faces)
        for number in np.unique(owner):
            primitives.append(self._primitive(mesh, np.flatnonzero(owner == number), int(number), loose))
            loose = loose[:0]  # vertices of no triangle go with the first primitive
        entry: dict[str, Any] = {"name": mesh.name, "primitives": primitives}
        if mesh.morph_names:
            entry["extras"] = {"targetNames": list(mesh.morph_names)}
            rest = np.zeros(len(mesh.morph_names)) if mesh.weights is None else mesh.weights
            entry["weights"] = np.asarray(rest, dtype=np.float32).tolist()
        return entry

    def _primitive(
        self, mesh: GltfMesh, rows: NDArray[np.int64], material: int, loose: NDArray[np.int64]
    ) -> dict[str, Any]:
        uv_corners = None
        if mesh.uv is not None:
            uv_corners = (mesh.faces if mesh.uv_faces is None else mesh.uv_faces)[rows]
        source, uv_source, faces = split_seams(mesh.faces[rows], uv_corners)
        source = np.concatenate([source, loose])
        if uv_source is not None:
            uv_source = np.concatenate([uv_source, np.zeros(len(loose), np.int64)])
        add = self.buffer.add_accessor
        metres = ((mesh.vertices[source] - _pivot(mesh)) / MM_PER_METRE).astype(np.float32)
        attributes = {"POSITION": add(metres, ARRAY_BUFFER, bounds=True)}
        if mesh.normals is not None:
            attributes["NORMAL"] = add(_unit(mesh.normals[source]), ARRAY_BUFFER)
        if mesh.uv is not None and uv_source is not None:
            uv = mesh.uv[uv_source].astype(np.float64)
            attributes["TEXCOORD_0"] = add(np.stack([uv[:, 0], 1 - uv[:, 1]], 1).astype(np.float32), ARRAY_BUFFER)
        if mesh.vertex_colors is not None:
            colors = linear_from_srgb_u16(mesh.vertex_colors[source])
            attributes["COLOR_0"] = add(colors, ARRAY_BUFFER, normalized=True)
        if not np.array_equal(source, np.arange(len(mesh.vertices))):
            attributes[SOURCE_ATTRIBUTE] = add(source.astype(np.float32), ARRAY_BUFFER)
        index_type = np.uint16 if len(source) <= 65535 else np.uint32
        primitive: dict[str, Any] = {
            "attributes": attributes,
            "indices": add(faces.astype(index_type).reshape(-1), ELEMENT_ARRAY_BUFFER),
            "mode": 4,
        }
        if mesh.morph_deltas is not None:
            primitive["targets"] = [self._target(mesh, b, source) for b in range(len(mesh.morph_names))]
        if mesh.materials:
            primitive["material"] = self._material(mesh.materials[material])
        return primitive

    def _target(self, mesh: GltfMesh, b: int, source: NDArray[np.int64]) -> dict[str, int]:
        assert mesh.morph_deltas is not None
        deltas = (mesh.morph_deltas[b][source] / MM_PER_METRE).astype(np.float32)
        target = {"POSITION": self.buffer.add_accessor(deltas, ARRAY_BUFFER, bounds=True, sparse=self.sparse)}
        if mesh.morph_normals is not None:
            change = mesh.morph_normals[b][source].astype(np.float32)
            target["NORMAL"] = self.buffer.add_accessor(change, ARRAY_BUFFER, sparse=self.sparse)
        return target

    def _material(self, material: GltfMaterial) -> int:
        if id(material) not in self.material_index:
            surface: dict[str, Any] = {
                "baseColorFactor": [float(c) for c in material.base_color_linear],
                "metallicFactor": float(material.metallic),
                "roughnessFactor": float(material.roughness),
            }
            if material.texture is not None:
                surface["baseColorTexture"] = {"index": self._image(material.texture)}
            entry: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": surface}
            if material.double_sided:
                entry["doubleSided"] = True
            self.materials.append(entry)
            self.material_index[id(material)] = len(self.materials) - 1
        return self.material_index[id(material)]

    def _image(self, texture: NDArray[np.uint8]) -> int:
        from PIL import Image

        stream = io.BytesIO()
        options = {"quality": 92, "subsampling": 0} if self.image_format == "jpeg" else {"optimize": False}
        Image.fromarray(texture).save(stream, self.image_format, **options)
        view = self.buffer.add_view(stream.getvalue())
        self.images.append({"bufferView": view, "mimeType": f"image/{self.image_format}"})
        return len(self.images) - 1

    def _animations(self) -> list[dict[str, Any]]:
        """Write the clips: motions of one name are one clip, of several nodes."""
        entries: dict[str, dict[str, Any]] = {}
        for animation in self.scene.animations:
            entry = entries.setdefault(animation.name, {"name": animation.name, "samplers": [], "channels": []})
            self._animation(animation, entry["samplers"], entry["channels"])
        return list(entries.values())

    def _animation(
        self, animation: GltfAnimation, samplers: list[dict[str, Any]], channels: list[dict[str, Any]]
    ) -> None:
        add = self.buffer.add_accessor
        keys = np.asarray(animation.times, dtype=np.float32)
        if keys.tobytes() not in self.times:
            self.times[keys.tobytes()] = add(keys, bounds=True)
        outputs: dict[str, NDArray[Any]] = {}
        if animation.weights is not None:
            outputs["weights"] = animation.weights.reshape(-1)
        if animation.rotation_wxyz is not None:
            outputs["rotation"] = _unit(np.roll(animation.rotation_wxyz, -1, axis=1))  # glTF: xyzw
        if animation.translation is not None:
            outputs["translation"] = animation.translation / MM_PER_METRE
        for path, values in outputs.items():
            channels.append({"sampler": len(samplers), "target": {"node": animation.mesh, "path": path}})
            output = add(values.astype(np.float32))
            samplers.append({"input": self.times[keys.tobytes()], "output": output, "interpolation": "LINEAR"})


def _pivot(mesh: GltfMesh) -> NDArray[np.float64]:
    return np.zeros(3) if mesh.pivot is None else np.asarray(mesh.pivot, dtype=np.float64)


def split_seams(
    faces: NDArray[Any], uv_faces: NDArray[Any] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64] | None, NDArray[np.int64]]:
    """Give every distinct (vertex, uv point) pair of the corners its own index.

    Parameters
    ----------
    faces, uv_faces : ndarray of shape (F, 3), int
        Corners; `uv_faces` may be None.

    Returns
    -------
    source : ndarray of shape (W,), int64
        Vertex of each new index, ascending.
    uv_source : ndarray of shape (W,), int64, or None
        Texture point of each new index.
    corners : ndarray of shape (F, 3), int64
        The triangles in new indices.
    """
    corners = faces.astype(np.int64).reshape(-1)
    if uv_faces is None:
        source, index = np.unique(corners, return_inverse=True)
        return source, None, index.reshape(-1, 3)
    points = uv_faces.astype(np.int64).reshape(-1)
    base = int(points.max(initial=0)) + 1
    pairs, index = np.unique(corners * base + points, return_inverse=True)
    return pairs // base, pairs % base, index.reshape(-1, 3)


def linear_from_srgb_u16(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Turn sRGB colours (V, 3) into linear ones (V, 4), alpha full; 16 bits keep all 256 levels apart."""
    code = np.arange(256) / 255.0
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    table = np.rint(linear * 65535).astype(np.uint16)
    return np.concatenate([table[colors], np.full((len(colors), 1), 65535, np.uint16)], axis=1)


def _unit(vectors: NDArray[Any]) -> NDArray[np.float32]:
    """Normalise rows; a zero row becomes the last axis, since glTF demands unit length."""
    values = np.asarray(vectors, dtype=np.float64)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    fallback = np.eye(values.shape[1])[-1]
    return np.where(length > 0, values / np.where(length > 0, length, 1.0), fallback).astype(np.float32)
