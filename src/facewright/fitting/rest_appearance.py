"""What a clip's own skin looks like: brightness of each point, and how it changes as the skin turns in the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

#: Logarithm of the shading: a polynomial of second order of the normal in the camera's frame.
N_LIGHT = 8
#: Spread of the skin's own log brightness between points; precision of the light's coefficients about none at all.
_ALBEDO_SPREAD, _LIGHT_PRECISION = 0.2, 50.0
#: Usual error of the log brightness, and its robust scale in the first round and later.
_ERROR, _FIRST_SCALE, _SCALE = 0.06, 0.25, 0.12
#: Points that an expression moves tell less of the rest: half at this distance, millimetres.
_MOVED_MM = 2.5
#: Darker than this is not told from black.
_DARKEST = 4.0
_ROUNDS = 8


class SkinSamples(NamedTuple):
    """What is seen of N points in K frames.

    Parameters
    ----------
    brightness : ndarray of shape (K, N)
        sRGB levels.
    normals : ndarray of shape (K, N, 3)
        In the camera's frame.
    seen : ndarray of shape (K, N)
        0 hidden to 1 seen well.
    displaced : ndarray of shape (K, N), millimetres
        How far the expression moves the point.
    """

    brightness: NDArray[np.float64]
    normals: NDArray[np.float64]
    seen: NDArray[np.float64]
    displaced: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RestAppearance:
    """A clip's skin.

    Parameters
    ----------
    brightness : ndarray of shape (N,)
        sRGB levels of the points under light of no direction.
    light : ndarray of shape (8,)
        Coefficients of `light_terms`: logarithm of the shading.
    noise : ndarray of shape (N,)
        Usual error of each point, sRGB levels; infinite where it was not seen.
    """

    brightness: NDArray[np.float64]
    light: NDArray[np.float64]
    noise: NDArray[np.float64]

    @classmethod
    def learned(cls, samples: SkinSamples) -> RestAppearance:
        """Separate brightness, light and each frame's exposure: robust least squares of the log brightness.

        log I = a_point + light . terms(normal) + exposure_frame, with little light and points alike where the clip
        does not tell.
        """
        P = light_terms(samples.normals)
        L = np.log(np.maximum(samples.brightness, _DARKEST))
        trust = samples.seen / (1.0 + (samples.displaced / _MOVED_MM) ** 2)
        trust *= np.clip(samples.brightness / 60.0, 0.05, 1.5) ** 2 / _ERROR**2
        middle = float(np.median(L[samples.seen > 0.5])) if (samples.seen > 0.5).any() else float(np.median(L))
        light, exposure, robust = np.zeros(N_LIGHT), np.zeros(len(L)), np.ones_like(L)
        albedo = np.zeros(L.shape[1])
        for k in range(_ROUNDS):
            w = trust * robust
            Y = L - middle - exposure[:, None]
            total = w.sum(axis=0) + 1.0 / _ALBEDO_SPREAD**2
            mean_P, mean_Y = np.einsum("kv,kvc->vc", w, P) / total[:, None], (w * Y).sum(axis=0) / total
            weighted = (w[:, :, None] * P).reshape(-1, N_LIGHT)
            A = weighted.T @ P.reshape(-1, N_LIGHT) - (mean_P * total[:, None]).T @ mean_P
            b = weighted.T @ Y.ravel() - mean_P.T @ (total * mean_Y)
            light = np.linalg.solve(A + _LIGHT_PRECISION * np.eye(N_LIGHT), b)
            albedo = mean_Y - mean_P @ light
            r = Y - P @ light - albedo
            exposure += (w * r).sum(axis=1) / np.maximum(w.sum(axis=1), 1e-9)
            exposure -= exposure.mean()
            middle += 0.5 * float(np.median(albedo))
            scale = _FIRST_SCALE if k == 0 else _SCALE
            robust = 1.0 / (1.0 + (r / scale) ** 2) ** (1 if k == 0 else 2)
        rest = np.exp(middle + albedo)
        error = np.abs(samples.brightness - rest * np.exp(P @ light + exposure[:, None]))
        usable = samples.seen > 0.05
        noise = 1.4826 * np.nanmedian(np.where(usable.any(axis=0), np.where(usable, error, np.nan), np.inf), axis=0)
        return cls(rest, light, noise)


def light_terms(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the eight terms (..., 8) of unit normals (..., 3) in the camera's frame."""
    x, y, z = np.moveaxis(normals, -1, 0)
    return np.stack([x, y, z, x * y, x * z, y * z, x * x - y * y, z * z], axis=-1)


@njit(cache=True, inline="always")
def light_slope(light, x, y, z):  # type: ignore[no-untyped-def]
    """Return the log shading of a normal and its derivative by it."""
    value = (
        light[0] * x
        + light[1] * y
        + light[2] * z
        + light[3] * x * y
        + light[4] * x * z
        + light[5] * y * z
        + light[6] * (x * x - y * y)
        + light[7] * z * z
    )
    by_x = light[0] + light[3] * y + light[4] * z + 2.0 * light[6] * x
    by_y = light[1] + light[3] * x + light[5] * z - 2.0 * light[6] * y
    by_z = light[2] + light[4] * x + light[5] * y + 2.0 * light[7] * z
    return value, by_x, by_y, by_z
