"""Deformation transfer: carry the deformation of one mesh to another of the same topology."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.errors import ValueRangeError
from facewright.mesh.connectivity import vertex_components
from facewright.mesh.triangle_frames import degenerate_triangles, inverse_frames, triangle_frames
from facewright.numeric.check import check_choice, check_finite, check_indices, check_shape
from facewright.numeric.sparse_solve import SymmetricSolver
from facewright.numeric.threads import for_blocks

_POSE_BLOCK = 4  # poses that a thread takes at once
_STILL_MM = 0.1  # source vertices that move less than about this hold their component in place


class DeformationTransfer:
    r"""Carry poses of a source mesh to a target mesh, with the target's matrix factored once.

    Minimises :math:`\sum_j w_j \|Q_j - T_j\|_F^2` over the target's vertices, Q_j being the deformation gradient of
    triangle j in the source and T_j in the target [1]_ (EE 4.1, FW 3.2.2). The fourth vertex of each target triangle
    occurs in one term only and is eliminated there, which leaves one V x V matrix with three right-hand sides for a
    pose; the unknown is the displacement, so that a source at rest gives the target at rest to the last digits.

    The energy does not see translations. Each connected component gets the one that lets the vertices which hold
    still in the source hold still in the target: weights 1 / (\|d\|^2 + (0.1 mm)^2), d the source's displacement, or
    equal weights on `anchors` in components that have some.

    Parameters
    ----------
    source_neutral : ndarray of shape (V, 3), millimetres
        Source at rest.
    target_neutral : ndarray of shape (V, 3), millimetres
        Target at rest.
    faces : ndarray of shape (F, 3), int
        Triangles of both. Triangles without area in either mesh are left out.
    weighting : {"uniform", "area"}
        Weight w_j of a triangle: 1 as in the paper, or its area in the target [2]_.
    anchors : ndarray of shape (N,), int, optional
        Vertices whose mean displacement in the target is that of the source.

    Raises
    ------
    ShapeError, ValueRangeError
        If shapes differ, values are not finite, or indices are outside [0, V).

    References
    ----------
    .. [1] Sumner and Popovic, Deformation transfer for triangle meshes, SIGGRAPH 2004.
    .. [2] Botsch, Sumner, Pauly, Gross, Deformation transfer for detail-preserving surface editing, VMV 2006.

    Examples
    --------
    >>> x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> transfer = DeformationTransfer(x, 2 * x, np.array([[0, 1, 2]]))
    >>> bool(np.ptp(transfer.transfer(3 * x), axis=0)[0] > 5.99)
    True
    """

    def __init__(
        self,
        source_neutral: NDArray[np.floating[Any]],
        target_neutral: NDArray[np.floating[Any]],
        faces: NDArray[np.integer[Any]],
        *,
        weighting: str = "uniform",
        anchors: NDArray[np.integer[Any]] | None = None,
    ) -> None:
        V = check_shape("source_neutral", source_neutral, "V", 3)["V"]
        check_shape("target_neutral", target_neutral, V, 3)
        check_shape("faces", faces, "F", 3)
        check_indices("faces", faces, V)
        check_finite("source_neutral", source_neutral)
        check_finite("target_neutral", target_neutral)
        check_choice("weighting", weighting, ("uniform", "area"))
        self.source_neutral = np.array(source_neutral, dtype=np.float64)
        self.target_neutral = np.array(target_neutral, dtype=np.float64)
        source, target = (triangle_frames(x, faces) for x in (self.source_neutral, self.target_neutral))
        keep = ~(degenerate_triangles(source) | degenerate_triangles(target))
        source, target = source[keep], target[keep]
        self._faces = np.ascontiguousarray(faces[keep], dtype=np.int32)
        self._source_frames = np.ascontiguousarray(source)
        # Rows 1 and 2 of V^-1 are the gradients of the hat functions of corners 2 and 3.
        gradients = inverse_frames(target)[:, :2].transpose(0, 2, 1)
        weights = np.ones(len(target))
        if weighting == "area":
            weights = 0.5 * np.linalg.norm(np.cross(target[..., 0], target[..., 1]), axis=1)
            weights /= weights.mean() if len(weights) else 1.0
        self._carriers = np.ascontiguousarray(inverse_frames(source) @ gradients * weights[:, None, None])
        self._matrix = _gradient_matrix(self._faces, gradients, weights, V)
        labels = vertex_components(self._faces, V)
        n_components = int(labels.max(initial=-1)) + 1
        pinned = np.unique(labels, return_index=True)[1]
        # The right-hand side sums to zero in each component, so that a pin at one vertex removes the null space
        # without any other effect; the translation is added afterwards.
        self._pins = np.zeros(V)
        self._pins[pinned] = max(float(self._matrix.diagonal().mean()), 1e-12) if V else 1.0
        self._solver = SymmetricSolver(self._matrix + sparse.diags(self._pins))
        self._members = sparse.csr_matrix((np.ones(V), (labels, np.arange(V))), shape=(n_components, V))
        self._labels = labels
        self._anchored = np.full(V, -1.0)  # -1: weight by stillness
        if anchors is not None:
            check_indices("anchors", anchors, V)
            self._anchored[np.isin(labels, labels[anchors])] = 0.0
            self._anchored[anchors] = 1.0
        self._smoothers: dict[float, SymmetricSolver] = {}

    def transfer(self, source_deformed: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """Return the target in the poses of the source.

        Parameters
        ----------
        source_deformed : ndarray of shape (V, 3) or (T, V, 3), millimetres
            Poses of the source; many at once cost far less than one by one.

        Returns
        -------
        ndarray of the shape and dtype of `source_deformed`, millimetres
            Poses of the target.

        Raises
        ------
        ShapeError, ValueRangeError
            If the shape is wrong or values are not finite.
        """
        poses = self._check_poses("source_deformed", source_deformed, single=True)
        displacements = self._place(self._solver.solve(self._right_hand_side(poses)), poses)
        result = self.target_neutral + displacements
        dtype = np.asarray(source_deformed).dtype
        return result.reshape(np.shape(source_deformed)).astype(dtype if dtype.kind == "f" else np.float64)

    def sequence(self, source_frames: NDArray[np.floating[Any]], smoothness: float) -> NDArray[np.floating[Any]]:
        """Return the target in a sequence of poses, with the temporal term of EE eq. (3)-(4).

        Each frame minimises the transfer energy plus lambda ||x(t) - x(t - 1)||^2, x(t - 1) being known; one
        factorisation serves all frames.

        Parameters
        ----------
        source_frames : ndarray of shape (T, V, 3), millimetres
            Poses of the source in time order.
        smoothness : float
            lambda in units of the mean diagonal of the transfer matrix (so that it has no unit): 0 is `transfer`.

        Returns
        -------
        ndarray of the shape and dtype of `source_frames`, millimetres
            Poses of the target; compare `temporal_roughness` with and without the term.

        Raises
        ------
        ShapeError, ValueRangeError
            If the shape is wrong, values are not finite or `smoothness` is negative.
        """
        poses = self._check_poses("source_frames", source_frames, single=False)
        if not (smoothness >= 0 and np.isfinite(smoothness)):
            raise ValueRangeError(f"smoothness must not be negative, got {smoothness}.")
        if smoothness == 0 or len(poses) < 2:
            return self.transfer(source_frames)
        lam = smoothness * float(self._matrix.diagonal().mean())
        if smoothness not in self._smoothers:
            identity = sparse.identity(self._matrix.shape[0])
            self._smoothers = {smoothness: SymmetricSolver(self._matrix + lam * identity)}
        solver = self._smoothers[smoothness]
        rhs = self._right_hand_side(poses)
        X = np.zeros_like(rhs)
        X[:, 0] = self._solver.solve(rhs[:, 0])
        for t in range(1, len(poses)):  # each frame needs the one before
            X[:, t] = solver.solve(rhs[:, t] + lam * X[:, t - 1])  # EE eq. (4)
        result = self.target_neutral + self._place(X, poses)
        return result.astype(np.asarray(source_frames).dtype if source_frames.dtype.kind == "f" else np.float64)

    def _check_poses(self, name: str, poses: NDArray[Any], *, single: bool) -> NDArray[np.float64]:
        V = len(self.source_neutral)
        if single and np.ndim(poses) == 2:
            check_shape(name, poses, V, 3)
        else:
            check_shape(name, poses, "T", V, 3)
        check_finite(name, poses)
        return np.ascontiguousarray(np.asarray(poses, dtype=np.float64).reshape(-1, V, 3))

    def _right_hand_side(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return G^T w (Q - 1) of every pose, shape (V, T, 3)."""
        from facewright.deform._transfer_kernels import accumulate_transfer

        rhs = np.zeros(poses.shape)

        def accumulate_block(start: int, stop: int) -> None:
            block = poses[start:stop]
            accumulate_transfer(self._faces, self._source_frames, self._carriers, block, rhs[start:stop])

        for_blocks(len(poses), _POSE_BLOCK, accumulate_block)
        return np.ascontiguousarray(rhs.transpose(1, 0, 2))

    def _place(self, solution: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add each component's translation to solution (V, T, 3); return displacements (T, V, 3)."""
        displacements = np.zeros(poses.shape)

        def place_block(start: int, stop: int) -> None:
            moved = poses[start:stop] - self.source_neutral
            block = displacements[start:stop]
            block[:] = solution[:, start:stop].transpose(1, 0, 2)
            still = 1.0 / (np.einsum("tvx,tvx->tv", moved, moved) + _STILL_MM**2)
            weights = np.where(self._anchored < 0, still, self._anchored)
            moved -= block
            moved *= weights[:, :, None]
            for error, weight, result in zip(moved, weights, block):
                shift = (self._members @ error) / (self._members @ weight)[:, None]
                result += shift[self._labels]

        for_blocks(len(poses), _POSE_BLOCK, place_block)
        return displacements


def _gradient_matrix(
    faces: NDArray[np.int32], gradients: NDArray[np.float64], weights: NDArray[np.float64], n_vertices: int
) -> sparse.csc_matrix:
    """Return G^T W G, (V, V): the transfer energy's matrix after the fourth vertices are eliminated."""
    corners = np.concatenate([-gradients.sum(axis=2, keepdims=True), gradients], axis=2)  # (F, 3 xyz, 3 corners)
    local = np.einsum("fxa,fxb,f->fab", corners, corners, weights)
    rows, columns = np.repeat(faces, 3, axis=1).ravel(), np.tile(faces, (1, 3)).ravel()
    return sparse.csc_matrix((local.ravel(), (rows, columns)), shape=(n_vertices, n_vertices))


def transfer_deformation(
    source_neutral: NDArray[np.floating[Any]],
    source_deformed: NDArray[np.floating[Any]],
    target_neutral: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
) -> NDArray[np.floating[Any]]:
    """Carry poses (V, 3) or (T, V, 3) of a source to a target once; see `DeformationTransfer`."""
    return DeformationTransfer(source_neutral, target_neutral, faces).transfer(source_deformed)


def temporal_roughness(frames: NDArray[np.floating[Any]]) -> float:
    """Return the mean squared second difference of frames (T, V, 3), mm^2; 0 with fewer than three frames.

    Raises
    ------
    ShapeError
        If `frames` is not (T, V, 3).
    """
    check_shape("frames", frames, "T", "V", 3)
    if len(frames) < 3:
        return 0.0
    second = np.diff(np.asarray(frames, dtype=np.float64), n=2, axis=0)
    return float((second**2).sum(axis=2).mean())
