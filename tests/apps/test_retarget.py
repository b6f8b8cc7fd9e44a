"""Videos and curves on a photo, from file to file: sound, times, curves, killed runs, lost faces, odd clips."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

av = pytest.importorskip("av")

from facewright.apps.animate import AnimateRequest, PhotoChoice, animate  # noqa: E402
from facewright.apps.photo_motion import MotionOptions  # noqa: E402
from facewright.apps.retarget import RetargetRequest, retarget  # noqa: E402
from facewright.apps.track_video import TrackVideoRequest, VideoChoice, track_video, write_curves  # noqa: E402
from facewright.errors import FileFormatError, NoFaceError, StoreError, ValueRangeError  # noqa: E402
from facewright.faces import Face  # noqa: E402
from facewright.io.gltf import read_gltf  # noqa: E402
from facewright.io.live_link import read_face_curves  # noqa: E402
from facewright.io.video_reader import VideoReader  # noqa: E402
from facewright.io.video_writer import FrameClock, VideoWriter, join_videos  # noqa: E402

detects = pytest.mark.landmarks


@pytest.fixture(scope="module")
def model(builtin_face: Face, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small model of people who are mixtures of the face's modes."""
    from facewright.models.bilinear import fit_bilinear
    from facewright.models.bilinear_store import save_bilinear

    rng = np.random.default_rng(3)
    face = builtin_face
    neutrals = face.mean_shape + np.tensordot(rng.normal(size=(10, len(face.identity_basis))), face.identity_basis, 1)
    shapes = np.concatenate([np.zeros((1, *face.mean_shape.shape)), face.blendshape_deltas])
    tensor = (neutrals[:, None] + rng.uniform(0.8, 1.2, (10, 47, 1, 1)) * shapes).astype(np.float32)
    names = ("neutral", *face.blendshape_names)
    built = fit_bilinear(tensor, 8, 30, topology=face.topology, expression_names=names, provenance={"face": "builtin"})
    path = tmp_path_factory.mktemp("model") / "small.fwbm"
    save_bilinear(built, path)
    return path


@pytest.fixture(scope="module")
def photo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mediapipe")
    astronaut = pytest.importorskip("skimage.data").astronaut()
    path = tmp_path_factory.mktemp("photo") / "astronaut.png"
    Image.fromarray(astronaut).crop((80, 0, 400, 240)).save(path)
    return path


@pytest.fixture(scope="module")
def actor(test_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of a GRID clip, with its sound; frames 10 to 13 and the last six show no face."""
    folder, source = tmp_path_factory.mktemp("actor"), test_data / "video" / "lrwp9a.mpg"
    with VideoReader(source) as video:
        frames = [frame.image for frame, _ in zip(video, range(26))]
    clock = FrameClock(np.arange(26) / 25, Fraction(25))
    with VideoWriter(folder / "piece.mp4", 360, 288, clock) as out:
        for k, image in enumerate(frames):
            out.write(np.full_like(image, 90) if 10 <= k < 14 or k >= 20 else image)
    join_videos(folder / "actor.mp4", [folder / "piece.mp4"], clock, sound_of=source)
    return folder / "actor.mp4"


@detects
def test_retarget_keeps_sound_and_times_and_says_what_it_did(
    tmp_path: Path, model: Path, photo: Path, actor: Path
) -> None:
    out = tmp_path / "out.mp4"
    stages = []
    request = RetargetRequest(VideoChoice(actor), PhotoChoice(photo, model), out, csv=True, glb=True)
    result = retarget(request, lambda stage, done, total: stages.append((stage, done, total)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", "out.glb", "out.mp4"]
    with VideoReader(out) as video:
        frames = list(video)
    assert len(frames) == result.n_frames == 26
    assert frames[0].image.shape == (240, 320, 3)
    assert video.info.frame_rate == 25 and video.info.has_audio
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(26) / 25, atol=1e-9)
    curves = read_face_curves(result.paths["curves"])
    np.testing.assert_array_equal(np.flatnonzero(~curves.tracked), [10, 11, 12, 13, 20, 21, 22, 23, 24, 25])
    assert result.tracked == 16
    assert any("10 of 26 frames (10-13, 20-25)" in note for note in result.notes)
    assert len(read_gltf(result.paths["glb"]).animations[0].times) == 26
    assert {stage for stage, _, _ in stages} >= {"finding landmarks", "fitting frames", "drawing"}
    assert ("drawing", 26, 26) in stages
    # Far from the head nothing moves; the mouth does.
    still = np.stack([frame.image[:40, :40] for frame in frames]).astype(float)
    assert np.abs(still - still[0]).mean() < 0.7
    moving = np.stack([frame.image[110:170, 110:200] for frame in frames]).astype(float)
    assert np.abs(moving - moving[0]).mean() > 1.0


@detects
def test_track_writes_both_kinds_of_file(tmp_path: Path, model: Path, actor: Path, photo: Path) -> None:
    import json

    tracked = track_video(TrackVideoRequest(VideoChoice(actor), tmp_path / "a.json", model, glb=True))
    scene = read_gltf(tmp_path / "a.glb")
    assert [mesh.name for mesh in scene.meshes[1:]] == ["eyeball_right", "eyeball_left"]
    assert len(scene.animations) == 3 and scene.animations[0].translation is not None
    assert np.ptp(scene.animations[0].translation, axis=0).max() < 60  # a head that talks stays about where it is
    content = json.loads((tmp_path / "a.json").read_text())
    assert np.shape(content["weights"]) == (26, 46) and np.shape(content["rotations"]) == (26, 3, 3)
    assert content["tracked"] == tracked.performance.tracked.tolist()
    assert content["residuals_iod"][12] is None and content["residuals_iod"][0] < 0.1
    assert tracked.performance.weights.min() >= 0 and tracked.performance.weights.max() <= 1
    assert tracked.numbers["landmark_residual_iod"] < 0.08
    write_curves(tmp_path / "a.csv", tracked)
    assert read_face_curves(tmp_path / "a.csv").tracked.sum() == 16
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.glb", "a.json"]
    clips = []
    for curves in ("a.json", "a.csv"):  # both play alike, but for what CSV has one column for, and cuts: it knows none
        out = tmp_path / f"{curves}.mp4"
        played = animate(AnimateRequest(PhotoChoice(photo, model), tmp_path / curves, out))
        assert played.n_frames == 26 and played.frame_rate == 25 and played.tracked == 16
        assert any("10 of 26 frames (10-13, 20-25)" in note for note in played.notes)
        with VideoReader(out) as video:
            clips.append(np.stack([frame.image for frame in video]).astype(float))
    assert np.abs(clips[0] - clips[1])[:10].mean() < 1.0 < np.abs(clips[0][:8] - clips[0][8]).max()


@detects
def test_real_recording_plays_on_a_photo(tmp_path: Path, model: Path, photo: Path, test_data: Path) -> None:
    lines = (test_data / "curves" / "alex_rom_3.csv").read_text().splitlines()
    short = [",".join(line.split(",")[:1]) + ",0" for line in lines[31:41]]  # ten untracked rows
    (tmp_path / "part.csv").write_text("\n".join([lines[0], *lines[1:31], *short, *lines[41:61]]) + "\n")
    request = AnimateRequest(
        PhotoChoice(photo, model), tmp_path / "part.csv", tmp_path / "out.mp4", MotionOptions("keep", rest="camera")
    )
    result = animate(request)
    assert result.n_frames == 60 and result.frame_rate == 30 and result.tracked == 50
    assert any("10 of 60 frames (30-39)" in note for note in result.notes)
    with VideoReader(tmp_path / "out.mp4") as video:
        assert len(list(video)) == 60 and not video.info.has_audio


@detects
def test_video_without_a_face_is_refused(tmp_path: Path, model: Path, photo: Path) -> None:
    with VideoWriter(tmp_path / "grey.mp4", 64, 64, FrameClock(np.arange(5) / 25, Fraction(25))) as video:
        for _ in range(5):
            video.write(np.full((64, 64, 3), 128, np.uint8))
    with pytest.raises(NoFaceError, match="none was found in any of its 5 frames"):
        retarget(RetargetRequest(VideoChoice(tmp_path / "grey.mp4"), PhotoChoice(photo, model), tmp_path / "out.mp4"))
    assert not (tmp_path / "out.mp4").exists()


def test_bad_input_is_told_before_the_work(tmp_path: Path, model: Path) -> None:
    choice = PhotoChoice(tmp_path / "none.png", model)
    (tmp_path / "a.mp4").write_bytes(b"no video")
    with pytest.raises(FileFormatError, match="must be a video"):
        retarget(RetargetRequest(VideoChoice(tmp_path / "a.mp4"), choice, tmp_path / "out.mp4"))
    with pytest.raises(StoreError, match="does not exist"):
        retarget(RetargetRequest(VideoChoice(tmp_path / "none.mp4"), choice, tmp_path / "out.mp4"))
    with pytest.raises(ValueRangeError, match="must end in"):
        RetargetRequest(VideoChoice(tmp_path / "a.mp4"), choice, tmp_path / "out.gif")
    with pytest.raises(ValueRangeError, match="must end in"):
        TrackVideoRequest(VideoChoice(tmp_path / "a.mp4"), tmp_path / "out.txt")
    with pytest.raises(ValueRangeError, match="frames_per_second"):
        AnimateRequest(choice, tmp_path / "a.csv", tmp_path / "out.mp4", frames_per_second=0.0)
    (tmp_path / "a.csv").write_text("time,jawOpen\n0,0\n1,1\n")
    with pytest.raises(StoreError, match="does not exist"):
        animate(AnimateRequest(choice, tmp_path / "a.csv", tmp_path / "out.mp4"))
    with pytest.raises(StoreError, match=r"none\.wav does not exist"):
        animate(AnimateRequest(choice, tmp_path / "a.csv", tmp_path / "out.mp4", sound=tmp_path / "none.wav"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.mp4"]


@pytest.fixture(scope="module")
def frames(test_data: Path) -> dict[str, list[np.ndarray]]:
    """The first frames of two GRID clips, 360 x 288, of two people."""
    found = {}
    for name in ("bbaf2n", "lrwp9a"):
        with VideoReader(test_data / "video" / f"{name}.mpg") as video:
            found[name] = [frame.image for frame, _ in zip(video, range(14))]
    return found


def written(path: Path, images: list[np.ndarray], times: np.ndarray | None = None) -> Path:
    clock = FrameClock(np.arange(len(images)) / 25 if times is None else times, Fraction(25))
    height, width = images[0].shape[:2]
    with VideoWriter(path, width, height, clock) as video:
        for image in images:
            video.write(image)
    return path


def outcomes(folder: Path, clip: Path, model: Path, photo: Path) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """Track and retarget a clip: notes, and which frames showed a face."""
    tracked = track_video(TrackVideoRequest(VideoChoice(clip), folder / "a.json", model))
    yield tracked.notes, tracked.performance.tracked
    out = folder / "out.mp4"
    result = retarget(RetargetRequest(VideoChoice(clip), PhotoChoice(photo, model), out), None)
    with VideoReader(out) as video:
        drawn = list(video)
    np.testing.assert_allclose(
        [frame.time for frame in drawn], tracked.performance.times - tracked.performance.times[0], atol=1.1e-3
    )
    assert result.n_frames == len(drawn) == tracked.performance.n_frames
    assert result.tracked == tracked.performance.tracked.sum()
    yield result.notes, tracked.performance.tracked


@detects
def test_scene_cut_begins_anew(tmp_path: Path, model: Path, photo: Path, frames: dict[str, list[np.ndarray]]) -> None:
    clip = written(tmp_path / "cut.mp4", frames["bbaf2n"] + frames["lrwp9a"])
    for notes, tracked in outcomes(tmp_path, clip, model, photo):
        assert any("1 scene cut (at frame 14):" in note for note in notes), notes
        assert tracked.all()


def test_sound_alone_is_refused_before_the_work(tmp_path: Path, model: Path) -> None:
    clip = tmp_path / "sound.m4a"
    with av.open(str(clip), "w") as out:
        track = out.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.int16), format="s16", layout="mono")
        frame.rate = 44100
        out.mux(track.encode(frame) + track.encode(None))
    with pytest.raises(FileFormatError, match="sound only"):
        track_video(TrackVideoRequest(VideoChoice(clip), tmp_path / "a.csv", model))
    with pytest.raises(FileFormatError, match="sound only"):
        retarget(RetargetRequest(VideoChoice(clip), PhotoChoice(tmp_path / "none.png", model), tmp_path / "out.mp4"))
    assert [path.name for path in tmp_path.iterdir()] == ["sound.m4a"]


@detects
@pytest.mark.slow
def test_varying_frame_rate_keeps_its_times(
    tmp_path: Path, model: Path, photo: Path, frames: dict[str, list[np.ndarray]], rng: np.random.Generator
) -> None:
    times = np.cumsum(rng.uniform(0.02, 0.12, 14))
    clip = written(tmp_path / "varying.mp4", frames["lrwp9a"], times)
    for _, tracked in outcomes(tmp_path, clip, model, photo):
        assert tracked.all()
    with VideoReader(tmp_path / "out.mp4") as video:
        np.testing.assert_allclose([frame.time for frame in video], times - times[0], atol=1.1e-3)


@detects
@pytest.mark.slow
def test_clip_on_its_side_is_turned_upright(
    tmp_path: Path, model: Path, photo: Path, frames: dict[str, list[np.ndarray]]
) -> None:
    lying = written(tmp_path / "lying.mp4", [np.ascontiguousarray(np.rot90(image)) for image in frames["lrwp9a"]])
    data = bytearray(lying.read_bytes())
    at = data.index(b"tkhd") + 4 + 4 + 20 + 8 + 8  # the display matrix: a quarter turn clockwise
    data[at : at + 36] = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    clip = tmp_path / "turned.mp4"
    clip.write_bytes(data)
    for notes, tracked in outcomes(tmp_path, clip, model, photo):
        assert any("turned upright by" in note for note in notes), notes
        assert tracked.all()


@detects
@pytest.mark.slow
def test_clip_that_breaks_off_is_used_as_far_as_it_goes(
    tmp_path: Path, model: Path, photo: Path, test_data: Path
) -> None:
    clip = tmp_path / "broken.mpg"
    clip.write_bytes((test_data / "video" / "lrwp9a.mpg").read_bytes()[:90_000])
    with VideoReader(clip) as video:
        n = len(list(video))
    assert 3 < n < 60
    for notes, tracked in outcomes(tmp_path, clip, model, photo):
        assert len(tracked) == n and tracked.all()
        assert any("broken.mpg ends early" in note for note in notes)


_RUN = """
import os, signal, sys
from pathlib import Path
from facewright.apps import draw_clip, landmark_video
from facewright.apps.animate import PhotoChoice
from facewright.apps.retarget import RetargetRequest, retarget
from facewright.apps.track_video import VideoChoice
landmark_video.PIECE = draw_clip.PIECE = 8
actor, photo, model, out, stage, frame = sys.argv[1:]
def progress(name, done, total):
    if name == stage and done == int(frame):
        os.kill(os.getpid(), signal.SIGKILL)
retarget(RetargetRequest(VideoChoice(Path(actor)), PhotoChoice(Path(photo), Path(model)), Path(out)), progress)
"""


@detects
@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills by signal")
def test_killed_runs_end_with_the_same_bytes(tmp_path: Path, model: Path, photo: Path, actor: Path) -> None:
    def run(out: Path, stage: str = "-", frame: int = 0) -> int:
        words = [str(word) for word in (actor, photo, model, out, stage, frame)]
        return subprocess.run([sys.executable, "-c", _RUN, *words], capture_output=True, check=False).returncode

    whole, killed = tmp_path / "a" / "out.mp4", tmp_path / "b" / "out.mp4"
    whole.parent.mkdir()
    killed.parent.mkdir()
    assert run(whole) == 0
    for stage, frame in (("finding landmarks", 13), ("fitting frames", 5), ("drawing", 3), ("drawing", 20)):
        assert run(killed, stage, frame) == -9
        assert not killed.exists()
    assert run(killed) == 0
    assert killed.read_bytes() == whole.read_bytes()
    assert [path.name for path in killed.parent.iterdir()] == ["out.mp4"]
