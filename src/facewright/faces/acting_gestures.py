"""Gestures that simulated performers are asked for: a range of motion, and 86 combinations of FACS shapes."""

from __future__ import annotations

from facewright.faces.blendshape_names import BLENDSHAPE_NAMES

Gesture = dict[str, float]

#: Gestures to extremes, part by part; parts move at the same time. ``*`` marks one side of the two.
RANGE_OF_MOTION: dict[str, tuple[Gesture, ...]] = {
    "brows": (
        {"browDown": 1.0},
        {"browInnerUp": 1.0, "browOuterUp": 1.0},
        {"browInnerUp": 1.0},
        {"browOuterUp*": 1.0},
        {"browDown": 0.8, "browInnerUp": 0.5},
        {"browDown*": 0.9},
    ),
    "lids": (
        {"eyeSquint": 1.0, "cheekSquint": 0.8},
        {"eyeWide": 1.0},
        {"eyeBlink": 1.0, "eyeSquint": 0.8},
        {"eyesLookDown": 1.0},
        {"eyeBlink*": 1.0, "cheekSquint*": 0.9},
        {"cheekSquint*": 1.0},
    ),
    "nose": ({"noseSneer": 1.0}, {"noseSneer*": 1.0}, {"noseSneer": 0.8, "mouthUpperUp": 0.7}),
    "mouth": (
        {"jawOpen": 0.95},
        {"jawOpen": 0.75, "mouthStretch": 0.8, "mouthLowerDown": 0.6},
        {"jawOpen": 0.6, "mouthFunnel": 0.9},
        {"jawOpen": 0.5, "mouthSmile": 0.9, "mouthUpperUp": 0.4},
        {"mouthSmile": 1.0, "cheekSquint": 0.7},
        {"mouthSmile*": 1.0, "mouthDimple*": 0.5},
        {"mouthDimple": 1.0, "mouthPress": 0.5},
        {"mouthFrown": 1.0, "mouthShrugLower": 0.7},
        {"mouthFrown*": 1.0},
        {"mouthPucker": 1.0},
        {"mouthFunnel": 1.0},
        {"mouthLeft": 0.9},
        {"mouthRight": 0.9},
        {"mouthPucker": 0.7, "mouthLeft": 0.7},
        {"mouthPucker": 0.7, "mouthRight": 0.7},
        {"jawLeft": 1.0, "jawOpen": 0.12},
        {"jawRight": 1.0, "jawOpen": 0.12},
        {"jawForward": 1.0},
        {"mouthRollLower": 0.8, "mouthRollUpper": 0.8},
        {"mouthPress": 1.0},
        {"mouthShrugLower": 0.9, "mouthShrugUpper": 0.7},
        {"mouthUpperUp": 1.0, "mouthLowerDown": 1.0},
        {"mouthUpperUp*": 1.0},
        {"mouthLowerDown*": 1.0},
        {"mouthStretch": 1.0},
        {"cheekPuff": 0.9},
        {"cheekPuff*": 0.9},
    ),
}


def _combinations() -> tuple[Gesture, ...]:
    """Return every shape on both sides, on each alone, and 24 combinations: 86."""
    bases: list[str] = []
    for name in BLENDSHAPE_NAMES:
        base = name.removesuffix("_L").removesuffix("_R")
        if base not in bases:
            bases.append(base)
    both: list[Gesture] = [{base: 1.0} if base != "mouthClose" else {base: 0.6, "jawOpen": 0.6} for base in bases]
    one = [{name: 1.0} for name in BLENDSHAPE_NAMES if name.endswith(("_L", "_R"))]
    several: list[Gesture] = [
        # the six basic expressions, EMFACS
        {"browDown": 1.0, "eyeWide": 0.6, "eyeSquint": 0.4, "mouthPress": 0.8},
        {"noseSneer": 1.0, "mouthFrown": 0.6, "mouthLowerDown": 0.4},
        {"browInnerUp": 0.9, "browOuterUp": 0.7, "browDown": 0.4, "eyeWide": 0.9, "mouthStretch": 0.8, "jawOpen": 0.2},
        {"browInnerUp": 1.0, "browDown": 0.4, "mouthFrown": 0.8},
        {"cheekSquint": 0.9, "mouthSmile": 1.0},
        {"browInnerUp": 1.0, "browOuterUp": 1.0, "eyeWide": 0.8, "jawOpen": 0.6},
        # pairs that meet in most faces
        {"browInnerUp": 1.0, "browOuterUp": 1.0},
        {"browInnerUp": 0.8, "browDown": 0.8},
        {"browDown": 0.9, "noseSneer": 0.9},
        {"noseSneer": 0.9, "mouthUpperUp": 0.9},
        {"mouthSmile": 0.9, "jawOpen": 0.5},
        {"mouthSmile": 0.8, "mouthPress": 0.7},
        {"mouthSmile": 0.8, "mouthUpperUp": 0.8},
        {"mouthFrown": 0.9, "mouthShrugLower": 0.8},
        {"mouthFunnel": 0.9, "jawOpen": 0.5},
        {"mouthPucker": 0.8, "mouthFunnel": 0.6},
        {"mouthStretch": 0.9, "jawOpen": 0.6},
        {"mouthUpperUp": 0.9, "mouthLowerDown": 0.9},
        {"mouthLowerDown": 0.9, "mouthStretch": 0.8},
        {"mouthRollLower": 0.8, "mouthRollUpper": 0.8},
        {"mouthShrugLower": 0.8, "mouthShrugUpper": 0.8},
        {"cheekPuff": 0.9, "mouthPress": 0.5},
        {"eyeBlink": 1.0, "browDown": 0.8, "cheekSquint": 0.8},
        {"jawForward": 0.7, "mouthShrugLower": 0.5, "browDown": 0.6},
    ]
    return (*both, *one, *several)


FACS_COMBINATIONS: tuple[Gesture, ...] = _combinations()
"""86 gestures, as many as the first performer of Tena et al. (2011) acted."""
