"""What a clip's face does at rest: shapes that are hardly ever absent belong to the face, not to what it acts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.numeric.check import check_shape

#: A shape's coefficient at rest is exceeded in all but this share of the frames.
_QUANTILE = 0.2
#: Up to here it is taken away; what is twice as strong is acted throughout, and stays.
_MOST = 0.25
#: Shorter clips say little of the rest: half as much is taken away at half as many frames.
_FRAMES = 75


def without_rest(weights: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return coefficients of a clip's frames less those of its rest.

    Nobody does one thing all the time: what seems to be there in every frame is how this face differs from the model
    and the detector's average, unless it is strong.

    Parameters
    ----------
    weights : ndarray of shape (T, B)
        FACS coefficients of the tracked frames, in [0, 1].

    Returns
    -------
    ndarray of shape (T, B)
        In [0, 1].
    """
    check_shape("weights", weights, "T", "B")
    if not len(weights):
        return np.asarray(weights, dtype=np.float64)
    rest = np.quantile(weights, _QUANTILE, axis=0)
    rest = rest * np.clip((2.0 * _MOST - rest) / _MOST, 0.0, 1.0) * min(1.0, len(weights) / _FRAMES)
    return np.clip(weights - rest, 0.0, 1.0)
