"""sRGB to linear light and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def linear_from_srgb(srgb: NDArray[np.floating]) -> NDArray[np.float32]:
    """Decode sRGB values in [0, 1] to linear light (IEC 61966-2-1), float32 of the same shape."""
    s = np.asarray(srgb, dtype=np.float32)
    return np.where(s <= 0.04045, s / 12.92, ((np.maximum(s, 0.0) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def srgb_from_linear(linear: NDArray[np.floating]) -> NDArray[np.float32]:
    """Encode linear light as sRGB; values are clipped to [0, 1]; float32 of the same shape."""
    x = np.clip(np.asarray(linear, dtype=np.float32), 0.0, 1.0)
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)
