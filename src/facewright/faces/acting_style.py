"""How a simulated performer differs from others in acting: reach, tempo, sides, habits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.faces.acting_timing import SHAPE_INDEX, columns_of
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, mirrored_name

#: Shapes that come along with others in most people, and how strongly: mean and spread over people.
_RECRUITED: tuple[tuple[str, str, float, float], ...] = (
    ("mouthSmile", "cheekSquint", 0.30, 0.20),
    ("mouthSmile", "mouthDimple", 0.10, 0.12),
    ("mouthSmile", "noseSneer", 0.04, 0.06),
    ("browDown", "noseSneer", 0.14, 0.12),
    ("browDown", "eyeSquint", 0.20, 0.15),
    ("noseSneer", "mouthUpperUp", 0.20, 0.15),
    ("noseSneer", "cheekSquint", 0.20, 0.15),
    ("browOuterUp", "browInnerUp", 0.25, 0.25),
    ("browOuterUp", "eyeWide", 0.20, 0.15),
    ("browInnerUp", "browDown", 0.05, 0.08),
    ("jawOpen", "mouthLowerDown", 0.08, 0.08),
    ("jawOpen", "mouthStretch", 0.06, 0.08),
    ("mouthStretch", "mouthFrown", 0.10, 0.15),
    ("mouthFrown", "mouthShrugLower", 0.20, 0.15),
    ("mouthPress", "mouthDimple", 0.15, 0.15),
    ("mouthPucker", "mouthFunnel", 0.06, 0.08),
    ("cheekSquint", "eyeSquint", 0.40, 0.20),
)


@dataclass(frozen=True, eq=False)
class ActingStyle:
    """Habits of one performer.

    Parameters
    ----------
    tempo : float
        Speed of speech and gestures.
    effort : float
        Reach of speech.
    reach : ndarray of shape (46,), float64
        Reach of each shape in gestures, sides apart.
    recruitment : ndarray of shape (46, 46), float64
        Activation of shapes (rows) by intended ones (columns): the identity and what comes along.
    delays : ndarray of shape (46,), float64, seconds
        How late each shape comes: one side of the face leads.
    side : str
        The side of one-sided expressions, ``"L"`` or ``"R"``.
    blink_interval : float
        Mean time between blinks, seconds.
    head : float
        Liveliness of the head.
    unrest : float
        Standard deviation of small involuntary activation.
    """

    tempo: float
    effort: float
    reach: NDArray[np.float64]
    recruitment: NDArray[np.float64]
    delays: NDArray[np.float64]
    side: str
    blink_interval: float
    head: float
    unrest: float


def draw_style(rng: np.random.Generator) -> ActingStyle:
    """Draw the habits of a performer."""
    n = len(BLENDSHAPE_NAMES)
    partner = np.array([BLENDSHAPE_NAMES.index(mirrored_name(name)) for name in BLENDSHAPE_NAMES])
    reach = rng.uniform(0.75, 1.15, n)
    lean = rng.normal(0.0, 0.10, n)
    delays = rng.uniform(0.0, 0.02, n)
    leader = rng.choice(["L", "R"])
    for i, j in enumerate(partner):
        if i < j:
            reach[i], reach[j] = reach[i] * (1.0 + lean[i]), reach[i] * (1.0 - lean[i])
            late = abs(rng.normal(0.0, 0.012))
            delays[j] = delays[i]
            delays[j if leader == "L" else i] += late
    reach[SHAPE_INDEX["mouthClose"]] = reach[SHAPE_INDEX["jawOpen"]]
    delays[SHAPE_INDEX["mouthClose"]] = delays[SHAPE_INDEX["jawOpen"]]
    recruitment = np.eye(n)
    for source, target, mean, spread in _RECRUITED:
        strength = max(0.0, rng.normal(mean, spread))
        for i in columns_of(source):
            same_side = [k for k in columns_of(target) if BLENDSHAPE_NAMES[k][-2:] == BLENDSHAPE_NAMES[i][-2:]]
            for k in same_side or columns_of(target):
                recruitment[k, i] += strength * rng.uniform(0.85, 1.15)
    return ActingStyle(
        tempo=float(rng.uniform(0.9, 1.12)),
        effort=float(rng.uniform(0.85, 1.15)),
        reach=reach,
        recruitment=recruitment,
        delays=delays,
        side=str(rng.choice(["L", "R"])),
        blink_interval=float(rng.uniform(1.8, 3.5)),
        head=float(rng.uniform(0.7, 1.3)),
        unrest=float(rng.uniform(0.012, 0.025)),
    )
