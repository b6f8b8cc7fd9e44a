"""Lips and lids that the capture shows closed stay closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from facewright.faces.face import Face
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.scheme import load_scheme

#: A pair is closed where its offset is this near to that of closed lips or lids, free from the second length on; mm.
_CLOSED_MM, _FREE_MM = 1.5, 3.0
#: Generic lids that close leave a gap (1 mm on ICT-FaceKit), of which real ones leave this share.
_LID_REMAINDER = 0.3
#: The same for the landmarks of upper and lower lip or lid.
_LANDMARK_CLOSED_MM, _LANDMARK_FREE_MM = 2.5, 5.0
#: Landmarks that face each other across the opening, by part: their distance tells whether it is closed.
_FACING = {
    "lips": [
        ("upper_lip_inner_right", "lower_lip_inner_right"),
        ("upper_lip_inner_centre", "lower_lip_inner_centre"),
        ("upper_lip_inner_left", "lower_lip_inner_left"),
    ],
    "lids_left": [("left_upper_lid_middle", "left_lower_lid_middle")],
    "lids_right": [("right_upper_lid_middle", "right_lower_lid_middle")],
}
_MASKS = {
    "lips": ("lip_contact_upper", "lip_contact_lower"),
    "lids_left": ("lid_contact_upper_left", "lid_contact_lower_left"),
    "lids_right": ("lid_contact_upper_right", "lid_contact_lower_right"),
}


@dataclass(frozen=True, eq=False)
class ContactTerm:
    """Springs between vertices that touch: sum_k w_k |(x_u - x_l) - offset_k|^2.

    Parameters
    ----------
    matrix : scipy.sparse matrix of shape (V, V)
        Weighted Laplacian of the pairs.
    rhs : ndarray of shape (V, 3)
        Its right-hand side.
    closed_share : float
        Mean weight of the pairs, 0 to 1.
    """

    matrix: sparse.csr_matrix
    rhs: NDArray[np.float64]
    closed_share: float


class ContactPairs:
    """The pairs of a face that may touch, and what the generic blendshapes do to them.

    Parameters
    ----------
    face : Face
        With ``lip_contact_*`` and ``lid_contact_*`` masks, or some of them.
    """

    def __init__(self, face: Face) -> None:
        masks, scheme = face.topology.masks, load_scheme("fw74")
        mean, deltas = face.mean_shape.astype(np.float64), face.blendshape_deltas
        self.n_vertices = face.topology.n_vertices
        self.pairs: dict[str, tuple[NDArray[np.intp], NDArray[np.intp]]] = {}
        self._rest: dict[str, NDArray[np.float64]] = {}
        self._moved: dict[str, NDArray[np.float64]] = {}
        self._facing: dict[str, NDArray[np.intp]] = {}
        for part, names in _MASKS.items():
            upper, lower = (masks.get(name, np.empty(0)).astype(np.intp) for name in names)
            if not len(upper) or len(upper) != len(lower):
                continue
            self.pairs[part] = (upper, lower)
            self._rest[part] = mean[upper] - mean[lower]
            self._moved[part] = deltas[:, upper].astype(np.float64) - deltas[:, lower]
            self._facing[part] = np.array([[scheme.index(a), scheme.index(b)] for a, b in _FACING[part]])

    def gaps(self, part: str, vertices: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the distances (K,) within the pairs of ``"lips"``, ``"lids_left"`` or ``"lids_right"``, mm."""
        upper, lower = self.pairs[part]
        return np.linalg.norm(vertices[upper].astype(np.float64) - vertices[lower], axis=1)

    def term(
        self,
        weights: NDArray[np.float64] | None,
        target: ScanTarget,
        rotation: NDArray[np.float64],
        stiffness: float,
    ) -> ContactTerm:
        """Return springs for the pairs that both landmarks and blendshape weights say are closed.

        Parameters
        ----------
        weights : ndarray of shape (46,) or None
            Blendshape weights found in stage 1; None at rest.
        target : ScanTarget
            Whose landmarks show how far the openings are open; without them the weights decide.
        rotation : ndarray of shape (3, 3)
            Of the head, target_from_model.
        stiffness : float
            Weight of a pair that is surely closed.
        """
        V = self.n_vertices
        rows, columns, values = [], [], []
        rhs, shares = np.zeros((V, 3)), [np.empty(0)]
        for part, (upper, lower) in self.pairs.items():
            offsets = self._rest[part]
            if weights is not None:
                offsets = offsets + np.tensordot(weights, self._moved[part], 1)
            # lips touch in the mean already, with offsets that are not quite zero; lids do when they have closed
            opened = offsets - self._rest[part] if part == "lips" else offsets
            closed = _fade(np.linalg.norm(opened, axis=1), _CLOSED_MM, _FREE_MM) * self._seen_closed(part, target)
            if part != "lips":
                offsets = _LID_REMAINDER * offsets
            w = stiffness * closed
            rows += [upper, lower, upper, lower]
            columns += [upper, lower, lower, upper]
            values += [w, w, -w, -w]
            pull = w[:, None] * (offsets @ rotation.T)
            np.add.at(rhs, upper, pull)
            np.add.at(rhs, lower, -pull)
            shares.append(closed)
        matrix = sparse.csr_matrix((V, V))
        if rows:
            entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
            matrix = sparse.csr_matrix(entries, shape=(V, V))
        share = np.concatenate(shares)
        return ContactTerm(matrix, rhs, float(share.mean()) if len(share) else 0.0)

    def _seen_closed(self, part: str, target: ScanTarget) -> float:
        """Return 1 where the landmarks show the opening closed, 0 where open; 1 where they do not tell."""
        gaps = []
        for a, b in self._facing[part]:
            gap = np.linalg.norm(target.landmarks[a] - target.landmarks[b])
            if not np.isfinite(gap) and target.contour_pixels is not None and target.intrinsics is not None:
                depth = float(np.median(target.points[:, 2]))
                pixels = np.linalg.norm(target.contour_pixels[a] - target.contour_pixels[b])
                gap = pixels * depth / target.intrinsics.focal_y
            if np.isfinite(gap) and min(target.confidence[a], target.confidence[b]) > 0:
                gaps.append(gap)
        return float(_fade(np.median(gaps), _LANDMARK_CLOSED_MM, _LANDMARK_FREE_MM)) if gaps else 1.0


def _fade(value: NDArray | float, start: float, end: float) -> NDArray[np.float64]:
    """Return 1 up to `start` and 0 from `end`, linear between them."""
    return np.clip((end - np.asarray(value, dtype=np.float64)) / (end - start), 0.0, 1.0)
