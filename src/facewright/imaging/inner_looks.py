"""What the kernel that draws eyes and mouths takes of each, in its order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.imaging._inner_kernels import N_MOUTH_COLUMNS


class EyeLook(NamedTuple):
    """What the kernel takes of an eye."""

    grain: NDArray[np.float32]
    lash_colour: NDArray[np.float32]
    lash_line: NDArray[np.float32]
    picture: NDArray[np.float32]
    x: np.float32
    y: np.float32
    iris: NDArray[np.float64]
    glint: NDArray[np.float32]
    glint_x: np.float32
    glint_y: np.float32


class MouthLook(NamedTuple):
    """What the kernel takes of a mouth."""

    columns: NDArray[np.float32]
    flesh: NDArray[np.float32]
    tooth: NDArray[np.float32]
    wall: NDArray[np.float32]
    depth_mm: np.float32
    tongue: np.float32
    key: np.float32
    was_behind: np.float32
    slit: NDArray[np.float32]
    skull: NDArray[np.float32]
    skull_map: NDArray[np.float64]
    jaw: NDArray[np.float32]
    jaw_map: NDArray[np.float64]


_ZERO = np.float32(0)
NO_LINE = np.zeros((3, 0), np.float32)
NO_EYE = EyeLook(
    np.zeros((2, 2, 3), np.float32),
    np.zeros(5, np.float32),
    NO_LINE,
    np.zeros((2, 2, 3), np.float32),
    _ZERO,
    _ZERO,
    np.ones(3),
    np.zeros((2, 2, 3), np.float32),
    _ZERO,
    _ZERO,
)
NO_LAYER, NO_MAP, NO_COLOUR = np.zeros((0, 0, 5), np.float32), np.zeros((8, 2)), np.zeros(3, np.float32)
NO_MOUTH = MouthLook(
    np.zeros((1, N_MOUTH_COLUMNS), np.float32),
    NO_COLOUR,
    NO_COLOUR,
    NO_COLOUR,
    np.float32(1),
    _ZERO,
    _ZERO,
    np.float32(1),
    np.array([0, 0, 0, 0, 1], np.float32),
    NO_LAYER,
    NO_MAP,
    NO_LAYER,
    NO_MAP,
)
