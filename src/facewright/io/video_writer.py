"""Videos out: H.264 in MP4, MOV or MKV, written whole or not at all, in pieces that a killed run can take up again."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingExtraError, ShapeError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.io.video_reader import import_av

WRITE_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv")
#: Fixed, so that the bytes do not depend on the machine's number of cores.
_ENCODER_THREADS = "2"
_BT709 = 1
# Bicubic chroma, accurate rounding: the plain conversion darkens by one grey level.
_ACCURATE = 0x4 | 0x2000 | 0x40000 | 0x80000
#: Containers that count milliseconds move frames of a constant rate by half of one.
_ROUNDING = 6e-4


class FrameClock:
    """Times of frames as whole ticks: exact for a constant frame rate, 1/90,000 s for a varying one.

    Parameters
    ----------
    times : array-like of shape (T,), seconds
        Of all frames, increasing; the first becomes zero.
    frame_rate : Fraction
        The rate that a constant one is compared with.

    Raises
    ------
    ValueRangeError
        If there is no frame or times do not increase.
    """

    def __init__(self, times: Sequence[float] | NDArray[np.float64], frame_rate: Fraction) -> None:
        seconds = np.asarray(times, dtype=np.float64)
        if not len(seconds) or not np.isfinite(seconds).all() or (np.diff(seconds) <= 0).any():
            raise ValueRangeError(f"times must be at least one and increase, got {len(seconds)} that do not.")
        seconds = seconds - seconds[0]
        even = np.arange(len(seconds)) / float(frame_rate)
        self.frame_rate = Fraction(frame_rate)
        self.is_constant = bool(np.abs(seconds - even).max() < max(0.02 / float(frame_rate), _ROUNDING))
        if self.is_constant:
            self.time_base = Fraction(1, self.frame_rate.numerator)
            self.ticks = np.arange(len(seconds), dtype=np.int64) * self.frame_rate.denominator
        else:
            self.time_base = Fraction(1, 90_000)
            ticks = np.round(seconds * 90_000).astype(np.int64)
            room = np.arange(len(ticks))
            self.ticks = np.maximum.accumulate(ticks - room) + room  # frames closer than a tick stay apart

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.ticks)


class VideoWriter:
    """A video being written; what it holds appears under its name when the body ends without an error.

    H.264, 4:2:0, BT.709 colours, sizes made even by repeating the last row or column. No frame depends on a later one,
    so that pieces can be joined.

    Parameters
    ----------
    path : str or Path
        Ends in one of `WRITE_SUFFIXES`.
    width, height : int, pixels
        Of the pictures to come.
    clock : FrameClock
        When each frame of the whole video is shown.
    first : int
        Number of the first frame to come, where this is a piece.
    quality : int
        H.264's constant rate factor: 0 without loss, 18 hardly visible loss, 51 worst.

    Raises
    ------
    MissingExtraError
        If PyAV is not installed, or its FFmpeg cannot write H.264.
    ValueRangeError
        If suffix, size or quality are out of range.
    StoreError
        If the file cannot be written.
    """

    def __init__(
        self, path: str | Path, width: int, height: int, clock: FrameClock, *, first: int = 0, quality: int = 18
    ) -> None:
        check_video_path(path)
        if not (2 <= width <= 16384 and 2 <= height <= 16384):
            raise ValueRangeError(f"size must be 2 to 16384 pixels each way, got {width} x {height}.")
        if not 0 <= quality <= 51:
            raise ValueRangeError(f"quality must be in [0, 51], got {quality}.")
        self.path, self.size, self.clock, self.quality = Path(path), (height, width), clock, quality
        self._next = first

    def __enter__(self) -> VideoWriter:
        av = import_av()
        self._av = av
        self._stack = ExitStack()
        try:
            temporary = self._stack.enter_context(write_atomically(self.path))
            self._container = self._stack.enter_context(
                av.open(str(temporary), "w", format=_muxer(self.path), options={"movflags": "+faststart"})
            )
            self._stream = self._new_stream()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                for packet in self._stream.encode():
                    self._mux(packet)
        except BaseException as failed:
            self._stack.__exit__(type(failed), failed, failed.__traceback__)
            raise
        self._stack.__exit__(kind, error, trace)

    def write(self, image: NDArray[np.uint8]) -> None:
        """Add the next frame, (H, W, 3) uint8 sRGB.

        Raises
        ------
        ShapeError
            If the picture has another size than the video.
        ValueRangeError
            If the clock has no time for another frame.
        """
        if image.shape != (*self.size, 3) or image.dtype != np.uint8:
            raise ShapeError(f"image must be {(*self.size, 3)} of uint8, got {image.shape} of {image.dtype}.")
        if self._next >= self.clock.n_frames:
            raise ValueRangeError(f"frames must be at most the clock's {self.clock.n_frames}, got one more.")
        frame = self._av.VideoFrame.from_ndarray(_even(image), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", interpolation=_ACCURATE)
        frame.pts, frame.time_base = int(self.clock.ticks[self._next]), self.clock.time_base
        frame.pict_type = 0  # the encoder chooses
        self._next += 1
        for packet in self._stream.encode(frame):
            self._mux(packet)

    def _mux(self, packet: Any) -> None:
        self._container.mux(packet)

    def _new_stream(self) -> Any:
        if "libx264" not in self._av.codecs_available:
            raise MissingExtraError(
                'Videos need an FFmpeg that writes H.264 (libx264): pip install "facewright[video]".'
            )
        stream = self._container.add_stream("libx264", rate=self.clock.frame_rate)
        height, width = self.size
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        stream.time_base = self.clock.time_base
        context = stream.codec_context
        context.time_base = self.clock.time_base
        context.max_b_frames = 0  # decoding order is showing order
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = 1
        # A key frame every two seconds: players can jump.
        context.gop_size = max(1, round(2 * float(self.clock.frame_rate)))
        stream.options = {"crf": str(self.quality), "preset": "veryfast", "threads": _ENCODER_THREADS}
        return stream


def join_videos(
    path: str | Path,
    pieces: Sequence[Path],
    clock: FrameClock,
    *,
    sound_of: Path | None = None,
    sound_start: float = 0.0,
) -> list[str]:
    """Join pieces that `VideoWriter` wrote, in order, and add the sound of another file; whole or not at all.

    Frames are copied, not encoded again. Sound is copied where the container takes it (AAC, MP3, AC-3, Opus, FLAC,
    ALAC), else encoded as AAC.

    Parameters
    ----------
    path : str or Path
        The video to write.
    pieces : sequence of Path
        At least one.
    clock : FrameClock
        The one they were written with.
    sound_of : Path, optional
        File whose first sound track is added; none where it has none.
    sound_start : float, seconds
        Time in that file which belongs to the first frame.

    Returns
    -------
    list of str
        Sentences for the user about the sound, where something is to be said.

    Raises
    ------
    StoreError
        If the file cannot be written.
    FileFormatError
        If a piece is damaged.
    """
    from facewright.io.sound import SoundSource

    av = import_av()
    check_video_path(path)
    notes: list[str] = []
    with ExitStack() as stack:
        sound = None
        if sound_of is not None:
            sound = stack.enter_context(SoundSource(sound_of, start=sound_start))
        temporary = stack.enter_context(write_atomically(path))
        options = {"movflags": "+faststart"}
        with av.open(str(temporary), "w", format=_muxer(Path(path)), options=options) as out:
            with av.open(str(pieces[0])) as first:
                stream = out.add_stream_from_template(first.streams.video[0])
                stream.time_base = clock.time_base
            track = None if sound is None else sound.add_to(out)
            out.start_encoding()
            ahead = iter(()) if sound is None or track is None else sound.packets(track)
            waiting = next(ahead, None)
            for packet, seconds in _video_packets(pieces, clock):
                while waiting is not None and waiting[1] <= seconds:
                    out.mux(waiting[0])
                    waiting = next(ahead, None)
                packet.stream = stream
                out.mux(packet)
            while waiting is not None:
                out.mux(waiting[0])
                waiting = next(ahead, None)
            if sound is not None:
                notes += sound.notes
    return notes


def check_video_path(path: str | Path) -> None:
    """Refuse names of kinds of video that are not written.

    Raises
    ------
    ValueRangeError
        If the suffix is none of `WRITE_SUFFIXES`.
    """
    if Path(path).suffix.lower() not in WRITE_SUFFIXES:
        raise ValueRangeError(f"video file must end in {', '.join(WRITE_SUFFIXES)}, got {Path(path).name!r}.")


def _video_packets(pieces: Sequence[Path], clock: FrameClock) -> Any:
    """Give the packets of all pieces with their times, on the clock."""
    av = import_av()
    at = 0
    for piece in pieces:
        try:
            with av.open(str(piece)) as container:
                for packet in container.demux(container.streams.video[0]):
                    if packet.dts is None:
                        continue
                    tick = int(clock.ticks[at])
                    packet.pts = packet.dts = tick
                    packet.time_base = clock.time_base
                    following = clock.ticks[at + 1] if at + 1 < clock.n_frames else None
                    packet.duration = int(following - tick) if following is not None else _last_duration(clock)
                    at += 1
                    yield packet, float(tick * clock.time_base)
        except (av.error.FFmpegError, IndexError) as error:
            raise FileFormatError(f"{piece} must be a piece of a video, got a damaged file: delete it.") from error
    if at != clock.n_frames:
        raise FileFormatError(f"the pieces must hold {clock.n_frames} frames together, got {at}.")


def _last_duration(clock: FrameClock) -> int:
    return max(1, round(1 / (clock.frame_rate * clock.time_base)))


def _even(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape[:2]
    if height % 2 or width % 2:
        image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.ascontiguousarray(image)


def _muxer(path: Path) -> str:
    return {".mov": "mov", ".mkv": "matroska"}.get(path.suffix.lower(), "mp4")
