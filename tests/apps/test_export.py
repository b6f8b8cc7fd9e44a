"""Exported rigs: files that other programs understand, shapes that move the same vertices by the same amount."""

from dataclasses import dataclass

import numpy as np
import pytest

from facewright.apps.export import ExportRequest, demo_clip, export_rig, face_looks
from facewright.errors import ShapeError, StoreError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.io.gltf import read_gltf
from facewright.io.obj import read_obj
from facewright.mesh.topology import Topology


@dataclass
class _Rig:
    neutral: np.ndarray
    names: tuple
    deltas: np.ndarray


def _grid(n=14):
    """A bent sheet of quads: two thirds skin, then teeth, then a film that is not exported."""
    x, y = np.meshgrid(np.linspace(-70, 70, n), np.linspace(-90, 90, n), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0.004 * (x**2 + y**2).ravel()], axis=1)
    i = np.arange(n * n).reshape(n, n)
    rows = [(0, 9), (9, 12), (12, n)]  # no quad joins two parts
    quads = np.concatenate(
        [
            np.stack([i[a : b - 1, :-1], i[a + 1 : b, :-1], i[a + 1 : b, 1:], i[a : b - 1, 1:]], -1).reshape(-1, 4)
            for a, b in rows
        ]
    )
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    parts = {name: (a * n, b * n) for name, (a, b) in zip(("face", "teeth_lower", "eye_occlusion_left"), rows)}
    uv = np.stack([(x.ravel() + 70) / 140, (y.ravel() + 90) / 180], axis=1).astype(np.float32)
    return vertices, Topology(
        "grid",
        n * n,
        faces.astype(np.int32),
        quads=quads.astype(np.int32),
        uv=uv,
        uv_faces=faces.astype(np.int32),
        parts=parts,
    )


@pytest.fixture
def rig(rng):
    vertices, topology = _grid()
    deltas = np.zeros((46, len(vertices), 3), np.float32)
    for b in range(46):
        deltas[b, rng.integers(0, len(vertices), 12)] = rng.normal(size=(12, 3))
    return _Rig(vertices, BLENDSHAPE_NAMES, deltas), topology


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_gltf_holds_every_shape_by_name(tmp_path, rng, rig, suffix):
    rig, topology = rig
    texture = rng.integers(0, 256, (16, 16, 3), dtype=np.uint8)
    colors = rng.integers(0, 256, (topology.n_vertices, 3), dtype=np.uint8)
    out = tmp_path / f"rig.{suffix}"
    steps = []
    result = export_rig(
        ExportRequest(rig, topology, out, texture=texture, vertex_colors=colors, image_format="png", copyright="me"),
        progress=lambda *step: steps.append(step),
    )
    scene = read_gltf(out)
    (mesh,) = scene.meshes
    n = topology.parts["teeth_lower"][1]  # the film at the end is left out
    assert result.shape_names == mesh.morph_names == BLENDSHAPE_NAMES
    assert (result.n_vertices, result.n_faces, result.n_bytes) == (n, len(mesh.faces), out.stat().st_size)
    assert [m.name for m in mesh.materials] == ["skin", "teeth"] and scene.copyright == "me"
    np.testing.assert_array_equal(mesh.materials[0].texture, texture)
    assert mesh.materials[1].texture is None
    np.testing.assert_allclose(mesh.vertices, rig.neutral[:n], atol=2e-5)
    np.testing.assert_allclose(mesh.morph_deltas, rig.deltas[:, :n], atol=1.1e-3)  # below 1 micrometre becomes none
    skin = topology.parts["face"][1]
    assert (mesh.vertex_colors[:skin] == 255).all()
    np.testing.assert_array_equal(mesh.vertex_colors[skin:], colors[skin:n])
    assert steps[-1] == ("shading shapes", 46, 46)


def test_another_reader_finds_targets_and_names(tmp_path, rig):
    pygltflib = pytest.importorskip("pygltflib")
    rig, topology = rig
    export_rig(ExportRequest(rig, topology, tmp_path / "rig.glb", clip=demo_clip(rig.names)))
    document = pygltflib.GLTF2().load(str(tmp_path / "rig.glb"))
    (mesh,) = document.meshes
    assert mesh.extras["targetNames"] == list(BLENDSHAPE_NAMES)
    assert all(len(primitive.targets) == 46 for primitive in mesh.primitives) and len(mesh.weights) == 46
    (animation,) = document.animations
    assert {channel.target.path for channel in animation.channels} == {"weights", "rotation"}
    counts = [document.accessors[s.output].count for s in animation.samplers]
    keys = document.accessors[animation.samplers[0].input].count
    assert sorted(counts) == [keys, 46 * keys]


def test_shading_follows_the_shapes(tmp_path, rig):
    from facewright.mesh.normals import vertex_normals

    rig, topology = rig
    export_rig(ExportRequest(rig, topology, tmp_path / "rig.glb"))
    (mesh,) = read_gltf(tmp_path / "rig.glb").meshes
    b = BLENDSHAPE_NAMES.index("jawOpen")
    expected = vertex_normals(mesh.vertices.astype(float) + mesh.morph_deltas[b], mesh.faces)
    np.testing.assert_allclose(mesh.normals + mesh.morph_normals[b], expected, atol=2e-3)


def test_arkit_names_mix_the_shapes_and_the_motion(tmp_path, rig):
    from facewright.faces.blendshape_names import load_name_map

    rig, topology = rig
    clip = demo_clip(rig.names)
    result = export_rig(ExportRequest(rig, topology, tmp_path / "rig.glb", names="arkit52", clip=clip))
    still = [name for name, move in zip(result.shape_names, load_name_map("arkit52").to_ours.T) if not move.any()]
    assert list(result.empty_shapes) == still and "tongueOut" in still
    scene = read_gltf(tmp_path / "rig.glb")
    (mesh,) = scene.meshes
    assert len(mesh.morph_names) == 52 and {"jawOpen", "eyeBlinkLeft", "tongueOut"} <= set(mesh.morph_names)
    ours = {"jawOpen": "jawOpen", "eyeBlinkLeft": "eyeBlink_L", "mouthSmileRight": "mouthSmile_R"}
    for theirs, mine in ours.items():
        found = mesh.morph_deltas[mesh.morph_names.index(theirs)]
        expected = rig.deltas[BLENDSHAPE_NAMES.index(mine), : len(found)]
        np.testing.assert_allclose(found, expected, atol=1.1e-3)
    expected = clip.weights @ load_name_map("arkit52").from_ours.T
    np.testing.assert_allclose(scene.animations[0].weights, expected, atol=1e-6)


@pytest.mark.parametrize("names", ["facewright", "arkit52"])
def test_the_file_opens_in_the_given_pose(tmp_path, rng, rig, names):
    rig, topology = rig
    weights = rng.random(46)
    export_rig(ExportRequest(rig, topology, tmp_path / "rig.glb", names=names, weights=weights))
    (mesh,) = read_gltf(tmp_path / "rig.glb").meshes
    jaw = mesh.weights[mesh.morph_names.index("jawOpen")]
    assert jaw == pytest.approx(weights[BLENDSHAPE_NAMES.index("jawOpen")], abs=1e-6)
    with pytest.raises(ShapeError, match="weights"):
        export_rig(ExportRequest(rig, topology, tmp_path / "no.glb", weights=weights[:5]))


def test_obj_sequence(tmp_path, rng, rig):
    rig, topology = rig
    texture = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    result = export_rig(ExportRequest(rig, topology, tmp_path / "shapes", texture=texture))
    assert {p.name for p in result.paths} == {f"{n}.obj" for n in ("neutral", *BLENDSHAPE_NAMES)} | {"texture.png"}
    neutral = read_obj(tmp_path / "shapes/neutral.obj")
    smile = read_obj(tmp_path / "shapes/mouthSmile_L.obj")
    np.testing.assert_array_equal(neutral.polygons, topology.quads)
    np.testing.assert_array_equal(neutral.uv_polygons, topology.quads)
    assert neutral.texture == tmp_path / "shapes/texture.png" and neutral.texture.is_file()
    expected = rig.deltas[BLENDSHAPE_NAMES.index("mouthSmile_L")]
    np.testing.assert_allclose(smile.vertices - neutral.vertices, expected, atol=1e-6)


def test_looks_follow_parts(rig):
    _, topology = rig
    names, index = face_looks(topology)
    assert names == ("skin", "teeth")
    assert set(index) == {-1, 0, 1}
    bare = Topology("bare", 3, np.array([[0, 1, 2]], np.int32))
    assert face_looks(bare)[0] == ("skin",)


def test_demo_clip_starts_and_ends_at_rest():
    clip = demo_clip(BLENDSHAPE_NAMES)
    assert clip.weights.min() >= 0 and clip.weights.max() <= 1
    assert not clip.weights[0].any() and not clip.weights[-1].any()
    np.testing.assert_allclose(np.linalg.norm(clip.rotation_wxyz, axis=1), 1)


def test_what_does_not_fit_is_refused(tmp_path, rig):
    rig, topology = rig
    good = {"rig": rig, "topology": topology, "out": tmp_path / "a.glb"}
    few = _Rig(rig.neutral, ("jawOpen",), rig.deltas[:1])
    wrong = [
        ({"rig": _Rig(rig.neutral[:-1], rig.names, rig.deltas)}, ShapeError, "neutral"),
        ({"rig": _Rig(rig.neutral, rig.names[:-1], rig.deltas)}, ShapeError, "deltas"),
        ({"vertex_colors": np.zeros((3, 3), np.uint8)}, ShapeError, "vertex_colors"),
        ({"names": "maya"}, ValueRangeError, "maya"),
        ({"names": "arkit52", "rig": few}, ValueRangeError, "46 shapes"),
        ({"out": tmp_path / "a.fbx"}, ValueRangeError, "fbx"),
        ({"texture": np.zeros((4, 4, 3))}, ValueRangeError, "uint8"),
        ({"out": tmp_path / "none" / "a.glb"}, StoreError, "does not exist"),
        ({"rig": _Rig(rig.neutral, ("../x",), rig.deltas[:1]), "out": tmp_path / "o"}, ValueRangeError, "file names"),
    ]
    for change, error, message in wrong:
        with pytest.raises(error, match=message):
            export_rig(ExportRequest(**(good | change)))
    bare = Topology("bare", topology.n_vertices, topology.faces)
    with pytest.raises(ValueRangeError, match="uv"):
        export_rig(ExportRequest(rig, bare, tmp_path / "a.glb", texture=np.zeros((4, 4, 3), np.uint8)))
    assert not [p for p in tmp_path.rglob("*") if p.is_file()]
