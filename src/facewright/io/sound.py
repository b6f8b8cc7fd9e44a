"""The sound of one media file for another: copied where it can be, encoded again where it must be."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

from facewright.io.video_reader import import_av, open_container

_COPIED = ("aac", "mp3", "ac3", "eac3", "opus", "flac", "alac")
_LEAD = 0.1  # seconds of sound before the first frame that are kept: the decoder's run-in


class SoundSource:
    """The first sound track of a file.

    Parameters
    ----------
    path : Path
        The file.
    start : float, seconds
        Time in it that becomes zero.

    Raises
    ------
    MissingExtraError, StoreError, FileFormatError
        As `VideoReader`.
    """

    def __init__(self, path: Path, start: float = 0.0) -> None:
        self.path, self.start = path, start
        self.notes: list[str] = []
        self._container = open_container(path)
        tracks = [track for track in self._container.streams.audio if track.codec_context is not None]
        self._track = tracks[0] if tracks else None
        self._copy = self._track is not None and self._track.codec_context.name in _COPIED

    def __enter__(self) -> SoundSource:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._container.close()

    def add_to(self, out: Any) -> Any | None:
        """Add a track for this sound to an output container; None where there is no sound."""
        if self._track is None:
            return None
        if self._copy:
            return out.add_stream_from_template(self._track)
        context = self._track.codec_context
        track = out.add_stream("aac", rate=min(context.sample_rate, 48_000))
        track.codec_context.layout = "mono" if context.channels == 1 else "stereo"
        track.codec_context.bit_rate = 96_000 * (1 if context.channels == 1 else 2)
        return track

    def packets(self, track: Any) -> Iterator[tuple[Any, float]]:
        """Give packets for `track` with their times in seconds; damaged sound ends early, and `notes` says so."""
        av = import_av()
        last = 0.0
        try:
            for packet, time in self._copied(track) if self._copy else self._encoded(track):
                last = time
                yield packet, time
        except (av.error.FFmpegError, ValueError):
            self.notes.append(f"the sound of {self.path.name} is damaged and ends at {last:.2f} s.")

    def _copied(self, track: Any) -> Iterator[tuple[Any, float]]:
        last_dts = None
        for packet in self._container.demux(self._track):
            if packet.dts is None or packet.pts is None:
                continue
            time = float(packet.pts * packet.time_base) - self.start
            if time < -_LEAD or (last_dts is not None and packet.dts <= last_dts):
                continue
            last_dts = packet.dts
            shift = round(self.start / packet.time_base)
            packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
            packet.stream = track
            yield packet, time

    def _encoded(self, track: Any) -> Iterator[tuple[Any, float]]:
        av = import_av()
        context = track.codec_context
        resampler = av.AudioResampler(format=context.format, layout=context.layout, rate=context.sample_rate)
        written = 0
        for frame in self._decoded():
            first = frame.pts is not None and frame.time_base is not None and written == 0
            offset = float(frame.pts * frame.time_base) - self.start if first else 0.0
            if first and offset < 0 and offset + frame.samples / frame.sample_rate <= 0:
                continue
            if first:
                written = round(max(0.0, offset) * context.sample_rate)
            frame.pts = None
            for piece in resampler.resample(frame):
                piece.pts, piece.time_base = written, Fraction(1, context.sample_rate)
                written += piece.samples
                yield from _timed(track.encode(piece))
        for piece in resampler.resample(None):
            piece.pts, piece.time_base = written, Fraction(1, context.sample_rate)
            written += piece.samples
            yield from _timed(track.encode(piece))
        yield from _timed(track.encode(None))

    def _decoded(self) -> Iterator[Any]:
        """Decode the track; what cannot be decoded is passed over."""
        av = import_av()
        damaged = 0
        for packet in self._container.demux(self._track):
            try:
                yield from packet.decode()
            except av.error.EOFError:
                return
            except av.error.FFmpegError:
                damaged += 1
        if damaged:
            self.notes.append(f"{damaged} pieces of the sound of {self.path.name} are damaged and left out.")


def _timed(packets: list[Any]) -> Iterator[tuple[Any, float]]:
    for packet in packets:
        yield packet, float((packet.pts or 0) * packet.time_base) if packet.time_base else 0.0
