"""A map corrected so that given points of the face lie exactly where the photo shows them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.numeric.check import check_shape

_REACH = 0.06  # of a correction, as a share of the head's size
_SMOOTH = 0.02  # beside the kernel's 1 at a point: points of closed lips lie on each other
_BLOCK = 64  # rows at a time


def meet_points(
    displacement: NDArray[np.float32],
    origin: tuple[int, int],
    target: NDArray[np.floating],
    source: NDArray[np.floating],
    head_size: float,
) -> None:
    """Change an inverse map, in place, so that points of the target picture are looked up at their source.

    What is missing at the points is interpolated by compactly supported radial functions: farther than 6 % of the
    head's size from all of them the map stays as it is.

    Parameters
    ----------
    displacement : ndarray of shape (h, w, 2), float32, pixels
        Source position minus target position.
    origin : (x, y)
        Its first pixel.
    target, source : ndarray of shape (K, 2), pixels
        The points in both pictures; those outside the map do not count.
    head_size : float
        Pixels.

    Raises
    ------
    ShapeError
        If the shapes do not match.
    """
    sizes = check_shape("displacement", displacement, "h", "w", 2)
    count = check_shape("target", target, "K", 2)
    check_shape("source", source, "K", 2, **count)
    h, w = sizes["h"], sizes["w"]
    reach = max(_REACH * head_size, 1.0)
    at = np.asarray(target, dtype=np.float64) - origin
    inside = ((at >= 0) & (at <= (w - 1, h - 1))).all(axis=1)
    at = at[inside]
    if not len(at):
        return
    have = [ndimage.map_coordinates(displacement[..., c], [at[:, 1], at[:, 0]], order=1) for c in (0, 1)]
    missing = (np.asarray(source, dtype=np.float64) - target)[inside] - np.stack(have, axis=1)
    between = _wendland(np.linalg.norm(at[:, None] - at[None], axis=2) / reach)
    weights = np.linalg.solve(between + _SMOOTH * np.eye(len(at)), missing)
    low = np.maximum(np.floor(at.min(axis=0) - reach), 0).astype(int)
    high = np.minimum(np.ceil(at.max(axis=0) + reach) + 1, (w, h)).astype(int)
    x = np.arange(low[0], high[0])
    for top in range(low[1], high[1], _BLOCK):
        y = np.arange(top, min(top + _BLOCK, high[1]))
        near = np.abs(at[:, 1] - np.clip(at[:, 1], y[0], y[-1])) < reach
        if near.any():
            r = np.hypot(x[None, :, None] - at[near, 0], y[:, None, None] - at[near, 1]) / reach
            displacement[y[0] : y[-1] + 1, low[0] : high[0]] += (_wendland(r) @ weights[near]).astype(np.float32)


def _wendland(r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Wendland's function of smoothness C2: 1 at 0, 0 from 1 on."""
    return np.asarray(np.maximum(1.0 - r, 0.0) ** 4 * (4.0 * r + 1.0))
