"""Numba kernel of driving a dense character: sparse weights, and a piece that turns with the jaw."""

from __future__ import annotations

import numpy as np
from numba import njit

_REORDERED = {"reassoc", "contract", "nsz", "arcp"}


@njit(cache=True, nogil=True, fastmath=_REORDERED)
def drive(  # type: ignore[no-untyped-def]
    moved, turns, carried, starts, columns, weights, rest, jaw_points, jaw_matrix, jaw_centre, jaw_ids, jaw_shares, out
):
    """Write rest + what follows `moved` (N, 3) into `out` (V, 3); `carried` (N, 3) float32 is working space.

    turns (N, 3, 3) carry a displacement to the character; rows of weights in CSR form. `jaw_matrix` (6, 3 K) gives
    rotation vector and translation from the displacements of `jaw_points`; the vertices `jaw_ids` take their share.
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
    if jaw_ids.size == 0:
        return
    motion = np.zeros(6)
    for a in range(6):
        for k in range(jaw_points.size):
            for c in range(3):
                motion[a] += jaw_matrix[a, 3 * k + c] * carried[jaw_points[k], c]
    angle = np.sqrt(motion[0] ** 2 + motion[1] ** 2 + motion[2] ** 2)
    sine = np.sin(angle) / angle if angle > 1e-12 else 1.0
    versine = (1.0 - np.cos(angle)) / (angle * angle) if angle > 1e-6 else 0.5
    for k in range(jaw_ids.size):
        v, share = jaw_ids[k], jaw_shares[k]
        ax, ay, az = rest[v, 0] - jaw_centre[0], rest[v, 1] - jaw_centre[1], rest[v, 2] - jaw_centre[2]
        tx = motion[1] * az - motion[2] * ay  # rotation vector x arm
        ty = motion[2] * ax - motion[0] * az
        tz = motion[0] * ay - motion[1] * ax
        ux = motion[1] * tz - motion[2] * ty  # and once more
        uy = motion[2] * tx - motion[0] * tz
        uz = motion[0] * ty - motion[1] * tx
        out[v, 0] += share * (sine * tx + versine * ux + motion[3])
        out[v, 1] += share * (sine * ty + versine * uy + motion[4])
        out[v, 2] += share * (sine * tz + versine * uz + motion[5])
