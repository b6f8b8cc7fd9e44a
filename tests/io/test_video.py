"""Videos in and out: times, rotation, damage, sound, pieces; written whole or not at all."""

from __future__ import annotations

import struct
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

av = pytest.importorskip("av")

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError  # noqa: E402
from facewright.io.video_reader import VideoReader  # noqa: E402
from facewright.io.video_writer import FrameClock, VideoWriter, join_videos  # noqa: E402

WIDTH, HEIGHT = 96, 64


def picture(k: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Draw a smooth picture whose corners differ; its grey level in the lower half tells the frame's number."""
    y, x = np.mgrid[:height, :width]
    image = np.stack([255 * x / width, 255 * y / height, np.full(x.shape, 128.0)], axis=2)
    image[height // 2 :] = 20 + 4 * (k % 50)
    return image.astype(np.uint8)


def number(image: np.ndarray) -> int:
    height, width = image.shape[:2]
    return round((float(image[3 * height // 4, width // 4 : width // 2].mean()) - 20) / 4)


def clip(path: Path, times: np.ndarray, rate: Fraction = Fraction(25), **size: int) -> Path:
    clock = FrameClock(times, rate)
    with VideoWriter(path, size.get("width", WIDTH), size.get("height", HEIGHT), clock, quality=5) as video:
        for k in range(len(times)):
            video.write(picture(k, **size))
    return path


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clip(tmp_path_factory.mktemp("video") / "steady.mp4", np.arange(40) / 25)


@pytest.mark.parametrize("rate", [Fraction(25), Fraction(30000, 1001), Fraction(24000, 1001), Fraction(60)])
def test_constant_rate_is_exact(tmp_path: Path, rate: Fraction) -> None:
    times = np.round(np.arange(31) / float(rate), 3)  # as containers that count milliseconds give them
    with VideoReader(clip(tmp_path / "a.mp4", times, rate)) as video:
        frames = list(video)
    assert video.info.frame_rate == rate and not video.notes
    assert [number(frame.image) for frame in frames] == list(range(31))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(31) / float(rate), atol=1e-9)


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_varying_rate_keeps_its_times(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    times = np.cumsum(rng.uniform(0.01, 0.2, 20))
    with VideoReader(clip(tmp_path / f"a{suffix}", times)) as video:
        frames = list(video)
    np.testing.assert_allclose([frame.time for frame in frames], times - times[0], atol=1.1e-3)
    assert [number(frame.image) for frame in frames] == list(range(20))


def test_colours_come_back(steady: Path) -> None:
    inner = (slice(2, HEIGHT // 2 - 2), slice(2, -2))
    with VideoReader(steady) as video:
        frame = next(iter(video))
    assert frame.image.flags.c_contiguous
    assert np.abs(frame.image[inner].astype(int) - picture(0)[inner]).mean() < 2
    with av.open(str(steady)) as container:  # read with accurate rounding: what we write is not darker
        exact = next(container.decode(video=0)).to_ndarray(format="rgb24", interpolation=0xC2004)
    assert abs((exact[inner].astype(int) - picture(0)[inner]).mean()) < 0.3


def test_odd_sizes_are_made_even(tmp_path: Path) -> None:
    with VideoReader(clip(tmp_path / "a.mp4", np.arange(3) / 25, width=95, height=63)) as video:
        assert next(iter(video)).image.shape == (64, 96, 3)


def turned(source: Path, target: Path, degrees: int) -> Path:
    """Copy an MP4 with another display matrix in its track header."""
    data = bytearray(source.read_bytes())
    at = data.index(b"tkhd") + 4 + 4 + 20 + 8 + 8
    cos, sin = round(np.cos(np.deg2rad(degrees))) << 16, round(np.sin(np.deg2rad(degrees))) << 16
    data[at : at + 36] = struct.pack(">9i", cos, sin, 0, -sin, cos, 0, 0, 0, 1 << 30)
    target.write_bytes(data)
    return target


@pytest.mark.parametrize("degrees, turns", [(90, 3), (180, 2), (270, 1)])
def test_rotation_metadata_is_applied(tmp_path: Path, steady: Path, degrees: int, turns: int) -> None:
    with VideoReader(turned(steady, tmp_path / "turned.mp4", degrees)) as video, VideoReader(steady) as upright:
        seen, stored = next(iter(video)).image, next(iter(upright)).image
    assert video.info.quarter_turns == turns
    assert (video.info.height, video.info.width) == seen.shape[:2]
    # The matrix turns clockwise by so many degrees when the picture is shown.
    np.testing.assert_array_equal(seen, np.rot90(stored, -degrees // 90))


def test_start_skips_frames(steady: Path) -> None:
    with VideoReader(steady) as video:
        frames = list(video.frames(start=33))
    assert [frame.number for frame in frames] == list(range(33, 40))
    assert number(frames[0].image) == 33 and frames[0].time == pytest.approx(33 / 25)
    with VideoReader(steady) as video:
        list(video)
        with pytest.raises(ValueRangeError, match="once"):
            next(video.frames())


def test_truncated_file_gives_the_frames_up_to_there(tmp_path: Path, steady: Path) -> None:
    data = steady.read_bytes()
    (tmp_path / "cut.mp4").write_bytes(data[: int(0.6 * len(data))])
    with VideoReader(tmp_path / "cut.mp4") as video:
        frames = list(video)
    assert 5 < len(frames) < 40
    assert [number(frame.image) for frame in frames] == list(range(len(frames)))
    assert len(video.notes) == 1 and f"{len(frames)} " in video.notes[0]


def test_truncated_grid_clip(tmp_path: Path, test_data: Path) -> None:
    data = (test_data / "video" / "bbaf2n.mpg").read_bytes()
    (tmp_path / "cut.mpg").write_bytes(data[: len(data) // 2])
    with VideoReader(tmp_path / "cut.mpg") as video:
        n = len(list(video))
    assert 20 < n < 60
    assert len(video.notes) == 1 and f"ends early, within a packet: {n} frames" in video.notes[0]
    with VideoReader(test_data / "video" / "bbaf2n.mpg") as whole:
        list(whole)
    assert whole.notes == []


def test_damage_in_the_middle_is_passed_over_and_said(tmp_path: Path, steady: Path, rng: np.random.Generator) -> None:
    data = bytearray(steady.read_bytes())
    start = data.index(b"mdat") + (len(data) - data.index(b"mdat")) // 2
    data[start : start + 300] = rng.bytes(300)
    (tmp_path / "bad.mp4").write_bytes(data)
    with VideoReader(tmp_path / "bad.mp4") as video:
        n = len(list(video))
    assert n >= 20
    assert n == 40 or video.notes


def sound_only(path: Path, codec: str = "aac", seconds: float = 1.0) -> Path:
    with av.open(str(path), "w") as out:
        track = out.add_stream(codec, rate=44100)
        t = np.arange(int(44100 * seconds)) / 44100
        wave = (8000 * np.sin(2 * np.pi * 440 * t)).astype(np.int16)
        for k in range(0, len(wave), 1024):
            frame = av.AudioFrame.from_ndarray(wave[None, k : k + 1024], format="s16", layout="mono")
            frame.rate, frame.pts = 44100, k
            for packet in track.encode(frame):
                out.mux(packet)
        for packet in track.encode(None):
            out.mux(packet)
    return path


def test_what_is_no_video_is_refused_by_a_sentence(tmp_path: Path, rng: np.random.Generator) -> None:
    from PIL import Image

    Image.fromarray(picture(0)).save(tmp_path / "still.png")
    Image.fromarray(picture(0)).save(tmp_path / "still.jpg")
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "noise.mp4").write_bytes(rng.bytes(5000))
    (tmp_path / "list.m3u8").write_text("#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n")
    sound_only(tmp_path / "sound.m4a")
    for name, sentence in {
        "still.png": "still picture",
        "still.jpg": "still picture",
        "empty.mp4": "empty file",
        "noise.mp4": "must be a video",
        "list.m3u8": "must be a video|frames that can be decoded",
        "sound.m4a": "sound only",
    }.items():
        with pytest.raises(FileFormatError, match=sentence):
            VideoReader(tmp_path / name)
    for name in ("none.mp4", "."):
        with pytest.raises(StoreError):
            VideoReader(tmp_path / name)


def heard(path: Path) -> tuple[str, np.ndarray]:
    """Return codec and samples of a file's sound."""
    with av.open(str(path)) as container:
        track = container.streams.audio[0]
        parts = [frame.to_ndarray().mean(axis=0) for frame in container.decode(track)]
        return track.codec_context.name, np.concatenate(parts)


def test_pieces_join_with_sound_and_the_same_frames(tmp_path: Path) -> None:
    clock = FrameClock(np.arange(30) / 25, Fraction(25))
    pieces = []
    for k in range(0, 30, 12):
        pieces.append(tmp_path / f"{k}.mp4")
        with VideoWriter(pieces[-1], WIDTH, HEIGHT, clock, first=k, quality=5) as video:
            for frame in range(k, min(k + 12, 30)):
                video.write(picture(frame))
    with pytest.raises(FileFormatError, match="30 frames together, got 24"):
        join_videos(tmp_path / "out.mp4", pieces[:2], clock)
    assert not (tmp_path / "out.mp4").exists()
    assert join_videos(tmp_path / "out.mp4", pieces, clock, sound_of=sound_only(tmp_path / "a.m4a")) == []
    with VideoReader(tmp_path / "out.mp4") as video:
        frames = list(video)
    assert [number(frame.image) for frame in frames] == list(range(30))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(30) / 25, atol=1e-9)
    assert video.info.frame_rate == 25 and video.info.has_audio
    codec, samples = heard(tmp_path / "out.mp4")
    assert codec == "aac"
    np.testing.assert_array_equal(samples, heard(tmp_path / "a.m4a")[1])  # copied, not encoded again
    first = (tmp_path / "out.mp4").read_bytes()
    join_videos(tmp_path / "again.mp4", pieces, clock, sound_of=tmp_path / "a.m4a")
    assert (tmp_path / "again.mp4").read_bytes() == first


def test_sound_of_a_grid_clip_is_encoded_again_in_step(tmp_path: Path, test_data: Path) -> None:
    source = test_data / "video" / "lrwp9a.mpg"
    clock = FrameClock(np.arange(75) / 25, Fraction(25))
    with VideoWriter(tmp_path / "p.mp4", WIDTH, HEIGHT, clock) as video:
        for k in range(75):
            video.write(picture(k))
    assert join_videos(tmp_path / "out.mp4", [tmp_path / "p.mp4"], clock, sound_of=source) == []
    codec, samples = heard(tmp_path / "out.mp4")
    original = heard(source)[1].astype(float)
    assert codec == "aac"
    n = min(len(samples), len(original))
    assert abs(len(samples) - len(original)) < 3000
    spectrum = np.fft.rfft(samples[:n], 2 * n) * np.conj(np.fft.rfft(original[:n], 2 * n))
    lag = int(np.argmax(np.fft.irfft(spectrum)))
    assert min(lag, 2 * n - lag) < 44100 * 0.005  # within 5 ms


def test_nothing_is_left_of_a_failed_video(tmp_path: Path) -> None:
    clock = FrameClock(np.arange(5) / 25, Fraction(25))
    with pytest.raises(KeyboardInterrupt), VideoWriter(tmp_path / "a.mp4", WIDTH, HEIGHT, clock) as video:
        video.write(picture(0))
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_wrong_use_is_refused(tmp_path: Path) -> None:
    clock = FrameClock(np.arange(1) / 25, Fraction(25))
    with pytest.raises(ValueRangeError, match="must end in"):
        VideoWriter(tmp_path / "a.gif", WIDTH, HEIGHT, clock)
    with pytest.raises(ValueRangeError, match="2 to 16384"):
        VideoWriter(tmp_path / "a.mp4", 1, HEIGHT, clock)
    with pytest.raises(ValueRangeError, match="increase"):
        FrameClock([0.0, 0.0], Fraction(25))
    with VideoWriter(tmp_path / "a.mp4", WIDTH, HEIGHT, clock) as video:
        with pytest.raises(ShapeError):
            video.write(picture(0)[:, :-1])
        video.write(picture(0))
        with pytest.raises(ValueRangeError, match="one more"):
            video.write(picture(1))


_READ_MUCH = """
import resource, sys
from facewright.io.video_reader import VideoReader
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with VideoReader(sys.argv[1]) as video:
    for frame in video:
        if frame.number == 60:
            early = peak()
print(frame.number, peak() - early)
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_length(tmp_path: Path) -> None:
    path = clip(tmp_path / "long.mp4", np.arange(1200) / 25, width=320, height=240)
    run = subprocess.run([sys.executable, "-c", _READ_MUCH, path], capture_output=True, text=True, check=True)
    last, growth = map(int, run.stdout.split())
    assert last == 1199
    assert growth < 8_000  # kB; all frames together are 270,000
