"""How much light gets between lips and lids, by the place within the opening."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always")
def between_lips(height, corner, behind):  # type: ignore[no-untyped-def]
    """Return the share of light, linear, that gets between lips: little into a slit, into depth and the corners.

    In millimetres: how far the lips are apart there, how far the nearer corner is, how far teeth are behind the lip.
    """
    gap, deep = max(height, 0.0), 1.2 + 0.5 * max(behind, 0.0)
    return min(1.0, 1.08 * gap * gap / (gap * gap + deep * deep)) * (1 - 0.28 * np.exp(-max(corner, 0.0) / 3.0))


@njit(cache=True, nogil=True, inline="always")
def slit_share(height, below, above, least, most):  # type: ignore[no-untyped-def]
    """Return how far what lies between lips that are `height` mm apart is lost in the dark: 1 up to `least`.

    Wider openings are dark along the lips only, by how far a place is below the upper and above the lower one, mm.
    """
    seen = min(max((height - least) / (most - least), 0.0), 1.0)
    seen *= seen * (3 - 2 * seen)  # eased at both ends, so that teeth do not appear at once
    wide = min(max((height - most) / most, 0.0), 1.0)
    edge = 0.45 * np.exp(-((below / 0.7) ** 2)) + 0.30 * np.exp(-((above / 0.5) ** 2))
    return 1 - seen * (1 - min(edge, 1.0) * (1 - wide))


@njit(cache=True, nogil=True, inline="always")
def under_lip(below, shadow, behind):  # type: ignore[no-untyped-def]
    """Return the share of light, linear, that an upper lip `behind` mm off the teeth leaves so far below it."""
    return 1 - shadow * np.exp(-max(below, 0.0) / min(max(0.5 * behind, 0.8), 3.0))


@njit(cache=True, nogil=True, inline="always")
def between_lids(below, above, corner, shadow, shadow_mm):  # type: ignore[no-untyped-def]
    """Return the share of light, sRGB over sRGB, on an eyeball at distances (mm) from lids and nearer corner."""
    light = 1 - shadow * np.exp(-max(below, 0.0) / shadow_mm)
    return light * (1 - 0.15 * np.exp(-max(above, 0.0) / 0.8)) * (1 - 0.22 * np.exp(-max(corner, 0.0) / 2.0))
