"""Videos, frame by frame: upright sRGB pictures with their true times; memory does not grow with the length."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingExtraError, StoreError, ValueRangeError
from facewright.io.program_stream import breaks_off

#: Largest frame that is read, in pixels.
MAX_FRAME_PIXELS = 36_000_000
_STILLS = ("image2", "_pipe", "webp", "ico")


class VideoFrame(NamedTuple):
    """One frame: its number from 0, its time in seconds from the first frame, its (H, W, 3) uint8 sRGB picture."""

    number: int
    time: float
    image: NDArray[np.uint8]


@dataclass(frozen=True)
class VideoInfo:
    """What a video file says about itself.

    Parameters
    ----------
    width, height : int, pixels
        Of the frames as they are given: upright, with square pixels.
    frame_rate : Fraction
        Frames a second, the mean where the rate varies.
    n_frames : int
        Number of frames that the file states or that its length suggests; 0 where it says nothing. For progress only.
    duration : float, seconds
        As stated; 0 where the file says nothing.
    quarter_turns : int
        Turns of 90 degrees against the clock that the file asks for and the reader applies, 0 to 3.
    has_audio : bool
        Whether there is sound.
    """

    width: int
    height: int
    frame_rate: Fraction
    n_frames: int
    duration: float
    quarter_turns: int
    has_audio: bool


class VideoReader:
    """A video file open for reading, once from start to end, frame after frame.

    Rotation metadata and oblong pixels are applied. Times are the file's own time stamps, so that a varying frame rate
    is kept; `start` is the file's time of the first frame, seconds. A file that ends early or is damaged gives the
    frames that can be decoded; `notes` then says so.

    Parameters
    ----------
    path : str or Path
        A local file that FFmpeg can read.

    Raises
    ------
    MissingExtraError
        If PyAV is not installed.
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is no video: empty, foreign, sound only, a still picture, or no frame of it can be decoded.

    Examples
    --------
    >>> with VideoReader("clip.mp4") as video:  # doctest: +SKIP
    ...     for frame in video:
    ...         print(frame.number, frame.time, frame.image.shape)
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.notes: list[str] = []
        self.n_read = 0
        self._damaged = 0
        self._container = open_container(self.path)
        try:
            self._stream = _video_stream(self._container, self.path)
            self._stream.thread_type = "AUTO"
            self._decoded = self._decode()
            self._first = next(self._decoded, None)
            if self._first is None:
                raise FileFormatError(f"{self.path} must hold frames that can be decoded, got a video without any.")
            self.info = self._describe(self._first)
            self.start = _seconds(self._first) or 0.0
        except BaseException:
            self._container.close()
            raise

    def __enter__(self) -> VideoReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._container.close()

    def __iter__(self) -> Iterator[VideoFrame]:
        return self.frames()

    def frames(self, start: int = 0) -> Iterator[VideoFrame]:
        """Give the frames from number `start` on; those before are decoded and thrown away. Only once.

        Raises
        ------
        ValueRangeError
            If the frames were given before.
        """
        if self._first is None:
            raise ValueRangeError("frames must be read once for each open video; open it again to start over.")
        frame, self._first = self._first, None
        origin, last, shifted = _seconds(frame), -math.inf, 0
        step = 1.0 / float(self.info.frame_rate)
        while frame is not None:
            index = self.n_read
            stated = _seconds(frame)
            time = index * step if stated is None or origin is None else stated - origin
            if time <= last:  # a time stamp that is missing, doubled or runs backwards
                time, shifted = last + 0.5 * step, shifted + 1
            last = time
            self.n_read += 1
            if index >= start:
                yield VideoFrame(index, time, self._picture(frame))
            frame = next(self._decoded, None)
        self._note_ending(last + step, shifted)

    def _decode(self) -> Iterator[Any]:
        """Decode frame by frame; damaged packets are passed over, a damaged container ends the video."""
        import av

        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except av.error.FFmpegError:
                self._damaged += 1
                return
            try:
                decoded = packet.decode()
            except av.error.EOFError:
                return
            except (av.error.FFmpegError, MemoryError):
                self._damaged += 1
                continue
            yield from decoded

    def _describe(self, frame: Any) -> VideoInfo:
        stream = self._stream
        width, height = _square_pixel_size(frame.width, frame.height, stream.codec_context.sample_aspect_ratio)
        if width * height > MAX_FRAME_PIXELS:
            raise FileFormatError(
                f"{self.path} must have frames of at most {MAX_FRAME_PIXELS} pixels, got {width} x {height}."
            )
        turns = round(float(frame.rotation or 0) / 90) % 4
        if turns % 2:
            width, height = height, width
        rate = stream.average_rate or stream.guessed_rate or Fraction(25)
        if not Fraction(1, 10) <= rate <= 1000:
            rate = Fraction(25)
        duration = float(stream.duration * stream.time_base) if stream.duration else 0.0
        if not duration and self._container.duration:
            duration = self._container.duration / 1e6
        n_frames = int(stream.frames or round(duration * rate))
        return VideoInfo(width, height, Fraction(rate), n_frames, duration, turns, bool(self._container.streams.audio))

    def _picture(self, frame: Any) -> NDArray[np.uint8]:
        info = self.info
        size = (info.height, info.width) if info.quarter_turns % 2 else (info.width, info.height)
        pixels = frame.to_ndarray(format="rgb24", width=size[0], height=size[1])
        # The detector finds nothing in padded rows, silently.
        return np.ascontiguousarray(np.rot90(pixels, info.quarter_turns))

    def _note_ending(self, end: float, shifted: int) -> None:
        stated = self.info.duration
        if self._damaged:
            self.notes.append(
                f"{self.path.name} is damaged: {self.n_read} frames ({end:.2f} s) were read, "
                f"{self._damaged} pieces could not be."
            )
        elif self._stream.frames and self.n_read < self._stream.frames:
            self.notes.append(
                f"{self.path.name} ends early: {self.n_read} of the {self._stream.frames} frames "
                "that it states were read."
            )
        elif stated and end < stated - max(0.5, 0.02 * stated):
            self.notes.append(
                f"{self.path.name} ends early: {self.n_read} frames ({end:.2f} s) were read, it states {stated:.2f} s."
            )
        elif "mpeg" in self._container.format.name.split(",") and breaks_off(self.path):
            self.notes.append(
                f"{self.path.name} ends early, within a packet: {self.n_read} frames ({end:.2f} s) were read."
            )
        if shifted:
            self.notes.append(f"{shifted} frames of {self.path.name} have no time of their own and were moved apart.")


def import_av() -> Any:
    """Return PyAV.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise MissingExtraError('Videos need PyAV: pip install "facewright[video]".') from error
    # Silent: what goes wrong is said by us. Any level would call Python from FFmpeg's threads, which then wait for the
    # interpreter while it waits for them: a deadlock as soon as a decoder is freed.
    av.logging.set_level(None)
    return av


def open_container(path: Path) -> Any:
    """Open a local media file for reading.

    Raises
    ------
    MissingExtraError, StoreError, FileFormatError
        As `VideoReader`.
    """
    av = import_av()
    try:
        if path.is_dir():
            raise StoreError(f"{path} must be a video file, got a folder.")
        if path.stat().st_size == 0:
            raise FileFormatError(f"{path} must be a video, got an empty file.")
    except FileNotFoundError as error:
        raise StoreError(f"{path} does not exist.") from error
    except OSError as error:
        if isinstance(error, StoreError):
            raise
        raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        # Play lists must not make us read other places; metadata may be in any encoding.
        container = av.open(f"file:{path}", options={"protocol_whitelist": "file"}, metadata_errors="replace")
    except av.error.PermissionError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror}.") from error
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise FileFormatError(f"{path} must be a video that FFmpeg can read, got a damaged or foreign file.") from error
    if any(name in container.format.name for name in _STILLS):
        container.close()
        raise FileFormatError(f"{path} must be a video, got a still picture.")
    return container


def _video_stream(container: Any, path: Path) -> Any:
    moving = [s for s in container.streams.video if not int(s.disposition) & 0x400]  # not a cover picture
    moving = [s for s in moving if s.codec_context is not None]
    if not moving:
        found = "sound only" if container.streams.audio else "no stream that can be decoded"
        raise FileFormatError(f"{path} must be a video, got {found}.")
    return max(moving, key=lambda s: s.codec_context.width * s.codec_context.height)


def _square_pixel_size(width: int, height: int, aspect: Fraction | None) -> tuple[int, int]:
    """Return the size with square pixels: the wider or higher of the two, nothing is thrown away."""
    if not aspect or aspect <= 0 or aspect == 1 or not Fraction(1, 4) <= aspect <= 4:
        return width, height
    return (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))


def _seconds(frame: Any) -> float | None:
    return None if frame.pts is None or frame.time_base is None else float(frame.pts * frame.time_base)
