"""Blendshape rig: a neutral face and named displacements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ShapeError, ValueRangeError
from facewright.numeric.check import check_choice, check_finite, check_shape


@dataclass(frozen=True, eq=False)
class BlendshapeRig:
    """One person's face as neutral + sum_i beta_i delta_i.

    Parameters
    ----------
    neutral : ndarray of shape (V, 3), float32, millimetres
        B_0.
    names : tuple of str
        Names of the B shapes, without the neutral.
    deltas : ndarray of shape (B, V, 3), float32, millimetres
        B_i - B_0: displacement of each shape at weight one.

    Examples
    --------
    >>> rig = BlendshapeRig(np.zeros((2, 3)), ("jawOpen",), np.ones((1, 2, 3)))
    >>> rig.pose(np.array([0.5])).tolist()
    [[0.5, 0.5, 0.5], [0.5, 0.5, 0.5]]
    """

    neutral: NDArray[np.float32]
    names: tuple[str, ...]
    deltas: NDArray[np.float32]

    def __post_init__(self) -> None:
        sizes = check_shape("neutral", self.neutral, "V", 3)
        check_shape("deltas", self.deltas, len(self.names), "V", 3, **sizes)
        if len(set(self.names)) != len(self.names):
            raise ValueRangeError("names must be unique, got a name more than once.")

    def pose(self, weights: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the face at `weights` (B,), or one for each row of weights (T, B); (V, 3) or (T, V, 3), mm.

        FaceWarehouse 4.1: V = B_0 + sum_i beta_i (B_i - B_0). Weights are not clipped to [0, 1].
        """
        beta = np.asarray(weights, dtype=np.float32)
        B = len(self.names)
        if beta.ndim not in (1, 2) or beta.shape[-1] != B:
            raise ShapeError(f"weights must have shape ({B},) or (T, {B}), got {beta.shape}.")
        check_finite("weights", beta)
        offset = beta @ self.deltas.reshape(B, -1)
        return self.neutral + offset.reshape(*beta.shape[:-1], *self.neutral.shape)

    def shape(self, name: str) -> NDArray[np.float32]:
        """Return the face (V, 3) with shape `name` at weight one: B_i."""
        check_choice("name", name, self.names)
        return self.neutral + self.deltas[self.names.index(name)]
