"""Whole meshes of the bilinear model, without the core rows that do not matter for the face at hand."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.models.bilinear import BilinearModel
from facewright.numeric.threads import for_blocks

_BLOCK = 17408  # coordinates summed at a time: long stretches of the core, two of them for 11,248 vertices


class MeshSynthesiser:
    """Synthesises faces of one model fast, to a stated tolerance.

    Reading the core is what takes the time. Of its I E rows, each a displacement field, most add next to nothing to
    any one face: the smallest are left out as long as what they add together, taken as uncorrelated, stays below the
    tolerance.

    Parameters
    ----------
    model : BilinearModel
        The model.
    tolerance_mm : float
        RMS over the vertices of what may be left out; 0 leaves nothing out.
    """

    def __init__(self, model: BilinearModel, tolerance_mm: float = 0.03) -> None:
        self.model = model
        self.tolerance_mm = tolerance_mm
        self._rows = model.core_rows.reshape(model.n_identity * model.n_expression, -1)
        self._rms = np.sqrt(np.einsum("rv,rv->r", self._rows, self._rows) / model.n_vertices)

    def vertices(self, w_id: NDArray[np.floating], w_exp: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the face (V, 3), millimetres, of identity and expression weights: eq. (10)."""
        weights = np.outer(w_id, w_exp).reshape(-1)
        square = (weights * self._rms) ** 2
        order = np.argsort(square)
        left_out = np.searchsorted(np.cumsum(square[order]), self.tolerance_mm**2, side="right")
        rows = np.sort(order[left_out:])
        out = np.zeros(self._rows.shape[1], dtype=np.float32)
        w = weights[rows].astype(np.float32)
        for_blocks(out.size, _BLOCK, lambda start, stop: _combine(self._rows, rows, w, out, start, stop))
        return out.reshape(-1, 3)


@njit(cache=True, nogil=True, fastmath=True)
def _combine(core, rows, weights, out, start, stop):  # type: ignore[no-untyped-def]
    part = out[start:stop]
    for k in range(rows.size):
        w = weights[k]
        row = core[rows[k], start:stop]
        for j in range(part.size):
            part[j] += w * row[j]
