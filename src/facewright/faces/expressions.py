"""The 20 FaceWarehouse expressions as blendshape weights, and random plausible expressions."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, read_json, read_package_json
from facewright.numeric.check import check_choice

EXPRESSION_NAMES: tuple[str, ...] = (
    "neutral",
    "mouth_stretch",
    "smile",
    "brow_lower",
    "brow_raiser",
    "anger",
    "jaw_left",
    "jaw_right",
    "jaw_forward",
    "mouth_left",
    "mouth_right",
    "dimpler",
    "chin_raiser",
    "lip_puckerer",
    "lip_funneler",
    "sadness",
    "lip_roll",
    "grin",
    "cheek_blowing",
    "eyes_closed",
)
"""The 20 expressions every subject acts in FaceWarehouse, section 3.1; guide poses G_0 .. G_19."""

# Shapes that pull one place two ways, or that nobody can do together.
OPPOSED: tuple[tuple[str, ...], ...] = (
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight", "mouthPucker", "mouthFunnel", "mouthRollLower"),
    ("mouthLeft", "mouthRight", "mouthPucker", "mouthFunnel", "mouthRollUpper"),
    ("eyeBlink_L", "eyeWide_L"),
    ("eyeBlink_R", "eyeWide_R"),
    ("eyeBlink_L", "eyesLookDown"),
    ("eyeBlink_R", "eyesLookDown"),
    ("eyeWide_L", "eyesLookDown"),
    ("eyeWide_R", "eyesLookDown"),
    ("browDown_L", "browOuterUp_L"),
    ("browDown_R", "browOuterUp_R"),
    ("mouthSmile_L", "mouthFrown_L"),
    ("mouthSmile_R", "mouthFrown_R"),
    ("mouthPucker", "mouthFunnel", "mouthStretch_L"),
    ("mouthPucker", "mouthFunnel", "mouthStretch_R"),
    ("mouthPucker", "mouthSmile_L"),
    ("mouthPucker", "mouthSmile_R"),
    ("mouthRollLower", "mouthLowerDown_L"),
    ("mouthRollLower", "mouthLowerDown_R"),
    ("mouthRollLower", "mouthFunnel"),
    ("mouthRollUpper", "mouthUpperUp_L"),
    ("mouthRollUpper", "mouthUpperUp_R"),
    ("mouthRollUpper", "mouthFunnel"),
)
"""Groups of which at most one shape is active in `random_expression_weights`."""


def __getattr__(name: str) -> Any:
    if name == "EXPRESSION_WEIGHTS":
        return _builtin_expressions()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def expression_weights(name: str) -> NDArray[np.float64]:
    """Return the (46,) blendshape weights of one of the 20 expressions.

    Raises
    ------
    ValueRangeError
        If the name is not in `EXPRESSION_NAMES`.

    Examples
    --------
    >>> float(expression_weights("neutral").sum())
    0.0
    """
    check_choice("expression", name, EXPRESSION_NAMES)
    return _builtin_expressions()[EXPRESSION_NAMES.index(name)].copy()


def load_expressions(path: Path) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Read named expressions from a JSON file laid out like ``expressions_20.json``, to replace ours.

    Returns
    -------
    names : tuple of str
        The N names in the file's order.
    weights : ndarray of shape (N, 46), float64
        Blendshape weights in [0, 1].

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is not JSON, or names an unknown shape, or a weight is outside [0, 1].
    """
    return _parse_expressions(read_json(Path(path)), Path(path).name)


@cache
def _builtin_expressions() -> NDArray[np.float64]:
    names, weights = _parse_expressions(read_package_json("expressions_20.json"), "expressions_20.json")
    if names != EXPRESSION_NAMES:
        raise FileFormatError("expressions_20.json must hold the 20 expressions of FaceWarehouse in their order.")
    weights.flags.writeable = False
    return weights


def _parse_expressions(content: object, where: str) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    entries = content.get("expressions") if isinstance(content, dict) else None
    if not isinstance(entries, dict) or not entries:
        raise FileFormatError(f"{where} must be a JSON object with an object 'expressions' of named weights.")
    weights = np.zeros((len(entries), len(BLENDSHAPE_NAMES)))
    for row, (name, shapes) in zip(weights, entries.items()):
        if not isinstance(shapes, dict):
            raise FileFormatError(f"{where}: expression {name!r} must be an object of weights, got {shapes!r}.")
        for shape, weight in shapes.items():
            if shape not in BLENDSHAPE_NAMES:
                raise FileFormatError(f"{where}: expression {name!r} uses the unknown blendshape {shape!r}.")
            if not isinstance(weight, int | float) or not 0.0 <= weight <= 1.0:
                raise FileFormatError(f"{where}: {name}.{shape} must be a number in [0, 1], got {weight!r}.")
            row[BLENDSHAPE_NAMES.index(shape)] = weight
    return tuple(entries), weights


def random_expression_weights(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Draw `n` plausible expressions: a few active shapes each, mostly symmetric, nothing opposed at once.

    Each draw activates every group of shapes (a left-right pair counts as one) with probability 0.22, at a strength in
    [0.1, 1]; one pair in four is one-sided or uneven. Of opposed shapes the strongest stays, and ``mouthClose`` never
    exceeds ``jawOpen``.

    Returns
    -------
    ndarray of shape (n, 46), float64
        Weights in [0, 1], order of `BLENDSHAPE_NAMES`.
    """
    index = {name: i for i, name in enumerate(BLENDSHAPE_NAMES)}
    weights = np.zeros((n, len(BLENDSHAPE_NAMES)))
    for name, i in index.items():
        if name.endswith("_R"):
            continue  # drawn with its left counterpart
        strength = np.where(rng.random(n) < 0.22, rng.uniform(0.1, 1.0, n), 0.0)
        weights[:, i] = strength
        if name.endswith("_L"):
            uneven = rng.random(n) < 0.25
            share = np.where(uneven, rng.uniform(0.0, 1.0, n), rng.uniform(0.9, 1.0, n))
            weaker_left = rng.random(n) < 0.5
            weights[:, i] = np.where(weaker_left, strength * share, strength)
            weights[:, index[name[:-1] + "R"]] = np.where(weaker_left, strength, strength * share)
    rows = np.arange(n)
    for group in OPPOSED:
        columns = np.array([index[name] for name in group])
        kept = columns[np.argmax(weights[:, columns], axis=1)]
        strongest = weights[rows, kept]
        weights[:, columns] = 0.0
        weights[rows, kept] = strongest
    close, jaw = index["mouthClose"], index["jawOpen"]
    weights[:, close] = np.minimum(weights[:, close], weights[:, jaw])
    return weights
