"""Recordings of simulated people before a Kinect, with everything known: shape, motion, depth, landmarks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from facewright.apps.simulated_scene import CaptureScene, Look
from facewright.apps.simulated_subject import SimulatedCaptureSubject, simulate_capture_subject
from facewright.apps.true_landmarks import true_landmarks
from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import FRONTAL, rotation_from_head_angles
from facewright.capture.frame import RGBDFrame
from facewright.capture.simulated_kinect import FRAMES_PER_SECOND, KINECT_INTRINSICS, KinectNoise
from facewright.errors import ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.landmarks.points import Landmarks
from facewright.numeric.check import check_finite, check_shape

__all__ = ["SimulatedCaptureSubject", "SimulatedRecording", "act", "simulate_capture_subject", "simulate_recording"]

#: From the camera to the bridge of the nose, mm.
DISTANCE_MM = (550.0, 700.0)
ACTED_SHARE = (0.7, 1.1)
"""An acted weight is the guide's times a factor drawn from this range, for each weight."""
SPURIOUS_PROBABILITY, SPURIOUS_WEIGHT = 0.05, 0.15
"""A shape that was not asked for is active with this probability, at a weight up to this."""
_PITCH_SHARE = 0.25  # nodding while turning, as a share of the turn


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A subject who holds an expression and turns the head.

    Parameters
    ----------
    subject : SimulatedCaptureSubject
        Who.
    weights : ndarray of shape (46,), float64
        Blendshape weights of the expression as it was acted.
    vertices : ndarray of shape (V, 3), float32, millimetres
        The true mesh, all parts of the face, model space. Every frame shows it moved rigidly, but for the neck, which
        bends.
    intrinsics : Intrinsics
        Of the Kinect.
    camera_from_model : tuple of RigidMotion
        The head's pose in each frame.
    camera_from_torso : RigidMotion
        Where the torso rests.
    noise : KinectNoise or None
        None for perfect depth and pictures without noise.
    seed : int
        Of the noise.
    """

    subject: SimulatedCaptureSubject
    weights: NDArray[np.float64]
    vertices: NDArray[np.float32]
    intrinsics: Intrinsics
    camera_from_model: tuple[RigidMotion, ...]
    camera_from_torso: RigidMotion
    noise: KinectNoise | None
    seed: int

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.camera_from_model)

    def frame(self, i: int) -> RGBDFrame:
        """Return frame `i`, the same at every call."""
        look, time = self._look(i), i / FRAMES_PER_SECOND
        if self.noise is None:
            return RGBDFrame(look.color, look.depth, self.intrinsics, time)
        rng = np.random.default_rng((self.seed, i))
        depth = self.noise.observe(look.depth, self.intrinsics, rng, absorbed=look.absorbed)
        return RGBDFrame(self._scene.add_grain(look.color, rng), depth, self.intrinsics, time)

    def frames(self) -> Iterator[RGBDFrame]:
        """Yield the frames one by one."""
        for i in range(self.n_frames):
            yield self.frame(i)

    def true_depth(self, i: int) -> NDArray[np.float32]:
        """Return the depth (H, W) of the whole scene in frame `i` without noise, mm; 0 where there is nothing."""
        return self._look(i).depth

    def true_landmarks(self, i: int) -> Landmarks:
        """Return the ``fw74`` landmarks of the true mesh in frame `i`."""
        skin = self.subject.face.skin()
        n = skin.topology.n_vertices
        return true_landmarks(
            skin.topology, skin.mean_shape, self.vertices[:n], self.intrinsics, self.camera_from_model[i]
        )

    @cached_property
    def _scene(self) -> CaptureScene:
        return CaptureScene(self.subject, self.vertices, self.intrinsics, self.camera_from_torso, self.seed)

    def _look(self, i: int) -> Look:
        if not 0 <= i < self.n_frames:
            raise ValueRangeError(f"frame must be in 0 to {self.n_frames - 1}, got {i}.")
        return self._scene.look(self.camera_from_model[i])


def simulate_recording(
    subject: SimulatedCaptureSubject,
    weights: NDArray[np.floating],
    rng: np.random.Generator,
    *,
    n_frames: int = 24,
    turn_degrees: float = 15.0,
    noise: bool | KinectNoise = True,
    acted: bool = True,
) -> SimulatedRecording:
    """Let a subject act an expression before a Kinect v1, 550 to 700 mm away, while the head turns.

    Parameters
    ----------
    subject : SimulatedCaptureSubject
        From `simulate_capture_subject`.
    weights : ndarray of shape (46,)
        What the subject is asked for (`facewright.faces.expressions.EXPRESSION_WEIGHTS`).
    rng : numpy.random.Generator
        Source of randomness.
    n_frames : int
        Length of the recording.
    turn_degrees : float
        The head starts near the front and turns by this to each side, nodding a little.
    noise : bool or KinectNoise
        Whether depth and colour are as noisy as those of the sensor.
    acted : bool
        Whether the subject follows the guide imperfectly (`act`), or exactly.

    Returns
    -------
    SimulatedRecording
        Frames are rendered when they are asked for.

    Raises
    ------
    ShapeError, ValueRangeError
        If weights are not (46,) and finite, or a number is out of range.
    """
    check_shape("weights", weights, len(BLENDSHAPE_NAMES))
    check_finite("weights", weights)
    if n_frames < 1:
        raise ValueRangeError(f"n_frames must be at least 1, got {n_frames}.")
    if not 0.0 <= turn_degrees <= 60.0:
        raise ValueRangeError(f"turn_degrees must be in [0, 60], got {turn_degrees}.")
    asked = np.asarray(weights, dtype=np.float64)
    done = act(asked, rng) if acted else asked.copy()
    vertices = subject.person.pose(done)
    pivot, bridge = _neck_pivot(subject), subject.person.neutral[subject.face.topology.landmarks["fw74"][43]]
    intrinsics = KINECT_INTRINSICS
    distance = rng.uniform(*DISTANCE_MM)
    base = rng.normal(0.0, [2.5, 3.0, 2.0])
    offset = rng.normal(0.0, [8.0, 6.0])
    straight = rotation_from_head_angles(*base)
    # The bridge of the nose at this distance, near the middle of the picture; the torso upright below.
    place = np.array([offset[0], offset[1], distance]) - straight @ (bridge - pivot)
    motions = []
    drift = _smooth_walk(n_frames, rng)
    for k, (yaw, pitch, roll) in enumerate(_turn(n_frames, turn_degrees, rng)):
        rotation = rotation_from_head_angles(base[0] + yaw, base[1] + pitch, base[2] + roll)
        motions.append(RigidMotion(rotation, place + drift[k] - rotation @ pivot))
    torso = RigidMotion(FRONTAL, place - FRONTAL @ pivot)
    sensor = KinectNoise() if noise is True else (noise or None)
    return SimulatedRecording(
        subject, done, vertices, intrinsics, tuple(motions), torso, sensor, int(rng.integers(2**31))
    )


def act(guide: NDArray[np.floating], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return what is acted for guide weights (46,): each 0.7 to 1.1 times as strong, now and then a shape too many.

    Lids that shall be shut are shut and go no further, and lips that the guide keeps sealed over an open jaw stay
    sealed.
    """
    share = rng.uniform(*ACTED_SHARE, len(guide))
    names = BLENDSHAPE_NAMES
    share[names.index("mouthClose")] = share[names.index("jawOpen")]
    spurious = (rng.random(len(guide)) < SPURIOUS_PROBABILITY) * rng.uniform(0.0, SPURIOUS_WEIGHT, len(guide))
    spurious[names.index("mouthClose")] = 0.0
    done = np.where(guide > 0, guide * share, spurious * bool(np.any(guide)))
    blinks = [names.index("eyeBlink_L"), names.index("eyeBlink_R")]
    done[blinks] = np.where(guide[blinks] >= 1.0, 1.0, np.minimum(done[blinks], 1.0))
    return done


def _turn(n_frames: int, turn_degrees: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return yaw, pitch and roll (T, 3), degrees: from the front to one side, to the other, and back."""
    phase = np.linspace(0.0, 2.0 * np.pi, n_frames)
    swing = np.arcsin(0.97 * np.sin(phase)) / np.arcsin(0.97)  # nearly even speed
    side = rng.choice([-1.0, 1.0])
    nod = _PITCH_SHARE * np.sin(phase + rng.uniform(-0.4, 0.4)) * rng.choice([-1.0, 1.0])
    lean = 0.10 * np.sin(phase + rng.uniform(-0.4, 0.4))
    return turn_degrees * np.stack([side * swing, nod - nod[0], lean - lean[0]], axis=1)


def _smooth_walk(n_frames: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return how the head sways besides turning, (T, 3), mm."""
    t = np.linspace(0.0, 2.0 * np.pi, n_frames)[:, None]
    amplitude, phase = rng.normal(0.0, 2.0, 3), rng.uniform(0, 2 * np.pi, 3)
    return amplitude * (np.sin(t + phase) - np.sin(phase))


def _neck_pivot(subject: SimulatedCaptureSubject) -> NDArray[np.float64]:
    """Return the joint about which the head turns: in the middle of the neck, below the level of the chin."""
    face = subject.face
    skin = subject.person.neutral[: face.n_skin].astype(np.float64)
    chin = skin[face.topology.landmarks["ibug68"][8]]
    ring = skin[np.abs(skin[:, 1] - (chin[1] - 25.0)) < 12.0]
    ring = ring[ring[:, 2] < chin[2] - 20.0]
    middle = 0.5 * (ring.min(axis=0) + ring.max(axis=0))
    return np.array([0.0, chin[1] - 15.0, middle[2]])
