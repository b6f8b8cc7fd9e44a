"""Four simulated performers, their clips, meshes and markers: what a motion capture session would bring."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.faces.acting import (
    CAMERA_DISTANCE_MM,
    act_combination,
    act_neutral,
    act_range_of_motion,
    act_sentence,
    with_head_motion,
)
from facewright.faces.acting_gestures import FACS_COMBINATIONS
from facewright.faces.acting_skin import ActingSkin, swing_of
from facewright.faces.acting_speech import load_sentences
from facewright.faces.acting_style import ActingStyle, draw_style
from facewright.faces.face import Face
from facewright.faces.marker_faults import MarkerFaults, draw_faults, faulty_markers
from facewright.faces.marker_layout import MarkerLayout, draw_marker_layout
from facewright.faces.simulate import SimulatedPerson, simulate_person
from facewright.io.marker_data import MarkerData
from facewright.mesh.mesh_sequence import MeshSequence
from facewright.models.performance import Performance

PERFORMER_NAMES = ("M1", "F1", "M2", "F2")
SENTENCE_NAMES = tuple(sentence.name for sentence in load_sentences())
TEST_NAMES = tuple(name for name in SENTENCE_NAMES if name.endswith(("05", "06")))
TRAIN_NAMES = tuple(name for name in SENTENCE_NAMES if name not in TEST_NAMES)
NEUTRAL_NAME = "neutral"
RANGE_OF_MOTION_NAME = "range_of_motion"
FACS_NAMES = tuple(f"facs_{k + 1:02d}" for k in range(len(FACS_COMBINATIONS)))

MARKER_NOISE_MM = 0.2
"""Standard deviation of a marker's position, each coordinate."""

#: Sizes of the faces relative to the mean one, before what each one's own proportions make of them.
_SIZES = {"M1": 1.03, "F1": 0.95, "M2": 1.06, "F2": 0.92}
_FIRST = "M1"
#: Where a sitting performer's head is in the laboratory, mm: origin on the floor, y up.
_HEAD_AT_MM = np.array([0.0, 1200.0, 0.0])
_MIDDLE_OF_FACE_MM = np.array([0.0, 0.0, 90.0])


@dataclass(frozen=True, eq=False)
class SimulatedClip:
    """One take of one performer.

    Parameters
    ----------
    name : str
    performer : Performer
    performance : Performance
        Coefficients and head motion at 120 frames a second.
    """

    name: str
    performer: Performer
    performance: Performance

    @property
    def n_frames(self) -> int:
        """Number of frames T."""
        return self.performance.n_frames

    @cached_property
    def world_from_head(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotations (T, 3, 3) and translations (T, 3), mm, into the laboratory: y up, the floor at 0."""
        flip = np.diag([1.0, -1.0, -1.0])
        rotations = flip @ self.performance.rotations
        return rotations, self.performance.translations @ flip + _HEAD_AT_MM + [0.0, 0.0, CAMERA_DISTANCE_MM]

    @cached_property
    def _swing(self) -> NDArray[np.float64]:
        rotations, translations = self.world_from_head
        dt = float(np.median(np.diff(self.performance.times))) if self.n_frames > 1 else 1.0
        return swing_of(rotations, rotations @ _MIDDLE_OF_FACE_MM + translations, dt)

    def meshes(self, frames: slice = slice(None), *, rigid: bool = True, skin: bool = True) -> MeshSequence:
        """Return the true surface of the chosen frames.

        Parameters
        ----------
        frames : slice
            Which; every eighth for 15 a second.
        rigid : bool
            In the laboratory, head motion included; else the head at rest, in the model's axes.
        skin : bool
            The skin alone; else all parts, eyes that look straight ahead.
        """
        performer = self.performer
        topology = performer.face.topology
        n = performer.face.n_skin if skin else topology.n_vertices
        vertices = performer.skin.positions(self.performance.weights[frames], self._swing[frames], slice(0, n))
        if rigid:
            vertices = self._moved(vertices, frames).astype(np.float32)
        faces = topology.submesh(n).faces if skin else topology.faces
        return MeshSequence(self.performance.times[frames], vertices, faces)

    def marker_truth(self, frames: slice = slice(None), *, rigid: bool = True) -> NDArray[np.float64]:
        """Return the true centres of the markers (T, M, 3), millimetres; see `meshes` for `rigid`."""
        layout = self.performer.layout
        ids, corners = np.unique(layout.corners, return_inverse=True)
        vertices = self.performer.skin.positions(self.performance.weights[frames], self._swing[frames], ids)
        here = MarkerLayout(layout.labels, corners.reshape(-1, 3).astype(np.int32), layout.weights, layout.standoff_mm)
        centres = here.centres(vertices)
        return self._moved(centres, frames) if rigid else centres

    def markers(self, rng: np.random.Generator) -> MarkerData:
        """Return what cameras see of the markers: 0.2 mm of noise, dropouts, swapped labels."""
        return self.record(rng)[0]

    def record(self, rng: np.random.Generator) -> tuple[MarkerData, MarkerFaults]:
        """Return what cameras see of the markers, and what is wrong with it; labels at rest were checked by hand."""
        truth = self.marker_truth()
        faults = draw_faults(truth, self.performance.times, rng)
        if self.name == NEUTRAL_NAME:
            faults = replace(faults, swaps=())
        positions = faulty_markers(truth, faults, MARKER_NOISE_MM, rng)
        return MarkerData(self.performance.times, self.performer.layout.labels, positions), faults

    def _moved(self, points: NDArray[np.floating], frames: slice) -> NDArray[np.float64]:
        rotations, translations = self.world_from_head
        return np.einsum("tij,tnj->tni", rotations[frames], points, optimize=True) + translations[frames, None]


@dataclass(frozen=True, eq=False)
class Performer:
    """A simulated performer.

    Parameters
    ----------
    name : str
        ``M1``, ``F1``, ``M2`` or ``F2``.
    face : Face
        Topology.
    person : SimulatedPerson
        Neutral and personal blendshapes.
    layout : MarkerLayout
        Where the markers are.
    style : ActingStyle
        How this performer acts.
    skin : ActingSkin
        How the skin follows.
    seed : int
        Of the takes.
    recorded : Performance, optional
        Curves of a recording for the range of motion, at 120 frames a second.
    """

    name: str
    face: Face
    person: SimulatedPerson
    layout: MarkerLayout
    style: ActingStyle
    skin: ActingSkin
    seed: int
    recorded: Performance | None = None

    @property
    def clips(self) -> tuple[str, ...]:
        """Names of all clips: rest, 18 sentences; of the first performer also a range of motion and 86 combinations."""
        return (NEUTRAL_NAME, *SENTENCE_NAMES) + ((RANGE_OF_MOTION_NAME, *FACS_NAMES) if self.name == _FIRST else ())

    @property
    def train(self) -> tuple[str, ...]:
        """Names of the sentences to train with, four of each emotion."""
        return TRAIN_NAMES

    @property
    def test(self) -> tuple[str, ...]:
        """Names of the sentences to test with, two of each emotion."""
        return TEST_NAMES

    def clip(self, name: str) -> SimulatedClip:
        """Return a clip, the same whenever and in whatever order clips are asked for.

        Raises
        ------
        ValueRangeError
            If the performer has no clip of that name.
        """
        if name not in self.clips:
            raise ValueRangeError(f"clip must be one of the performer's, such as {self.clips[0]!r}, got {name!r}.")
        rng = np.random.default_rng((self.seed, zlib.crc32(name.encode())))
        if name == NEUTRAL_NAME:
            performance = act_neutral()
        elif name == RANGE_OF_MOTION_NAME:
            if self.recorded is None:
                performance = act_range_of_motion(self.style, rng)
            else:
                performance = with_head_motion(self.recorded, self.style, rng)
        elif name in FACS_NAMES:
            performance = act_combination(FACS_NAMES.index(name), self.style, rng)
        else:
            performance = act_sentence(load_sentences()[SENTENCE_NAMES.index(name)], self.style, rng)
        return SimulatedClip(name, self, performance)


def simulate_performers(
    face: Face,
    rng: np.random.Generator,
    *,
    names: tuple[str, ...] = PERFORMER_NAMES,
    recorded: Performance | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[Performer, ...]:
    """Draw performers of different proportions, sizes, habits and marker layouts.

    Parameters
    ----------
    face : Face
        Where identities come from; each lies outside the span of its modes.
    rng : numpy.random.Generator
        Source of randomness; a performer is the same whichever others are asked for.
    names : tuple of str
        Which of `PERFORMER_NAMES`.
    recorded : Performance, optional
        Curves for the first performer's range of motion; made up where absent.
    progress : callable, optional
        Called as progress("simulating performers", done, total).

    Raises
    ------
    ValueRangeError
        If a name is unknown or repeated.
    TopologyError
        If the face does not mark where markers go.
    """
    if not names or len(set(names)) != len(names) or set(names) - set(PERFORMER_NAMES):
        raise ValueRangeError(f"names must be of {', '.join(PERFORMER_NAMES)}, once each, got {', '.join(names)}.")
    seed = int(rng.integers(2**31))
    performers = []
    for k, name in enumerate(names):
        own = np.random.default_rng((seed, PERFORMER_NAMES.index(name)))
        person = _resized(simulate_person(face, own), _SIZES[name])
        layout = draw_marker_layout(face, person.neutral, own)
        style, skin = draw_style(own), ActingSkin(face, person, own)
        take = int(own.integers(2**31))
        performers.append(
            Performer(name, face, person, layout, style, skin, take, recorded if name == _FIRST else None)
        )
        if progress is not None:
            progress("simulating performers", k + 1, len(names))
    return tuple(performers)


def _resized(person: SimulatedPerson, size: float) -> SimulatedPerson:
    scale = np.float32(size)
    return SimulatedPerson(person.neutral * scale, person.deltas * scale, person.amplitudes)
