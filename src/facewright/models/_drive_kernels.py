"""Numba kernels of driving a dense character: sparse weights, what goes with the jaw, lips and lids that meet."""

from __future__ import annotations

import numpy as np
from numba import njit

_REORDERED = {"reassoc", "contract", "nsz", "arcp"}
_PASSES = 3
_CLOSED = 0.3  # of a pair's reach: a gap below is closed, one above the reach stays


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def follow(moved, turns, carried, starts, columns, weights, rest, out):  # type: ignore[no-untyped-def]
    """Write rest + what follows `moved` (N, 3) into `out` (V, 3); `carried` (N, 3) receives turns (N, 3, 3) moved.

    Rows of weights in CSR form. Starts and columns are unsigned: no test for negative indices, half the time.
    """
    for n in range(moved.shape[0]):
        for c in range(3):
            carried[n, c] = turns[n, c, 0] * moved[n, 0] + turns[n, c, 1] * moved[n, 1] + turns[n, c, 2] * moved[n, 2]
    for v in range(rest.shape[0]):
        x, y, z = rest[v, 0], rest[v, 1], rest[v, 2]
        for k in range(starts[v], starts[v + 1]):
            w = weights[k]
            n = columns[k]
            x += w * carried[n, 0]
            y += w * carried[n, 1]
            z += w * carried[n, 2]
        out[v, 0], out[v, 1], out[v, 2] = x, y, z


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def follow_jaw(  # type: ignore[no-untyped-def]
    carried, points, matrix, centre, ids, shares, skin_ids, skin_lean, rest, out
):
    """Add the jaw's motion: `matrix` (6, 3 K) of the points' displacements gives rotation vector and translation.

    The vertices `ids` take their share of it, rigidly; the skin `skin_ids` what `skin_lean` (A, 3, 6) makes of it.
    """
    motion = np.zeros(6)
    for a in range(6):
        for k in range(points.size):
            for c in range(3):
                motion[a] += matrix[a, 3 * k + c] * carried[points[k], c]
    angle = np.sqrt(motion[0] ** 2 + motion[1] ** 2 + motion[2] ** 2)
    sine = np.sin(angle) / angle if angle > 1e-12 else 1.0
    versine = (1.0 - np.cos(angle)) / (angle * angle) if angle > 1e-6 else 0.5
    for k in range(ids.size):
        v, share = ids[k], shares[k]
        ax, ay, az = rest[v, 0] - centre[0], rest[v, 1] - centre[1], rest[v, 2] - centre[2]
        tx = motion[1] * az - motion[2] * ay  # rotation vector x arm
        ty = motion[2] * ax - motion[0] * az
        tz = motion[0] * ay - motion[1] * ax
        ux = motion[1] * tz - motion[2] * ty  # and once more
        uy = motion[2] * tx - motion[0] * tz
        uz = motion[0] * ty - motion[1] * tx
        out[v, 0] += share * (sine * tx + versine * ux + motion[3])
        out[v, 1] += share * (sine * ty + versine * uy + motion[4])
        out[v, 2] += share * (sine * tz + versine * uz + motion[5])
    for k in range(skin_ids.size):
        v = skin_ids[k]
        for c in range(3):
            value = 0.0
            for a in range(6):
                value += skin_lean[k, c, a] * motion[a]
            out[v, c] += value


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def seal(upper, lower, floors, reaches, moved, spread, out):  # type: ignore[no-untyped-def]
    """Lift upper from lower vertices where they cross, and close gaps that are nearly closed, smoothly around."""
    change = np.zeros(upper.size, np.float32)
    largest = 0.0
    for k in range(upper.size):
        gap = out[upper[k], 1] - out[lower[k], 1] - floors[k]
        if gap >= reaches[k]:
            continue
        t = max((gap / reaches[k] - _CLOSED) / (1.0 - _CLOSED), 0.0)
        change[k] = gap * t * t * (3.0 - 2.0 * t) - gap
        largest = max(largest, abs(change[k]))
    if largest < 1e-6:
        return
    for j in range(moved.size):
        value = 0.0
        for k in range(upper.size):
            value += spread[j, k] * change[k]
        out[moved[j], 1] += value


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def clear_eyeballs(ids, eye, margins, centres, radii, out):  # type: ignore[no-untyped-def]
    """Move vertices of the lids out of the eyeballs at their height: lids that meet go on meeting, none is stretched.

    Away from the vertical axis through the centre of each eyeball, whose radius goes by the angle to +z.
    """
    bins = radii.shape[1]
    for k in range(ids.size):
        v, e = ids[k], eye[k]
        x, y, z = out[v, 0] - centres[e, 0], out[v, 1] - centres[e, 1], out[v, 2] - centres[e, 2]
        across = np.sqrt(x * x + z * z)
        if across < 1e-6:
            continue
        for _ in range(_PASSES):  # the radius changes with the angle
            length = np.sqrt(x * x + y * y + z * z)
            place = (z / length + 1.0) * 0.5 * (bins - 1)
            low = min(int(place), bins - 2)
            share = place - low
            radius = radii[e, low] * (1.0 - share) + radii[e, low + 1] * share + margins[k]
            if length >= radius:
                break
            wider = np.sqrt(radius * radius - y * y) / across
            x, z, across = x * wider, z * wider, across * wider
            out[v, 0], out[v, 2] = centres[e, 0] + x, centres[e, 2] + z
