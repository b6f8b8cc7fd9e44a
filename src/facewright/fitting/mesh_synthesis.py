"""Whole meshes of the bilinear model, without the core rows that do not matter for the face at hand."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.models.bilinear import BilinearModel

#: The left-out part is measured on so many vertices, spread evenly over the mesh.
_PROBES = 512


class MeshSynthesiser:
    """Synthesises faces of one model fast, to a stated tolerance.

    Reading the core is what takes the time. Of its I E rows, each a displacement field, most add next to nothing to
    any one face: the smallest are left out as long as what they add together stays below the tolerance.

    Parameters
    ----------
    model : BilinearModel
        The model.
    tolerance_mm : float
        RMS over the vertices of what may be left out, measured on 512 of them; 0 leaves nothing out.
    """

    def __init__(self, model: BilinearModel, tolerance_mm: float = 0.03) -> None:
        self.model = model
        self.tolerance_mm = tolerance_mm
        self._rows = model.core_rows.reshape(model.n_identity * model.n_expression, -1)
        probes = np.unique(np.linspace(0, model.n_vertices - 1, _PROBES).astype(int))
        at_probes = model.core_rows[:, :, probes].reshape(len(self._rows), -1)
        self._probe_rows = np.ascontiguousarray(at_probes) / np.float32(np.sqrt(len(probes)))
        self._rms = np.linalg.norm(self._probe_rows, axis=1)

    def vertices(self, w_id: NDArray[np.floating], w_exp: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the face (V, 3), millimetres, of identity and expression weights: eq. (10)."""
        weights = np.outer(w_id, w_exp).reshape(-1).astype(np.float32)
        rows = self._rows_that_matter(weights)
        out = np.zeros(self._rows.shape[1], dtype=np.float32)
        _combine(self._rows, rows, weights, out)  # in one thread: starting another costs as much as it saves
        return out.reshape(-1, 3)

    def _rows_that_matter(self, weights: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return the rows to add up, so that the rest is below the tolerance."""
        square = (weights * self._rms) ** 2
        order = np.argsort(square)
        total = np.cumsum(square[order])
        share = 1.0
        while share > 0.05:
            # a first guess as if the rows were uncorrelated; what they really add together is then measured
            n_left_out = int(np.searchsorted(total, (share * self.tolerance_mm) ** 2, side="right"))
            probe = np.zeros(self._probe_rows.shape[1], dtype=np.float32)
            _combine(self._probe_rows, np.sort(order[:n_left_out]), weights, probe)
            left = float(np.sqrt(probe @ probe))
            if left <= self.tolerance_mm:
                return np.sort(order[n_left_out:])
            share *= 0.9 * self.tolerance_mm / left
        return np.arange(len(weights))


@njit(cache=True, fastmath=True)
def _combine(core, rows, weights, out):  # type: ignore[no-untyped-def]
    whole = 4 * (rows.size // 4)
    for k in range(0, whole, 4):  # four rows for each pass over the sum
        w0, w1, w2, w3 = weights[rows[k]], weights[rows[k + 1]], weights[rows[k + 2]], weights[rows[k + 3]]
        row0, row1, row2, row3 = core[rows[k]], core[rows[k + 1]], core[rows[k + 2]], core[rows[k + 3]]
        for j in range(out.size):
            out[j] += w0 * row0[j] + w1 * row1[j] + w2 * row2[j] + w3 * row3[j]
    for k in range(whole, rows.size):
        w = weights[rows[k]]
        row = core[rows[k]]
        for j in range(out.size):
            out[j] += w * row[j]
