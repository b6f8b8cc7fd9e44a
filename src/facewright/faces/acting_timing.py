"""Time courses that acting is made of: smooth steps and bumps, slow wandering, filters, blinks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, mirrored_name

SHAPE_INDEX = {name: i for i, name in enumerate(BLENDSHAPE_NAMES)}

#: Seconds a lid takes to close, stays shut and takes to open in a blink: ranges.
_CLOSING, _SHUT, _OPENING = (0.10, 0.14), (0.015, 0.05), (0.18, 0.28)


def columns_of(name: str) -> list[int]:
    """Return the columns of a shape; those of both sides where the name says none.

    Examples
    --------
    >>> [BLENDSHAPE_NAMES[i] for i in columns_of("mouthSmile")]
    ['mouthSmile_L', 'mouthSmile_R']
    """
    return [SHAPE_INDEX[name]] if name in SHAPE_INDEX else [SHAPE_INDEX[f"{name}_L"], SHAPE_INDEX[f"{name}_R"]]


def gesture_weights(gesture: dict[str, float], side: str = "L") -> NDArray[np.float64]:
    """Return the (46,) weights of a gesture; a name that ends in ``*`` acts on `side` alone."""
    weights = np.zeros(len(BLENDSHAPE_NAMES))
    for name, strength in gesture.items():
        if not name.endswith("*"):
            weights[columns_of(name)] = strength
        elif f"{name[:-1]}_{side}" in SHAPE_INDEX:
            weights[SHAPE_INDEX[f"{name[:-1]}_{side}"]] = strength
        else:
            left = SHAPE_INDEX[f"{name[:-1]}Left"]
            weights[left if side == "L" else SHAPE_INDEX[mirrored_name(f"{name[:-1]}Left")]] = strength
    return weights


def smooth_step(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the minimum-jerk way from 0 (u <= 0) to 1 (u >= 1)."""
    v = np.clip(u, 0.0, 1.0)
    return v**3 * (10.0 - 15.0 * v + 6.0 * v * v)


def bump(times: NDArray[np.float64], start: float, rise: float, hold: float, fall: float) -> NDArray[np.float64]:
    """Return a smooth rise from 0 at `start` to 1, a hold and a fall back to 0, seconds."""
    return smooth_step((times - start) / rise) * (1.0 - smooth_step((times - start - rise - hold) / fall))


def wander(
    times: NDArray[np.float64], rng: np.random.Generator, n: int, slowest_hz: float, fastest_hz: float
) -> NDArray[np.float64]:
    """Return (T, n) smooth random courses with a standard deviation of about 1: six sines each, 1 / f amplitudes."""
    n_waves = 6
    hz = np.exp(rng.uniform(np.log(slowest_hz), np.log(fastest_hz), (n_waves, n)))
    size = (slowest_hz / hz) ** 0.7
    size *= np.sqrt(2.0 / (size**2).sum(axis=0))
    phase = rng.uniform(0.0, 2.0 * np.pi, (n_waves, n))
    return np.einsum("wn,twn->tn", size, np.sin(2.0 * np.pi * hz * times[:, None, None] + phase))


def low_pass(values: NDArray[np.float64], frames_per_second: float, sigma_s: float) -> NDArray[np.float64]:
    """Return rows (T, ...) smoothed by a Gaussian of standard deviation `sigma_s` seconds."""
    return gaussian_filter1d(values, sigma_s * frames_per_second, axis=0, mode="nearest")


def blinks(times: NDArray[np.float64], rng: np.random.Generator, interval_s: float) -> NDArray[np.float64]:
    """Return how shut the lids are, (T,): blinks of 100-140 ms closing and 180-280 ms opening, at random times."""
    shut = np.zeros(len(times))
    t = float(times[0]) + rng.uniform(0.2, 1.0) * interval_s
    while t < times[-1]:
        strength = rng.uniform(0.93, 1.0)
        course = bump(times, t, rng.uniform(*_CLOSING), rng.uniform(*_SHUT), rng.uniform(*_OPENING))
        shut = np.maximum(shut, strength * course)
        t += max(0.6, rng.gamma(4.0, interval_s / 4.0))
    return shut
