"""Recordings of a performer become one file: markers by registration, mesh sequences without."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from facewright.apps.import_mocap import ImportMocapRequest, import_mocap
from facewright.apps.mesh_sequences import performer_from_meshes, read_mesh_sequence
from facewright.errors import FileFormatError, StoreError, TopologyError, ValueRangeError
from facewright.faces.coarse_face import coarse_face
from facewright.faces.performers import simulate_performers
from facewright.io.marker_data import MarkerData
from facewright.io.markers import write_markers
from facewright.io.obj import write_obj
from facewright.mesh.mesh_sequence import MeshSequence
from facewright.models.sequence_store import load_performer


@pytest.fixture(scope="module")
def performer(builtin_face):
    return simulate_performers(builtin_face, np.random.default_rng(33), names=("F1",))[0]


@pytest.fixture(scope="module")
def recordings(performer, tmp_path_factory):
    """A folder of two short recordings: CSV with unit, TRC."""
    folder = tmp_path_factory.mktemp("F1")
    rng = np.random.default_rng(3)
    for name, suffix, frames in (("neutral", ".trc", slice(0, 6)), ("pride_05", ".csv", slice(100, 220, 12))):
        clip = performer.clip(name)
        positions = clip.marker_truth(frames)
        positions += rng.normal(0, 0.2, positions.shape)
        times = np.arange(len(positions)) / 10.0
        if name != "neutral":
            positions[3:5, 11] = np.nan
        write_markers(folder / (name + suffix), MarkerData(times, performer.layout.labels, positions))
    return folder


def test_markers_to_a_performer(recordings, tmp_path, performer):
    stages = set()
    request = ImportMocapRequest((recordings,), tmp_path / "f1.fwms", up="y", picture=tmp_path / "f1.png")
    result = import_mocap(request, lambda stage, done, total: stages.add(stage))
    assert stages == {"reading recordings", "registering clips"}
    data = load_performer(tmp_path / "f1.fwms")
    assert data.name == "f1" and data.clip_names == ("neutral", "pride_05") and data.n_vertices == 397
    assert data.template == "builtin" and data.mirror is not None
    true = performer.clip("pride_05").meshes(slice(100, 220, 12)).vertices[:, data.vertex_ids]
    error = np.linalg.norm(data.clip("pride_05").recorded() - true, axis=2)
    assert np.sqrt((error**2).mean()) < 2.0
    assert any("2 unseen values" in note for note in result.notes)
    assert json.dumps(result.summary()) and result.summary()["frames"] == 16
    from PIL import Image

    picture = np.asarray(Image.open(tmp_path / "f1.png").convert("RGB")).astype(int)
    yellow = (picture[..., 0] > 220) & (picture[..., 1] > 170) & (picture[..., 2] < 120)
    blue = picture[..., 2] > picture[..., 0] + 25
    assert yellow.sum() > 2000 and blue.sum() > 5000


def test_command_line(tmp_path):
    from facewright.cli.main import app

    points, faces = _sheet()
    clip = np.stack([points, points + np.float32(1)])
    np.savez(tmp_path / "wave.npz", times=np.arange(2.0), vertices=clip, faces=faces)
    words = ["mocap", "import", "--meshes", str(tmp_path / "wave.npz"), "-o", str(tmp_path / "a.fwms")]
    done = CliRunner().invoke(app, [*words, "--json", "--vertices", "60"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["vertices"] == 60 and found["clips"] == 1 and (tmp_path / "a.png").is_file()
    assert load_performer(tmp_path / "a.fwms").n_vertices == 60
    assert "2 frames of 60 vertices" in CliRunner().invoke(app, [*words, "--vertices", "60"]).stdout


def test_refused_recordings(recordings, tmp_path):
    out = tmp_path / "a.fwms"
    (tmp_path / "empty").mkdir()
    for files, error, match in (
        ((tmp_path / "none.c3d",), StoreError, "nothing there"),
        ((tmp_path / "empty",), FileFormatError, "marker files"),
        ((recordings, recordings / "neutral.trc"), ValueRangeError, "twice"),
    ):
        with pytest.raises(error, match=match):
            import_mocap(ImportMocapRequest(files, out))
    with pytest.raises(ValueRangeError, match="at least one"):
        ImportMocapRequest((), out)
    with pytest.raises(ValueRangeError, match="neutral"):
        import_mocap(ImportMocapRequest((recordings,), out, up="y", neutral="smile:0"))
    assert not out.exists()


def test_mesh_sequences_of_a_known_face_need_no_fitting(performer, tmp_path, builtin_face):
    clip = performer.clip("rage_01").meshes(slice(0, 120, 12))
    np.savez(tmp_path / "rage.npz", times=clip.times, vertices=clip.vertices, faces=clip.faces)
    request = ImportMocapRequest((tmp_path / "rage.npz",), tmp_path / "a.fwms", meshes=True, picture=tmp_path / "a.png")
    data = import_mocap(request).data
    coarse = coarse_face(builtin_face)
    assert np.array_equal(data.vertex_ids, coarse.vertex_ids) and np.array_equal(data.faces, coarse.faces)
    assert data.template == "builtin" and data.mirror is not None and (tmp_path / "a.png").is_file()
    recorded = data.clip("rage").recorded()
    assert np.abs(recorded - clip.vertices[:, data.vertex_ids]).max() < 0.01
    still = np.linalg.norm(data.clip("rage").vertices - data.neutral, axis=2)
    assert np.median(still) < 3.0


def _sheet(n=12):
    i, k = np.divmod(np.arange(n * n), n)
    points = np.stack([10.0 * k, 10.0 * i, 0.3 * (k - 5.0) ** 2], axis=1)
    q = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (q[:-1, :-1], q[:-1, 1:], q[1:, 1:], q[1:, :-1]))
    return points.astype(np.float32), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def test_folders_of_meshes_in_the_order_of_numbers(tmp_path):
    points, faces = _sheet()
    (tmp_path / "wave").mkdir()
    for k in (0, 1, 2, 10):
        moved = points + np.float32(k) * (points[:, :1] > 60.0) * np.array([0, 0, 1], np.float32)
        write_obj(tmp_path / "wave" / f"frame_{k}.obj", moved, faces)
    clip = read_mesh_sequence(tmp_path / "wave", 25.0)
    assert np.allclose(clip.times, np.arange(4) / 25.0)
    assert np.allclose(clip.vertices[:, -1, 2] - points[-1, 2], [0, 1, 2, 10], atol=1e-4)
    whole = performer_from_meshes({"wave": clip}, n_vertices=None)
    assert whole.n_vertices == 144 and whole.template == "meshes" and whole.mirror is None
    few = performer_from_meshes({"wave": clip}, n_vertices=40, neutral="wave:1")
    assert few.n_vertices == 40 and few.statistics["neutral"] == "wave:1"
    assert np.abs(few.clip("wave").recorded() - clip.vertices[:, few.vertex_ids]).max() < 1e-3


def test_a_folder_of_archives_is_a_clip_each(tmp_path):
    points, faces = _sheet()
    (tmp_path / "meshes").mkdir()
    for name in ("talk", "neutral"):
        clip = np.stack([points, points + np.float32(1)])
        np.savez(tmp_path / "meshes" / f"{name}.npz", times=np.arange(2.0), vertices=clip, faces=faces)
    request = ImportMocapRequest((tmp_path / "meshes",), tmp_path / "a.fwms", meshes=True, n_vertices=60)
    data = import_mocap(request).data
    assert data.clip_names == ("neutral", "talk") and data.statistics["neutral"] == "neutral:0"
    twice = ImportMocapRequest(
        (tmp_path / "meshes", tmp_path / "meshes" / "talk.npz"), tmp_path / "b.fwms", meshes=True
    )
    with pytest.raises(ValueRangeError, match="'talk' twice"):
        import_mocap(twice)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match=r"or clips in \.npz, got none"):
        import_mocap(ImportMocapRequest((tmp_path / "empty",), tmp_path / "b.fwms", meshes=True))
    assert not (tmp_path / "b.fwms").exists()


def test_labels_of_others_exit_with_two(recordings, tmp_path):
    from facewright.cli.main import app
    from facewright.io.markers import read_markers

    folder = tmp_path / "F1"
    folder.mkdir()
    good = {name: read_markers(recordings / name, up="y").markers for name in ("neutral.trc", "pride_05.csv")}
    order = np.random.default_rng(2).permutation(len(good["pride_05.csv"].labels))
    bad = good["pride_05.csv"]
    write_markers(folder / "neutral.csv", good["neutral.trc"])
    write_markers(folder / "pride_05.csv", MarkerData(bad.times, bad.labels, bad.positions[:, order]))
    done = CliRunner().invoke(app, ["mocap", "import", str(folder), "-o", str(tmp_path / "a.fwms"), "--up", "y"])
    assert done.exit_code == 2 and "clip pride_05 must" in done.stderr.replace("\n", " ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["F1"]


def test_the_picture_frames_everything():
    from facewright.apps.mocap_picture import _VIEWS, _frame
    from facewright.imaging.portrait import portrait_view

    points = np.random.default_rng(0).uniform([-90, -100, 20], [90, 150, 130], (300, 3))
    size = (420, 360)
    frame = _frame(points, size)
    pixels = np.concatenate(
        [
            portrait_view(points, size, yaw_degrees=yaw, centre_mm=frame.centre, height_mm=frame.height)[1]
            for yaw in _VIEWS
        ]
    )
    assert (pixels > 5).all() and (pixels < np.array(size[::-1]) - 6).all()
    assert (np.ptp(pixels, axis=0) / size[::-1]).max() > 0.8


def test_refused_meshes(tmp_path):
    points, faces = _sheet()
    apart = np.concatenate([points, points + np.float32(500)]), np.concatenate([faces, faces + 144])
    clip = MeshSequence(np.arange(2.0), np.stack([apart[0]] * 2), apart[1])
    with pytest.raises(TopologyError, match="one connected piece, got 2"):
        performer_from_meshes({"a": clip})
    loose = MeshSequence(np.arange(1.0), points[None], faces[:-2])
    one = MeshSequence(np.arange(1.0), points[None], faces)
    with pytest.raises(TopologyError, match="another in b"):
        performer_from_meshes({"a": one, "b": loose})
    with pytest.raises(ValueRangeError, match="at least one clip"):
        performer_from_meshes({})
    with pytest.raises(ValueRangeError, match="neutral"):
        performer_from_meshes({"a": one}, neutral="a:1")
    with pytest.raises(ValueRangeError, match="n must"):
        performer_from_meshes({"a": one}, n_vertices=2)
    with pytest.raises(StoreError):
        read_mesh_sequence(tmp_path / "none", 30.0)
    with pytest.raises(FileFormatError, match="got none"):
        read_mesh_sequence(tmp_path, 30.0)
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    with pytest.raises(FileFormatError, match="npz"):
        read_mesh_sequence(tmp_path / "bad.npz", 30.0)
    np.savez(tmp_path / "half.npz", times=np.arange(1.0))
    with pytest.raises(FileFormatError, match="npz"):
        read_mesh_sequence(tmp_path / "half.npz", 30.0)
    (tmp_path / "mixed").mkdir()
    write_obj(tmp_path / "mixed" / "0.obj", points, faces)
    write_obj(tmp_path / "mixed" / "1.obj", points, faces[:-1])
    with pytest.raises(TopologyError, match=r"1\.obj"):
        read_mesh_sequence(tmp_path / "mixed", 30.0)
