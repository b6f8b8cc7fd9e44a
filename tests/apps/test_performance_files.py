"""Performances as files: what is written reads back; the real recording plays; signs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from facewright.apps.performance_files import (
    curves_from_performance,
    performance_from_curves,
    read_performance,
    write_performance_csv,
    write_performance_glb,
)
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ValueRangeError
from facewright.faces import Face
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.fitting.gaze import Eyeballs, eyeball_of
from facewright.io.gltf import read_gltf
from facewright.io.live_link import CURVE_COLUMNS, FaceCurves
from facewright.models.blendshapes import BlendshapeRig
from facewright.models.performance import Performance


def performance(rng: np.random.Generator, n: int = 9) -> Performance:
    """Make one that the 52 shapes can hold: brows' inner ends and cheeks alike, lids that follow the gaze."""
    weights = rng.uniform(0, 1, (n, 46))
    for left, right in (("browInnerUp_L", "browInnerUp_R"), ("cheekPuff_L", "cheekPuff_R")):
        weights[:, BLENDSHAPE_NAMES.index(left)] = weights[:, BLENDSHAPE_NAMES.index(right)]
    gaze = rng.uniform(-0.3, 0.3, (n, 2, 2))
    gaze[:, :, 1] = np.abs(gaze[:, :1, 1])
    rotations = np.array([rotation_from_head_angles(*rng.uniform(-25, 25, 3)) for _ in range(n)])
    tracked = np.ones(n, bool)
    tracked[n // 2] = False
    return Performance(np.arange(n) / 25, BLENDSHAPE_NAMES, weights, rotations, np.zeros((n, 3)), gaze, tracked)


def test_written_performance_reads_the_same(tmp_path: Path, rng: np.random.Generator) -> None:
    acted = performance(rng)
    write_performance_csv(tmp_path / "a.csv", acted)
    again, notes, cuts = read_performance(tmp_path / "a.csv")
    seen = acted.tracked
    np.testing.assert_array_equal(again.tracked, seen)
    np.testing.assert_allclose(again.weights[seen], acted.weights[seen], atol=1e-8)
    np.testing.assert_allclose(again.rotations[seen], acted.rotations[seen], atol=1e-8)
    np.testing.assert_allclose(again.gaze[seen], acted.gaze[seen], atol=1e-8)
    np.testing.assert_allclose(again.times, acted.times, atol=1e-4)
    assert notes == ("1 of 9 rows is untracked.",) and cuts is None


@pytest.mark.parametrize(
    "angles, column, sign",
    [((10, 0, 0), "HeadYaw", -1), ((0, 10, 0), "HeadPitch", -1), ((0, 0, 10), "HeadRoll", 1)],
)
def test_signs_of_the_head(rng: np.random.Generator, angles: tuple[int, ...], column: str, sign: int) -> None:
    acted = performance(rng, 5)
    turned = np.repeat(rotation_from_head_angles(*angles)[None], 5, axis=0)
    curves = curves_from_performance(
        Performance(acted.times, acted.names, acted.weights, turned, acted.translations, acted.gaze, acted.tracked)
    )
    for name in ("HeadYaw", "HeadPitch", "HeadRoll"):
        expected = sign * np.deg2rad(10) if name == column else 0.0
        np.testing.assert_allclose(curves.column(name)[0], expected, atol=1e-12)


def test_gaze_without_angles_comes_from_the_shapes(test_data: Path) -> None:
    from facewright.io.live_link import read_face_curves

    curves = read_face_curves(test_data / "curves" / "alex_rom_3.csv")
    measured = performance_from_curves(curves).gaze
    bare = curves.values.copy()
    bare[:, CURVE_COLUMNS.index("HeadYaw") :] = 0
    guessed = performance_from_curves(FaceCurves(curves.times, bare, curves.tracked)).gaze
    error = np.rad2deg(np.abs(measured - guessed))
    assert error.mean() < 2.0 < np.rad2deg(np.abs(measured)).mean()  # degrees; the eyes' own angles are ten on average
    assert np.corrcoef(measured[:, 0, 0], guessed[:, 0, 0])[0, 1] > 0.95


def test_real_recording_is_a_performance(test_data: Path, tmp_path: Path) -> None:
    acted, notes, _ = read_performance(test_data / "curves" / "alex_rom_3.csv")
    assert acted.n_frames == 4030 and acted.tracked.all()
    assert len(notes) == 2 and "clipped" in notes[0] and "TongueOut (up to 1)" in notes[1]
    # Blinks: the recording closes both eyes together.
    blink = acted.weights[:, [BLENDSHAPE_NAMES.index(f"eyeBlink_{side}") for side in "LR"]]
    assert blink.max() > 0.9 and np.abs(blink[:, 0] - blink[:, 1]).mean() < 0.05
    write_performance_csv(tmp_path / "again.csv", acted)
    again = read_performance(tmp_path / "again.csv").performance
    np.testing.assert_allclose(again.gaze, acted.gaze, atol=1e-8)
    look = BLENDSHAPE_NAMES.index("eyesLookDown")
    others = np.arange(46) != look
    np.testing.assert_allclose(again.weights[:, others], acted.weights[:, others], atol=1e-8)
    assert np.abs(again.weights[:, look] - acted.weights[:, look]).max() < 0.15


def test_foreign_shapes_are_refused(rng: np.random.Generator) -> None:
    acted = performance(rng, 3)
    renamed = ("grin", *acted.names[1:])
    other = Performance(
        acted.times, renamed, acted.weights, acted.rotations, acted.translations, acted.gaze, acted.tracked
    )
    with pytest.raises(ValueRangeError, match="'grin'"):
        curves_from_performance(other)


def test_glb_plays_the_performance(tmp_path: Path, rng: np.random.Generator, builtin_face: Face) -> None:
    acted = performance(rng)
    rig = BlendshapeRig(builtin_face.mean_shape, BLENDSHAPE_NAMES, builtin_face.blendshape_deltas)
    write_performance_glb(tmp_path / "a.glb", acted, rig, builtin_face, copyright="test")
    scene = read_gltf(tmp_path / "a.glb")
    clip = scene.animations[0]
    np.testing.assert_allclose(clip.times, acted.times, atol=1e-6)
    assert clip.weights is not None and clip.rotation_wxyz is not None and clip.translation is None
    np.testing.assert_allclose(clip.weights[:, :46], acted.weights, atol=1e-6)
    assert (np.einsum("ij,ij->i", clip.rotation_wxyz[1:], clip.rotation_wxyz[:-1]) > 0).all()
    assert scene.meshes[0].morph_names[:46] == BLENDSHAPE_NAMES
    with pytest.raises(ValueRangeError, match="without"):
        few = BlendshapeRig(rig.neutral, rig.names[:3], rig.deltas[:3])
        write_performance_glb(tmp_path / "b.glb", acted, few, builtin_face)
    assert not (tmp_path / "b.glb").exists()


def test_glb_has_arkit_weights_of_the_gaze(tmp_path: Path, rng: np.random.Generator, builtin_face: Face) -> None:
    acted = performance(rng)
    rig = BlendshapeRig(builtin_face.mean_shape, BLENDSHAPE_NAMES, builtin_face.blendshape_deltas)
    write_performance_glb(tmp_path / "a.glb", acted, rig, builtin_face)
    scene = read_gltf(tmp_path / "a.glb")
    names, clip = scene.meshes[0].morph_names, scene.animations[0]
    assert len(names) == 54 and clip.weights is not None and scene.meshes[0].morph_deltas is not None
    assert not scene.meshes[0].morph_deltas[46:].any()  # the nodes turn the eyes
    curves, seen = curves_from_performance(acted), acted.tracked
    for side in ("Left", "Right"):
        for way in ("Up", "In", "Out"):
            ours = clip.weights[seen, names.index(f"eyeLook{way}_{side[0]}")]
            np.testing.assert_allclose(ours, curves.column(f"EyeLook{way}{side}")[seen], atol=1e-6)
    assert clip.weights[:, 46:].max() > 0.3


@pytest.mark.parametrize("places", [False, True])
def test_imported_pose_is_that_of_the_person(
    tmp_path: Path, rng: np.random.Generator, builtin_face: Face, places: bool
) -> None:
    """Another reader, and glTF's own rules for nodes and morph targets, give the vertices that we would draw."""
    acted = performance(rng)
    acted = replace(acted, translations=rng.normal((0, 0, 800), 30.0, (9, 3)))
    rig = BlendshapeRig(builtin_face.mean_shape, BLENDSHAPE_NAMES, builtin_face.blendshape_deltas)
    write_performance_glb(tmp_path / "a.glb", acted, rig, builtin_face, places=places)
    eyes = Eyeballs(builtin_face, rig.neutral)
    eyeballs = np.concatenate([eyeball_of(builtin_face, side) for side in ("right", "left")])
    frontal = np.diag([1.0, -1.0, -1.0])
    usual = np.median(acted.translations, axis=0)
    for frame in (0, 5, 8):
        head, balls = imported_pose(tmp_path / "a.glb", frame)
        expected = rig.pose(acted.weights[frame]).astype(np.float64)
        eyes.turn(expected, acted.gaze[frame])
        expected = expected @ (frontal @ acted.rotations[frame]).T
        if places:
            expected += frontal @ (acted.translations[frame] - usual)
        skin = np.setdiff1d(np.arange(len(head)), eyeballs)
        np.testing.assert_allclose(head[skin], expected[skin], atol=2e-2)  # moves below a micrometre are left out
        np.testing.assert_allclose(balls, expected[eyeballs], atol=2e-3)


def imported_pose(path: Path, frame: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return vertices of the head and of both eyeballs in a frame, millimetres, read by pygltflib."""
    pygltflib = pytest.importorskip("pygltflib")
    from scipy.spatial.transform import Rotation

    document = pygltflib.GLTF2().load(str(path))
    data = document.binary_blob()
    kinds, sizes = {5126: "<f4", 5125: "<u4", 5123: "<u2"}, {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

    def rows(view: int, offset: int, kind: int, count: int, width: int) -> NDArray[np.generic]:
        start = (document.bufferViews[view].byteOffset or 0) + (offset or 0)
        return np.frombuffer(data, kinds[kind], count * width, start).reshape(count, width)

    def array(index: int) -> NDArray[np.float64]:
        entry = document.accessors[index]
        width = sizes[entry.type]
        values = np.zeros((entry.count, width))
        if entry.bufferView is not None:
            values[:] = rows(entry.bufferView, entry.byteOffset, entry.componentType, entry.count, width)
        if entry.sparse is not None:
            where, what = entry.sparse.indices, entry.sparse.values
            ids = rows(where.bufferView, where.byteOffset, where.componentType, entry.sparse.count, 1)[:, 0]
            values[ids] = rows(what.bufferView, what.byteOffset, entry.componentType, entry.sparse.count, width)
        return values

    assert len(document.animations) == 1  # players play one at a time
    motion = {
        (channel.target.node, channel.target.path): array(document.animations[0].samplers[channel.sampler].output)
        for channel in document.animations[0].channels
    }
    nodes = document.nodes
    assert document.scenes[0].nodes == [0] and nodes[0].children == [1, 2]
    assert [nodes[k].name for k in (1, 2)] == ["eyeball_right", "eyeball_left"]

    def local(node: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        rotation = Rotation.from_quat(motion[node, "rotation"][frame]).as_matrix()
        moved = motion.get((node, "translation"))
        return rotation, np.array(nodes[node].translation or [0, 0, 0]) if moved is None else moved[frame]

    def mesh(node: int) -> NDArray[np.float64]:
        pieces, sources = [], []
        for primitive in document.meshes[nodes[node].mesh].primitives:
            vertices = array(primitive.attributes.POSITION)
            if primitive.targets:
                weights = motion[node, "weights"].reshape(-1, len(primitive.targets))[frame]
                for weight, target in zip(weights, primitive.targets, strict=True):
                    vertices += weight * array(target["POSITION"] if isinstance(target, dict) else target.POSITION)
            pieces.append(vertices)
            own = getattr(primitive.attributes, "_SOURCE_VERTEX", None)
            sources.append(np.arange(len(vertices)) if own is None else array(own)[:, 0].astype(int))
        source = np.concatenate(sources)
        whole = np.zeros((source.max() + 1, 3))
        whole[source] = np.concatenate(pieces)
        return whole

    turn, place = local(0)
    head = mesh(0) @ turn.T + place
    balls = []
    for node in (1, 2):
        own, pivot = local(node)
        balls.append((mesh(node) @ own.T + pivot) @ turn.T + place)
    return 1000 * head, 1000 * np.concatenate(balls)
