"""Reading glTF: any file with triangle meshes, morph targets and linear, stepped or cubic animation."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FacewrightError, FileFormatError, StoreError
from facewright.io.gltf_buffers import BufferReader, unpack_document
from facewright.io.gltf_scene import GltfAnimation, GltfMaterial, GltfMesh, GltfScene
from facewright.io.gltf_writer import MM_PER_METRE, SOURCE_ATTRIBUTE

_HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_texture_transform", "KHR_mesh_quantization", "KHR_lights_punctual")


def read_gltf(path: str | Path) -> GltfScene:
    """Read a .glb or .gltf file.

    Parameters
    ----------
    path : str or Path
        The file; external buffers and pictures are found beside it.

    Returns
    -------
    GltfScene
        One `GltfMesh` per node that shows a mesh, in millimetres, with the node's place applied and its origin as
        pivot; its primitives are joined. Files of `write_gltf` give their original vertices in their original order.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If the file is truncated, corrupt, not glTF 2, or needs an extension that is not read (such as compression).
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} must be a readable glTF file, got: {error.strerror or error}.") from error
    document, binary = unpack_document(path, data)
    try:
        for extension in document.get("extensionsRequired", []):
            if not extension.startswith(_HARMLESS_EXTENSIONS):
                raise FileFormatError(f"{path} must not need glTF extensions beyond materials, got {extension}.")
        return _SceneReader(path, document, binary).scene()
    except FileFormatError:
        raise
    except FacewrightError as error:  # a check of the nouns: the content contradicts itself
        raise FileFormatError(f"{path} must be a consistent glTF file, got: {error}") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FileFormatError(
            f"{path} must be a valid glTF file, got a {type(error).__name__} at {str(error)[:80]}."
        ) from None


class _SceneReader:
    def __init__(self, path: Path, document: dict[str, Any], binary: bytes | None) -> None:
        self.path = path
        self.document = document
        self.buffers = BufferReader(path, document, binary)
        self.material_cache: dict[int | None, GltfMaterial] = {}

    def scene(self) -> GltfScene:
        meshes: list[GltfMesh] = []
        mesh_of_node: dict[int, int] = {}
        parent_of = {
            child: node
            for node, entry in enumerate(self.document.get("nodes", []))
            for child in entry.get("children", [])
        }
        for node, matrix in self._nodes():
            entry = self.document["nodes"][node]
            if "mesh" not in entry:
                continue
            mesh = self._mesh(self.document["meshes"][entry["mesh"]], entry, matrix)
            if mesh is not None:
                mesh = replace(mesh, parent=mesh_of_node.get(parent_of.get(node, -1)))
                mesh_of_node[node] = len(meshes)
                meshes.append(mesh)
        animations = [
            animation
            for number, entry in enumerate(self.document.get("animations", []))
            for animation in self._animations(entry, number, mesh_of_node, meshes)
        ]
        asset = self.document.get("asset", {})
        extras = self.document.get("extras", {})
        return GltfScene(
            tuple(meshes),
            tuple(animations),
            copyright=str(asset.get("copyright", "")),
            extras=extras if isinstance(extras, dict) else {"value": extras},
        )

    def _nodes(self) -> list[tuple[int, NDArray[np.float64]]]:
        """List the nodes of the default scene with scene_from_node (4, 4), parents first."""
        nodes = self.document.get("nodes", [])
        if self.document.get("scenes"):
            roots = self.document["scenes"][self.document.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [i for i in range(len(nodes)) if i not in children]
        stack = [(root, np.eye(4)) for root in reversed(roots)]
        found: list[tuple[int, NDArray[np.float64]]] = []
        while stack:
            index, parent = stack.pop()
            if len(found) > len(nodes):
                raise FileFormatError(f"{self.path} must have its nodes as a tree, got a loop.")
            matrix = parent @ _node_matrix(nodes[index])
            found.append((index, matrix))
            stack += [(child, matrix) for child in reversed(nodes[index].get("children", []))]
        return found

    def _mesh(self, entry: dict[str, Any], node: dict[str, Any], matrix: NDArray[np.float64]) -> GltfMesh | None:
        pieces, offsets = list[dict[str, Any]](), dict[str, int]()
        faces, owners, materials = list[NDArray[Any]](), list[int](), list[int | None]()
        total = 0
        for primitive in entry["primitives"]:
            if primitive.get("mode", 4) not in (4, 5, 6):
                continue  # points and lines
            key = str((sorted(primitive["attributes"].items()), primitive.get("targets")))
            if key not in offsets:  # primitives often share their vertices
                pieces.append(self._vertices(primitive))
                offsets[key] = total
                total += len(pieces[-1]["POSITION"])
            count = len(self.buffers.array(primitive["attributes"]["POSITION"]))
            faces.append(self._triangles(primitive, count) + offsets[key])
            material = primitive.get("material")
            if material not in materials:
                materials.append(material)
            owners.append(materials.index(material))
        if not pieces:
            return None
        joined = _join(pieces)
        corners = np.concatenate(faces)
        n_targets = len(joined["targets"])
        names = list((entry.get("extras") or {}).get("targetNames", []))
        names = [str(name) for name in names] if len(names) == n_targets else [f"morph_{i}" for i in range(n_targets)]
        weights = node.get("weights", entry.get("weights"))
        joined, corners, uv_faces = _weld(joined, corners)
        positions, linear = joined["POSITION"], matrix[:3, :3]
        still = np.array_equal(matrix, np.eye(4))
        if not still:
            positions = positions @ linear.T + matrix[:3, 3]
        normals = joined.get("NORMAL")
        if normals is not None and not still:
            normals = normals @ np.linalg.inv(linear)
        uv = joined.get("TEXCOORD_0")
        return GltfMesh(
            name=str(node.get("name") or entry.get("name") or "mesh"),
            vertices=(positions * MM_PER_METRE).astype(np.float32),
            faces=corners.astype(np.int32),
            materials=tuple(self._material(material) for material in materials),
            face_materials=np.repeat(np.array(owners, np.int32), [len(f) for f in faces]),
            uv=None if uv is None else np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float32),
            uv_faces=None if uv is None else uv_faces.astype(np.int32),
            normals=None if normals is None else normals.astype(np.float32),
            vertex_colors=None if "COLOR_0" not in joined else _srgb(joined["COLOR_0"][:, :3]),
            morph_names=tuple(names),
            morph_deltas=_stack(joined["targets"], "POSITION", MM_PER_METRE * linear) if n_targets else None,
            morph_normals=_stack(joined["targets"], "NORMAL", linear) if n_targets else None,
            weights=None if weights is None or not n_targets else np.array(weights, dtype=np.float32),
            pivot=MM_PER_METRE * matrix[:3, 3] if matrix[:3, 3].any() else None,
        )

    def _vertices(self, primitive: dict[str, Any]) -> dict[str, Any]:
        attributes = primitive["attributes"]
        piece: dict[str, Any] = {"POSITION": self.buffers.array(attributes["POSITION"], "VEC3").astype(np.float64)}
        count = len(piece["POSITION"])
        for name in ("NORMAL", "TEXCOORD_0", "COLOR_0", SOURCE_ATTRIBUTE):
            if name in attributes:
                piece[name] = self.buffers.array(attributes[name])
                if len(piece[name]) != count:
                    raise FileFormatError(f"{self.path} must have {count} rows of {name}, got {len(piece[name])}.")
        piece["targets"] = []
        for target in primitive.get("targets", []):
            arrays = {n: self.buffers.array(target[n], "VEC3") for n in ("POSITION", "NORMAL") if n in target}
            for name, values in arrays.items():
                if len(values) != count:
                    raise FileFormatError(f"{self.path} must have {count} rows of target {name}, got {len(values)}.")
            arrays.setdefault("POSITION", np.zeros((count, 3), np.float32))
            piece["targets"].append(arrays)
        return piece

    def _triangles(self, primitive: dict[str, Any], count: int) -> NDArray[np.int64]:
        if "indices" in primitive:
            index = self.buffers.array(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        else:
            index = np.arange(count)
        if len(index) and index.max() >= count:
            raise FileFormatError(f"{self.path} must index its {count} vertices, got index {index.max()}.")
        mode = primitive.get("mode", 4)
        if mode == 4:
            return index[: len(index) // 3 * 3].reshape(-1, 3)
        n = max(0, len(index) - 2)
        row = np.arange(n)
        if mode == 6:  # fan
            return np.stack([index[row + 1], index[row + 2], np.broadcast_to(index[:1], n)], axis=1)
        odd = row % 2
        return np.stack([index[row], index[row + 1 + odd], index[row + 2 - odd]], axis=1)

    def _material(self, index: int | None) -> GltfMaterial:
        if index not in self.material_cache:
            entry = {} if index is None else self.document["materials"][index]
            surface = entry.get("pbrMetallicRoughness", {})
            texture = surface.get("baseColorTexture")
            r, g, b, a = (float(c) for c in surface.get("baseColorFactor", [1, 1, 1, 1]))
            self.material_cache[index] = GltfMaterial(
                name=str(entry.get("name", "default" if index is None else f"material_{index}")),
                base_color_linear=(r, g, b, a),
                texture=None if texture is None else self._image(texture["index"]),
                metallic=float(surface.get("metallicFactor", 1.0)),
                roughness=float(surface.get("roughnessFactor", 1.0)),
                double_sided=bool(entry.get("doubleSided", False)),
            )
        return self.material_cache[index]

    def _image(self, texture: int) -> NDArray[np.uint8] | None:
        from PIL import Image

        source = self.document["textures"][texture].get("source")
        if source is None:
            return None
        entry = self.document["images"][source]
        if "bufferView" in entry:
            data = self.buffers.view_bytes(entry["bufferView"])
        else:
            data = self.buffers.resource(entry["uri"])
        try:
            with Image.open(io.BytesIO(data)) as image:
                return np.asarray(image.convert("RGB"))
        except (OSError, SyntaxError, Image.DecompressionBombError) as error:
            raise FileFormatError(f"{self.path} must hold a readable picture {source}, got: {error}.") from None

    def _animations(
        self, entry: dict[str, Any], number: int, mesh_of_node: dict[int, int], meshes: list[GltfMesh]
    ) -> list[GltfAnimation]:
        """Gather the channels of one animation by mesh; differing key times are brought to their union."""
        tracks: dict[int, dict[str, tuple[NDArray[np.float64], NDArray[np.float64], bool]]] = {}
        for channel in entry["channels"]:
            target = channel["target"]
            path, node = target.get("path"), target.get("node")
            if node not in mesh_of_node or path not in ("weights", "rotation", "translation"):
                continue
            mesh = mesh_of_node[node]
            width = {"rotation": 4, "translation": 3}.get(path, len(meshes[mesh].morph_names))
            tracks.setdefault(mesh, {})[path] = self._track(entry["samplers"][channel["sampler"]], width)
        name = str(entry.get("name", f"animation_{number}"))
        animations = []
        for mesh, paths in tracks.items():
            times = np.unique(np.concatenate([keys for keys, _, _ in paths.values()]))
            values = {path: _resample(times, *track) for path, track in paths.items()}
            rotation = values.get("rotation")
            if rotation is not None:
                rotation = np.roll(rotation / np.linalg.norm(rotation, axis=1, keepdims=True), 1, axis=1)
            translation = values.get("translation")
            animations.append(
                GltfAnimation(
                    name=name,
                    times=times,
                    mesh=mesh,
                    weights=values.get("weights"),
                    rotation_wxyz=rotation,
                    translation=None if translation is None else translation * MM_PER_METRE,
                )
            )
        return animations

    def _track(self, sampler: dict[str, Any], width: int) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
        times = self.buffers.array(sampler["input"], "SCALAR")[:, 0].astype(np.float64)
        values = self.buffers.array(sampler["output"]).astype(np.float64)
        mode = sampler.get("interpolation", "LINEAR")
        if mode == "CUBICSPLINE":  # in-tangent, value, out-tangent: the values at the keys are kept
            values = values.reshape(len(times), 3, width)[:, 1]
        return times, values.reshape(len(times), width), mode == "STEP"


def _node_matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T  # the file is column-major
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _join(pieces: list[dict[str, Any]]) -> dict[str, Any]:
    """Concatenate the vertices of primitives; attributes that some lack are dropped."""
    n_targets = min(len(piece["targets"]) for piece in pieces)
    names = [name for name in pieces[0] if name != "targets" and all(name in piece for piece in pieces)]
    joined: dict[str, Any] = {
        name: np.concatenate([piece[name][:, :3] if name == "COLOR_0" else piece[name] for piece in pieces])
        for name in names
    }
    joined["targets"] = [
        {
            name: np.concatenate([piece["targets"][b][name] for piece in pieces])
            for name in ("POSITION", "NORMAL")
            if all(name in piece["targets"][b] for piece in pieces)
        }
        for b in range(n_targets)
    ]
    return joined


def _weld(
    joined: dict[str, Any], corners: NDArray[np.int64]
) -> tuple[dict[str, Any], NDArray[np.int64], NDArray[np.int64]]:
    """Undo the splitting of `write_gltf`: vertices back to their sources; texture points stay one per split vertex."""
    if SOURCE_ATTRIBUTE not in joined:
        return joined, corners, corners
    source = np.rint(joined[SOURCE_ATTRIBUTE].reshape(-1)).astype(np.int64)
    V = int(source.max(initial=-1)) + 1
    if source.min(initial=0) < 0 or len(source) < V or len(np.unique(source)) != V:
        return joined, corners, corners  # someone else's attribute of this name
    first = np.zeros(V, dtype=np.int64)
    first[source[::-1]] = np.arange(len(source))[::-1]
    welded = {name: values if name in ("targets", "TEXCOORD_0") else values[first] for name, values in joined.items()}
    welded["targets"] = [{name: values[first] for name, values in target.items()} for target in joined["targets"]]
    return welded, source[corners], corners


def _stack(
    targets: list[dict[str, NDArray[Any]]], name: str, linear: NDArray[np.float64] | float
) -> NDArray[np.float32] | None:
    if not all(name in target for target in targets):
        return None
    matrix = np.asarray(linear, dtype=np.float64)
    return np.stack([(target[name].astype(np.float64) @ matrix.T).astype(np.float32) for target in targets])


def _srgb(colors: NDArray[Any]) -> NDArray[np.uint8]:
    linear = colors.astype(np.float64)
    code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    return np.clip(np.rint(code * 255), 0, 255).astype(np.uint8)


def _resample(
    times: NDArray[np.float64], keys: NDArray[np.float64], values: NDArray[np.float64], step: bool
) -> NDArray[np.float64]:
    if np.array_equal(times, keys):
        return values
    if step:
        return values[np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 1)]
    return np.stack([np.interp(times, keys, column) for column in values.T], axis=1)
