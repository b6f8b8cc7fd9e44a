"""glTF: a whole character comes back as it was, another reader agrees, foreign and broken files are named."""

import base64
import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.gltf import GltfAnimation, GltfMaterial, GltfMesh, GltfScene, read_gltf, write_gltf
from facewright.io.gltf_writer import split_seams

TOLERANCE_MM = 2e-5  # float32 of metres, below 200 mm


def _unit(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _character(rng, n=60):
    """Two materials, a seam, colours, three targets of which one moves nothing and one moves little."""
    faces = np.stack([rng.permutation(n)[:3] for _ in range(80)])
    deltas = rng.normal(size=(3, n, 3))
    deltas[1] = 0
    deltas[2, 5:] = 0
    texture = rng.integers(0, 256, (8, 16, 3), dtype=np.uint8)
    return GltfMesh(
        name="person",
        vertices=rng.uniform(-150, 150, (n, 3)).astype(np.float32),
        faces=faces,
        materials=(
            GltfMaterial("skin", texture=texture, roughness=0.5),
            GltfMaterial("eye", base_color_linear=(0.5, 0.25, 1.0, 1.0), double_sided=True),
        ),
        face_materials=np.repeat([0, 1], [50, 30]),
        uv=rng.random((90, 2)).astype(np.float32),
        uv_faces=rng.integers(0, 90, (80, 3)),
        normals=_unit(rng.normal(size=(n, 3))).astype(np.float32),
        vertex_colors=rng.integers(0, 256, (n, 3), dtype=np.uint8),
        morph_names=("jawOpen", "nothing", "smile"),
        morph_deltas=deltas.astype(np.float32),
        morph_normals=(0.1 * deltas).astype(np.float32),
        weights=np.array([0.25, 0.0, 1.0], dtype=np.float32),
    )


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("sparse", [True, False])
def test_a_whole_character_comes_back(tmp_path, rng, suffix, sparse):
    mesh = _character(rng)
    times = np.array([0.0, 0.5, 1.25])
    clip = GltfAnimation("nod", times, 0, rng.random((3, 3)), _unit(rng.normal(size=(3, 4))), rng.normal(size=(3, 3)))
    scene = GltfScene((mesh,), (clip,), copyright="(c) someone", extras={"seed": 3})
    path = tmp_path / f"person{suffix}"
    write_gltf(path, scene, sparse=sparse)
    found = read_gltf(path)
    assert (found.copyright, found.extras) == ("(c) someone", {"seed": 3})
    (back,) = found.meshes
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=TOLERANCE_MM)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    np.testing.assert_array_equal(back.face_materials, mesh.face_materials)
    np.testing.assert_allclose(back.uv[back.uv_faces], mesh.uv[mesh.uv_faces], atol=1e-7)
    np.testing.assert_allclose(back.normals, mesh.normals, atol=1e-6)
    np.testing.assert_array_equal(back.vertex_colors, mesh.vertex_colors)
    assert back.morph_names == mesh.morph_names
    np.testing.assert_allclose(back.morph_deltas, mesh.morph_deltas, atol=TOLERANCE_MM)
    np.testing.assert_allclose(back.morph_normals, mesh.morph_normals, atol=1e-6)
    np.testing.assert_array_equal(back.weights, mesh.weights)
    for a, b in zip(back.materials, mesh.materials, strict=True):
        assert (a.name, a.base_color_linear, a.roughness, a.metallic, a.double_sided) == (
            (b.name, b.base_color_linear, b.roughness, b.metallic, b.double_sided)
        )
    np.testing.assert_array_equal(back.materials[0].texture, mesh.materials[0].texture)
    (motion,) = found.animations
    np.testing.assert_allclose(motion.times, times)
    np.testing.assert_allclose(motion.weights, clip.weights, atol=1e-6)
    np.testing.assert_allclose(motion.rotation_wxyz, clip.rotation_wxyz, atol=1e-6)
    np.testing.assert_allclose(motion.translation, clip.translation, atol=1e-5)


def test_vertices_without_triangles_and_without_uv_survive(tmp_path, rng):
    vertices = rng.normal(size=(9, 3)) * 50
    mesh = GltfMesh("m", vertices, np.array([[8, 3, 1]]))
    write_gltf(tmp_path / "m.glb", GltfScene((mesh,)))
    (back,) = read_gltf(tmp_path / "m.glb").meshes
    np.testing.assert_allclose(back.vertices, vertices, atol=TOLERANCE_MM)
    assert back.faces.tolist() == [[8, 3, 1]] and back.uv is None and back.morph_names == ()


def test_another_reader_agrees(tmp_path, rng):
    """pygltflib, which shares no code with ours, finds the same structure and the same bytes."""
    pygltflib = pytest.importorskip("pygltflib")
    mesh = _character(rng)
    write_gltf(tmp_path / "p.glb", GltfScene((mesh,), (GltfAnimation("a", np.array([0.0, 1.0]), 0, np.eye(3)[:2]),)))
    document = pygltflib.GLTF2().load(str(tmp_path / "p.glb"))
    assert document.meshes[0].extras["targetNames"] == list(mesh.morph_names)
    assert [m.name for m in document.materials] == ["skin", "eye"]
    assert len(document.meshes[0].primitives) == 2 and document.images[0].mimeType == "image/png"
    assert document.animations[0].channels[0].target.path == "weights"
    accessor = document.accessors[document.meshes[0].primitives[0].attributes.POSITION]
    view = document.bufferViews[accessor.bufferView]
    data = document.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    positions = np.frombuffer(data, "<f4").reshape(-1, 3)
    assert len(positions) == accessor.count
    np.testing.assert_allclose(positions.min(axis=0), accessor.min)
    source, uv_source, _ = split_seams(mesh.faces[:50], mesh.uv_faces[:50])
    np.testing.assert_allclose(positions[: len(source)], mesh.vertices[source] / 1000, atol=1e-8)
    assert len(uv_source) == len(source)


def test_what_another_writer_writes_is_read(tmp_path, rng):
    """A pygltflib file: interleaved floats, byte indices in a strip, a place in the scene, no names."""
    pygltflib = pytest.importorskip("pygltflib")
    vertices = rng.normal(size=(4, 3)).astype("<f4")
    uv = rng.random((4, 2)).astype("<f4")
    blob = np.hstack([vertices, uv]).astype("<f4").tobytes() + bytes([0, 1, 2, 3])
    document = pygltflib.GLTF2(
        scene=0,
        scenes=[pygltflib.Scene(nodes=[0])],
        nodes=[
            pygltflib.Node(children=[1], translation=[1.0, 2.0, 3.0]),
            pygltflib.Node(mesh=0, scale=[2.0, 2.0, 2.0], rotation=[0.0, 1.0, 0.0, 0.0]),
        ],
        meshes=[
            pygltflib.Mesh(
                primitives=[
                    pygltflib.Primitive(attributes=pygltflib.Attributes(POSITION=0, TEXCOORD_0=1), indices=2, mode=5)
                ]
            )
        ],
        accessors=[
            pygltflib.Accessor(bufferView=0, componentType=5126, count=4, type="VEC3"),
            pygltflib.Accessor(bufferView=0, byteOffset=12, componentType=5126, count=4, type="VEC2"),
            pygltflib.Accessor(bufferView=1, componentType=5121, count=4, type="SCALAR"),
        ],
        bufferViews=[
            pygltflib.BufferView(buffer=0, byteLength=80, byteStride=20),
            pygltflib.BufferView(buffer=0, byteOffset=80, byteLength=4),
        ],
        buffers=[pygltflib.Buffer(byteLength=84)],
    )
    document.set_binary_blob(blob)
    document.save(str(tmp_path / "theirs.glb"))
    (mesh,) = read_gltf(tmp_path / "theirs.glb").meshes
    expected = 1000 * (vertices * 2 * [-1, 1, -1] + [1, 2, 3])
    np.testing.assert_allclose(mesh.vertices, expected, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(mesh.uv[:, 1], 1 - uv[:, 1], atol=1e-7)
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


def test_khronos_sample(test_data):
    scene = read_gltf(test_data / "gltf/SimpleMorph.gltf")
    (mesh,) = scene.meshes
    assert mesh.vertices.tolist() == [[0, 0, 0], [1000, 0, 0], [500, 500, 0]]
    assert mesh.morph_names == ("morph_0", "morph_1") and mesh.weights.tolist() == [0.5, 0.5]
    assert mesh.morph_deltas.shape == (2, 3, 3)
    np.testing.assert_array_equal(mesh.morph_deltas.min(axis=1), [[-1000, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(mesh.morph_deltas.max(axis=1), [[0, 1000, 0], [1000, 1000, 0]])
    (clip,) = scene.animations
    assert clip.times.tolist() == [0, 1, 2, 3, 4]
    assert clip.weights.tolist() == [[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]]


def test_sparse_targets_are_smaller(tmp_path, rng):
    vertices = rng.normal(size=(3000, 3))
    faces = rng.integers(0, 3000, (100, 3))
    deltas = np.zeros((10, 3000, 3))
    deltas[:, :50] = 1
    mesh = GltfMesh("m", vertices, faces, morph_names=tuple("abcdefghij"), morph_deltas=deltas)
    for sparse in (True, False):
        write_gltf(tmp_path / f"{sparse}.glb", GltfScene((mesh,)), sparse=sparse)
    assert (tmp_path / "True.glb").stat().st_size < 0.3 * (tmp_path / "False.glb").stat().st_size


def test_split_seams_matches_a_plain_loop(rng):
    faces, uv_faces = rng.integers(0, 12, (40, 3)), rng.integers(0, 15, (40, 3))
    pairs = sorted({(int(v), int(t)) for f, g in zip(faces, uv_faces) for v, t in zip(f, g)})
    source, uv_source, corners = split_seams(faces, uv_faces)
    assert list(zip(source.tolist(), uv_source.tolist())) == pairs
    np.testing.assert_array_equal(source[corners], faces)
    np.testing.assert_array_equal(uv_source[corners], uv_faces)


def test_files_in_metres(tmp_path):
    mesh = GltfMesh("m", np.array([[0, 0, 0], [1000.0, 0, 0], [0, 500, 0]]), np.array([[0, 1, 2]]))
    write_gltf(tmp_path / "m.gltf", GltfScene((mesh,)))
    document = json.loads((tmp_path / "m.gltf").read_text())
    assert document["accessors"][0]["max"] == [1.0, 0.5, 0.0]
    assert document["asset"]["version"] == "2.0"


# ---- what must be refused ----


@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.2, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(tmp_path, rng, share):
    for name in ("p.glb", "p.gltf"):
        path = tmp_path / name
        write_gltf(path, GltfScene((_character(rng),)))
        data = path.read_bytes()
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(FileFormatError, match=name):
            read_gltf(path)


def test_no_damage_to_the_json_escapes_as_another_error(tmp_path, rng):
    """Spoil the entries of the document in turn: either it still reads, or a FileFormatError names the file."""
    path = tmp_path / "p.gltf"
    clip = GltfAnimation("a", np.array([0.0, 1.0]), 0, np.eye(3)[:2])
    write_gltf(path, GltfScene((_character(rng),), (clip,)))
    text = path.read_text()
    places = []

    def walk(value, trail):
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, child in items:
            if len(places) < 4000 and not (isinstance(child, float) or trail.count("min") or trail.count("max")):
                places.append((*trail, key))
                walk(child, (*trail, key))

    walk(json.loads(text), ())
    refused = 0
    for trail in places[:: max(1, len(places) // 100)]:
        for spoil in ("remove", -1, 10**12, "x", None):
            document = json.loads(text)
            parent = document
            for key in trail[:-1]:
                parent = parent[key]
            if spoil == "remove":
                del parent[trail[-1]]
            else:
                parent[trail[-1]] = spoil
            path.write_text(json.dumps(document))
            try:
                read_gltf(path)
            except FileFormatError as error:
                refused += 1
                assert "p.gltf" in str(error) and "\n" not in str(error)
    assert refused > 100


def _document(**changes):
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "data:;base64," + base64.b64encode(bytes(36)).decode()}],
    }
    return document | changes


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"asset": {"version": "1.0"}}, "version 2, got version 1.0"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco_mesh_compression"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "loop"),
        ({"buffers": [{"byteLength": 36, "uri": "missing.bin"}]}, "missing.bin"),
        ({"buffers": [{"byteLength": 36, "uri": "https://example.org/a.bin"}]}, "beside it"),
        ({"buffers": [{"byteLength": 99, "uri": "data:;base64,AAAA"}]}, "buffer of 99 bytes, got 3"),
        ({"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}]}, "at most"),
        ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}]}, "48 bytes"),
        ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC2"}]}, "VEC3"),
        ({"accessors": [{"bufferView": 0, "componentType": 9999, "count": 3, "type": "VEC3"}]}, "KeyError"),
    ],
)
def test_wrong_documents_are_named(tmp_path, changes, message):
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(_document(**changes)))
    with pytest.raises(FileFormatError, match=message):
        read_gltf(path)


def test_the_plain_document_of_these_tests_is_fine(tmp_path):
    (tmp_path / "a.gltf").write_text(json.dumps(_document()))
    assert read_gltf(tmp_path / "a.gltf").meshes[0].faces.tolist() == [[0, 1, 2]]


def test_other_refusals(tmp_path, rng):
    with pytest.raises(StoreError, match="No such file"):
        read_gltf(tmp_path / "none.glb")
    (tmp_path / "v1.glb").write_bytes(struct.pack("<III", 0x46546C67, 1, 20) + bytes(8))
    with pytest.raises(FileFormatError, match="version 1"):
        read_gltf(tmp_path / "v1.glb")
    scene = GltfScene((_character(rng),))
    with pytest.raises(ValueRangeError, match="glb or"):
        write_gltf(tmp_path / "a.obj", scene)
    with pytest.raises(ValueRangeError, match="png or jpeg"):
        write_gltf(tmp_path / "a.glb", scene, image_format="gif")
    triangle = np.array([[0, 1, 2]])
    with pytest.raises(ValueRangeError, match="faces"):
        GltfMesh("m", np.zeros((2, 3)), triangle)
    with pytest.raises(ValueRangeError, match="finite"):
        GltfMesh("m", np.full((3, 3), np.nan), triangle)
    with pytest.raises(ShapeError, match="morph_deltas"):
        GltfMesh("m", np.eye(3), triangle, morph_names=("a",), morph_deltas=np.zeros((2, 3, 3)))
    with pytest.raises(ValueRangeError, match="morph_deltas"):
        GltfMesh("m", np.eye(3), triangle, morph_names=("a",))
    with pytest.raises(ValueRangeError, match="uv_faces"):
        GltfMesh("m", np.eye(3), triangle, uv=np.zeros((2, 2)))
    with pytest.raises(ValueRangeError, match="times"):
        GltfAnimation("a", np.array([0.0, 0.0]))
    with pytest.raises(ValueRangeError, match="uint8"):
        GltfMaterial("a", texture=np.zeros((2, 2, 3)))
    with pytest.raises(ShapeError, match="weights of animation"):
        GltfScene((_character(rng),), (GltfAnimation("a", np.array([0.0]), 0, np.zeros((1, 9))),))


def test_a_child_turns_about_its_pivot_and_goes_along(tmp_path, rng):
    pygltflib = pytest.importorskip("pygltflib")
    head, eye = _character(rng), _character(rng)
    eye = replace(eye, name="eye", parent=0, pivot=np.array([30.0, 40.0, 90.0]))
    pupil = replace(eye, name="pupil", parent=1, pivot=np.array([31.0, 40.0, 102.0]))
    times = np.array([0.0, 0.5])
    turns = [_unit(rng.normal(size=(2, 4))) for _ in range(2)]
    clips = tuple(GltfAnimation("look", times, k, rotation_wxyz=turn) for k, turn in zip((0, 1), turns, strict=True))
    write_gltf(tmp_path / "a.glb", GltfScene((head, eye, pupil), clips))
    document = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    assert document.scenes[0].nodes == [0] and document.nodes[0].children == [1] and document.nodes[1].children == [2]
    np.testing.assert_allclose(document.nodes[1].translation, [0.03, 0.04, 0.09])
    np.testing.assert_allclose(document.nodes[2].translation, [0.001, 0.0, 0.012])
    (clip,) = document.animations
    assert [channel.target.node for channel in clip.channels] == [0, 1]
    back = read_gltf(tmp_path / "a.glb")
    assert [mesh.parent for mesh in back.meshes] == [None, 0, 1]
    for found, mesh in zip(back.meshes, (head, eye, pupil), strict=True):
        np.testing.assert_allclose(found.vertices, mesh.vertices, atol=TOLERANCE_MM)
        pivot = np.zeros(3) if found.pivot is None else found.pivot
        np.testing.assert_allclose(pivot, np.zeros(3) if mesh.pivot is None else mesh.pivot, atol=TOLERANCE_MM)
    assert [animation.mesh for animation in back.animations] == [0, 1]
    with pytest.raises(ValueRangeError, match="parent of a mesh"):
        GltfScene((eye, head))
