"""A photo that moves: draws every frame of a motion and writes the video, in pieces that a killed run keeps."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.io.video_writer import FrameClock, VideoWriter, join_videos
from facewright.numeric.read_ahead import in_threads
from facewright.numeric.threads import one_blas_thread, thread_count

if TYPE_CHECKING:
    from facewright.apps.photo_motion import PhotoMotion
    from facewright.apps.photo_subject import PhotoSubject
    from facewright.io.image import PhotoFile

Progress = Callable[[str, int, int], None]

#: Frames of a piece: what a killed run loses at most.
PIECE = 100
STAGE = "drawing"
_SMALLEST_SIDE, _LARGEST_SIDE = 64, 8192


def photo_for_video(path: Path, longest_side: int) -> tuple[PhotoFile, float]:
    """Read a photo, laid over white where it is transparent, no longer than a side; remarks say what was done.

    Returns
    -------
    photo : PhotoFile
        Both sides even: video has no others.
    scale : float
        Its pixels for one of the file's.

    Raises
    ------
    ValueRangeError
        If the side is out of range.
    StoreError, FileFormatError
        As `facewright.io.image.read_photo`.
    """
    from PIL import Image

    from facewright.io.image import PhotoFile, read_photo

    if not _SMALLEST_SIDE <= longest_side <= _LARGEST_SIDE:
        raise ValueRangeError(f"size must be in [{_SMALLEST_SIDE}, {_LARGEST_SIDE}] pixels, got {longest_side}.")
    file = read_photo(path)
    pixels, remarks = file.over_white(), file.remarks
    height, width = pixels.shape[:2]
    scale = min(1.0, longest_side / max(height, width))
    if scale < 1:
        w, h = (max(2, 2 * round(scale * side / 2)) for side in (width, height))
        pixels = np.asarray(Image.fromarray(pixels).resize((w, h), Image.Resampling.LANCZOS))
        remarks = (*remarks, f"the photo of {width} x {height} pixels is drawn at {w} x {h}; --size changes it.")
    else:
        pixels = pixels[: max(2, height - height % 2), : max(2, width - width % 2)]
    focal = None if file.focal_length is None else file.focal_length * scale
    return PhotoFile(np.ascontiguousarray(pixels), None, focal, remarks), scale


def draw_frame(subject: PhotoSubject, motion: PhotoMotion, frame: int) -> NDArray[np.uint8]:
    """Return one frame of a motion, (H, W, 3) uint8."""
    gaze = motion.gaze[frame]
    vertices = subject.vertices(weights=motion.weights[frame], gaze=gaze)
    view = subject.view(vertices, motion.poses[frame])
    return subject.synthesiser.draw(view, gaze).image


def draw_clip(
    subject: PhotoSubject,
    motion: PhotoMotion,
    clock: FrameClock,
    folder: Path,
    out: Path,
    *,
    sound_of: Path | None = None,
    sound_start: float = 0.0,
    quality: int = 18,
    progress: Progress | None = None,
) -> list[str]:
    """Draw all frames of a motion on a photo and write the video.

    Drawing runs in one thread for each core and encoding beside it; a few frames are in memory at a time. Each piece
    of 100 frames is kept in `folder` when it is complete; those that lie there already are not drawn again, so that a
    killed run ends with the same bytes as one that was not.

    Parameters
    ----------
    subject : PhotoSubject
        The photo.
    motion : PhotoMotion
        What happens in each frame.
    clock : FrameClock
        When each frame is shown.
    folder : Path
        Where pieces lie, of this photo and motion only.
    out : Path
        The video.
    sound_of : Path, optional
        File whose sound is added.
    sound_start : float, seconds
        Time in it which belongs to the first frame.
    quality : int
        See `facewright.io.video_writer.VideoWriter`.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    list of str
        Sentences about the sound.

    Raises
    ------
    ValueRangeError
        If motion and clock differ in their number of frames.
    StoreError
        If a file cannot be written.
    """
    T = motion.n_frames
    if clock.n_frames != T:
        raise ValueRangeError(f"clock must have the motion's {T} frames, got {clock.n_frames}.")
    pieces = [folder / f"{first:08d}.mp4" for first in range(0, T, PIECE)]
    subject.synthesiser  # noqa: B018  built once, before the threads ask for it
    with one_blas_thread():  # frames are the threads' work
        _draw_pieces(subject, motion, clock, pieces, quality, progress)
    return join_videos(out, pieces, clock, sound_of=sound_of, sound_start=sound_start)


def _draw_pieces(
    subject: PhotoSubject,
    motion: PhotoMotion,
    clock: FrameClock,
    pieces: list[Path],
    quality: int,
    progress: Progress | None,
) -> None:
    height, width = subject.photo.shape[:2]
    T = motion.n_frames
    for number, piece in enumerate(pieces):
        first, last = number * PIECE, min((number + 1) * PIECE, T)
        if not piece.exists():
            with (
                closing(
                    in_threads(lambda k: draw_frame(subject, motion, k), range(first, last), thread_count())
                ) as images,
                VideoWriter(piece, width, height, clock, first=first, quality=quality) as video,
            ):
                for frame, image in enumerate(images, first):
                    video.write(image)
                    if progress is not None:
                        progress(STAGE, frame + 1, T)
        if progress is not None:
            progress(STAGE, last, T)


def photo_rig_texture(subject: PhotoSubject, size: int = 1024) -> NDArray[np.uint8] | None:
    """Return the photo as the texture of its person's skin, (size, size, 3) uint8; None without texture coordinates."""
    from facewright.imaging.texture import bake_texture

    topology = subject.face.topology
    if topology.uv is None or topology.uv_faces is None:
        return None
    n_skin = topology.part_slice("face", "head_and_neck").stop
    source = subject.source
    return bake_texture(
        subject.photo,
        source.pixels,
        source.camera_vertices,
        topology,
        size=size,
        textured=np.arange(topology.n_vertices) < n_skin,
        perspective=source.perspective,
    )


def with_remarks(subject: PhotoSubject, remarks: tuple[str, ...]) -> PhotoSubject:
    """Return the subject with further remarks about its photo."""
    return replace(subject, remarks=(*remarks, *subject.remarks))
