"""Performances as files: what is written reads back; the real recording plays; signs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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
    write_performance_glb(tmp_path / "a.glb", acted, rig, builtin_face.topology, copyright="test")
    scene = read_gltf(tmp_path / "a.glb")
    clip = scene.animations[0]
    np.testing.assert_allclose(clip.times, acted.times, atol=1e-6)
    np.testing.assert_allclose(clip.weights, acted.weights, atol=1e-6)
    assert clip.rotation_wxyz is not None
    assert (np.einsum("ij,ij->i", clip.rotation_wxyz[1:], clip.rotation_wxyz[:-1]) > 0).all()
    assert scene.meshes[0].morph_names == BLENDSHAPE_NAMES
    with pytest.raises(ValueRangeError, match="without"):
        few = BlendshapeRig(rig.neutral, rig.names[:3], rig.deltas[:3])
        write_performance_glb(tmp_path / "b.glb", acted, few, builtin_face.topology)
    assert not (tmp_path / "b.glb").exists()
