import numpy as np
import pytest

from facewright.apps.pose_export import BAKED_MM, PoseExportRequest, export_pose, read_pose_csv
from facewright.apps.pose_session import PoseSession
from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.gltf import read_gltf
from facewright.io.obj import read_obj
from facewright.io.ply import read_ply


@pytest.fixture
def session(patch):
    session = PoseSession(patch[0], holistic=patch[1])
    session.set_key(0.5)
    session.drag(52, session.model.neutral[52] + [0, 5, 1])
    session.set_key(1.0)
    session.drag(10, session.model.neutral[10] + [2, -5, 3])
    session.set_key(1.5)
    return session


def _truth(session, times):
    poses = []
    for time in times:
        poses.append(session.seek(time).astype(np.float64))
    return np.array(poses)


@pytest.mark.parametrize("morphs", ["baked", "coefficients"])
def test_gltf_plays_the_same_motion(session, tmp_path, morphs):
    result = export_pose(session, PoseExportRequest(tmp_path / "a.glb", "glb", 20.0, morphs=morphs))
    assert result.n_frames == 21 and result.error_mm < BAKED_MM
    scene = read_gltf(result.path)
    mesh, clip = scene.meshes[0], scene.animations[0]
    np.testing.assert_allclose(clip.times, np.arange(21) / 20, atol=1e-6)
    played = mesh.vertices + np.tensordot(clip.weights, mesh.morph_deltas, axes=1)
    assert np.abs(played - _truth(session, 0.5 + clip.times)).max() < BAKED_MM + 1e-3
    if morphs == "baked":
        assert result.n_morphs <= 6 and np.abs(clip.weights).max() <= 1 + 1e-6
    else:
        assert result.n_morphs == session.model.n_coefficients
        assert mesh.morph_names[0].startswith(session.model.regions.names[0])


@pytest.mark.parametrize(("kind", "suffix"), [("region", "obj"), ("holistic", "ply")])
def test_meshes_are_the_poses(session, tmp_path, kind, suffix):
    folder = tmp_path / "frames"
    result = export_pose(session, PoseExportRequest(folder, suffix, 4.0, kind=kind))
    files = sorted(folder.iterdir())
    assert result.n_frames == 5 and [f.name for f in files] == [f"frame_{k:04d}.{suffix}" for k in range(1, 6)]
    read = read_obj if suffix == "obj" else read_ply
    for k, file in enumerate(files):
        session.seek(0.5 + k / 4)
        np.testing.assert_allclose(read(file).vertices, session.positions(kind), atol=1e-3)


def test_coefficients_come_back(session, tmp_path):
    result = export_pose(session, PoseExportRequest(tmp_path / "a.csv", "csv", 10.0))
    table = read_pose_csv(result.path, session.model)
    np.testing.assert_allclose(table.coefficients, session.sample(0.5 + table.times), atol=1e-12)
    assert table.times[0] == 0 and len(table) == 11


def test_without_keyframes_the_present_pose(patch, tmp_path):
    session = PoseSession(patch[0])
    session.drag(52, session.model.neutral[52] + [0, 5, 1])
    session.release()
    result = export_pose(session, PoseExportRequest(tmp_path / "a.glb", "glb"))
    scene = read_gltf(result.path)
    assert not scene.animations and result.n_frames == 1
    mesh = scene.meshes[0]
    posed = mesh.vertices + np.tensordot(mesh.weights, mesh.morph_deltas, axes=1)
    np.testing.assert_allclose(posed, session.positions(), atol=BAKED_MM)
    neutral = PoseSession(patch[0])
    assert export_pose(neutral, PoseExportRequest(tmp_path / "n.glb", "glb")).n_morphs == 0


def test_refuses(session, patch, tmp_path):
    def export(**changes):
        export_pose(session, PoseExportRequest(**{"out": tmp_path / "a.glb", "format": "glb", **changes}))

    for changes, words in (
        ({"format": "fbx"}, "format must be one of"),
        ({"kind": "both"}, "kind must be one of"),
        ({"morphs": "all"}, "morphs must be one of"),
        ({"frames_per_second": 0.0}, "positive"),
        ({"frames_per_second": 1e12}, "at most"),
        ({"out": tmp_path / "a.csv"}, "end in .glb"),
    ):
        with pytest.raises(ValueRangeError, match=words):
            export(**changes)
    with pytest.raises(StoreError):
        export(out=tmp_path / "nowhere" / "a.csv", format="csv")
    with pytest.raises(StoreError):
        read_pose_csv(tmp_path / "none.csv", session.model)
    export(out=tmp_path / "a.csv", format="csv")
    with pytest.raises(FileFormatError, match="columns"):
        read_pose_csv(tmp_path / "a.csv", patch[1])
    text = (tmp_path / "a.csv").read_text()
    (tmp_path / "a.csv").write_text(text + text.splitlines()[1] + "\n")
    with pytest.raises(FileFormatError, match="cell"):
        read_pose_csv(tmp_path / "a.csv", session.model)
