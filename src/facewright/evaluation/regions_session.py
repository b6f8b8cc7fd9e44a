"""Registered performances for the regions suite: four simulated performers, known only by their noisy markers."""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.faces.face import Face
from facewright.faces.performers import NEUTRAL_NAME, PERFORMER_NAMES, Performer, SimulatedClip, simulate_performers
from facewright.fitting.marker_registration import RegistrationSettings, register_performer
from facewright.io.marker_data import MarkerData
from facewright.mesh.closest_point import ClosestPoints
from facewright.models.performer_data import PerformerData
from facewright.models.procrustes import RigidMotions, rigid_motions

Progress = Callable[[str, int, int], None]

N_VERTICES = 397
#: Frames a second that are registered: the paper thins to 15 for the segmentation; here for everything.
FRAMES_PER_SECOND = 15.0
#: Frames of each performer whose surface is held against the truth.
_SURFACE_FRAMES = 24


@dataclass
class RegistrationErrors:
    """Squared distances, mm^2, of registered vertices from the truth; what was mended.

    Parameters
    ----------
    surface : list of ndarray
        To the nearest point of the true surface.
    place : list of ndarray
        To the true vertex.
    motion : list of ndarray
        Between registered and true displacements from the neutral.
    moved : list of ndarray
        Of the true displacements.
    """

    surface: list[NDArray[np.float64]] = field(default_factory=list)
    place: list[NDArray[np.float64]] = field(default_factory=list)
    motion: list[NDArray[np.float64]] = field(default_factory=list)
    moved: list[NDArray[np.float64]] = field(default_factory=list)

    def metrics(self) -> dict[str, float]:
        """Return the root mean squares."""
        named = {
            "registration_surface_rms_mm": self.surface,
            "registration_place_rms_mm": self.place,
            "registration_motion_rms_mm": self.motion,
            "true_motion_rms_mm": self.moved,
        }
        return {name: float(np.sqrt(np.concatenate(parts).mean())) for name, parts in named.items()}


@dataclass(frozen=True, eq=False)
class RegisteredSession:
    """The performers as a motion capture session shows them.

    Parameters
    ----------
    performers : tuple of PerformerData
        M1, F1, M2, F2 on one coarse mesh.
    train, test : tuple of str
        Names of the sentences.
    errors : RegistrationErrors
        Against the truth.
    seconds : float
        Processor time of registering a minute of motion.
    n_frames : int
        Registered.
    recorded : bool
        Whether the first performer's range of motion comes from the real recording.
    """

    performers: tuple[PerformerData, ...]
    train: tuple[str, ...]
    test: tuple[str, ...]
    errors: RegistrationErrors
    seconds: float
    n_frames: int
    recorded: bool


def register_session(
    face: Face, seed: int, progress: Progress | None = None, *, names: tuple[str, ...] = PERFORMER_NAMES
) -> RegisteredSession:
    """Simulate performers, record their markers with noise, dropouts and swaps, and register every clip.

    Parameters
    ----------
    face : Face
        Of the performers' identities and, as its mean, the generic template.
    seed : int
        Of performers, takes and noise.
    progress : callable, optional
        Called with stage, done, total.
    names : tuple of str
        Of the performers.
    """
    from facewright.apps.recorded_motion import read_recorded_motion
    from facewright.apps.simulate_performance import RECORDED_CURVES
    from facewright.faces.acting import FRAMES_PER_SECOND as RATE

    curves = Path(os.environ.get("FACEWRIGHT_TEST_DATA", "") or "/nonexistent") / RECORDED_CURVES
    recorded = read_recorded_motion(curves, RATE) if curves.is_file() else None
    performers = simulate_performers(
        face, np.random.default_rng(seed), names=names, recorded=recorded, progress=progress
    )
    settings = RegistrationSettings(n_vertices=N_VERTICES, neutral=NEUTRAL_NAME)
    errors, registered, seconds = RegistrationErrors(), [], 0.0
    for k, performer in enumerate(performers):
        clips = {name: _thinned(performer.clip(name), seed) for name in performer.clips}
        if progress is not None:
            progress("recording performers", k + 1, len(performers))
        start = time.process_time()
        data = register_performer(clips, face, name=performer.name, settings=settings, progress=progress).data
        seconds += time.process_time() - start
        _compare(performer, data, errors)
        registered.append(data)
    n_frames = sum(clip.n_frames for data in registered for clip in data.clips)
    first = performers[0]
    return RegisteredSession(
        tuple(registered),
        first.train,
        first.test,
        errors,
        60.0 * seconds * FRAMES_PER_SECOND / n_frames,
        n_frames,
        recorded is not None,
    )


def _thinned(clip: SimulatedClip, seed: int) -> MarkerData:
    """Return every eighth frame of what the cameras saw of a clip."""
    rng = np.random.default_rng((seed, zlib.crc32(f"{clip.performer.name}/{clip.name}".encode())))
    markers = clip.markers(rng)
    step = max(1, round(1.0 / (FRAMES_PER_SECOND * float(np.median(np.diff(markers.times))))))
    return MarkerData(markers.times[::step], markers.labels, markers.positions[::step])


def _compare(performer: Performer, data: PerformerData, errors: RegistrationErrors) -> None:
    """Hold the test sentences against the true surfaces, each in its own head's frame."""
    ids, rest = data.vertex_ids, performer.person.neutral.astype(np.float64)
    to_truth = rigid_motions(data.neutral[None].astype(np.float64), rest[ids])
    neutral = to_truth.apply(data.neutral[None].astype(np.float64))[0]
    for checked, name in enumerate(performer.test):
        clip, found = performer.clip(name), data.clip(name)
        step = max(1, round(clip.n_frames / found.n_frames))
        truth = clip.meshes(slice(None, None, step), rigid=False)
        T = found.n_frames
        here = RigidMotions(np.repeat(to_truth.rotations, T, axis=0), np.repeat(to_truth.translations, T, axis=0))
        vertices = here.apply(found.vertices.astype(np.float64))
        true = truth.vertices[:, ids].astype(np.float64)
        errors.place.append(((vertices - true) ** 2).sum(axis=2).ravel())
        errors.motion.append((((vertices - neutral) - (true - rest[ids])) ** 2).sum(axis=2).ravel())
        errors.moved.append(((true - rest[ids]) ** 2).sum(axis=2).ravel())
        every = max(1, len(performer.test) * T // _SURFACE_FRAMES)
        for t in range(checked % every, T, every):
            surface = ClosestPoints(truth.vertices[t], truth.faces)
            errors.surface.append(surface.query(vertices[t]).distances ** 2)
