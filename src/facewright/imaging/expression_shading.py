"""What another expression does to the light on the skin: cheeks shaded anew, folds of a smile that come and go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from facewright.faces.face import Face
from facewright.imaging.colour import linear_from_srgb
from facewright.imaging.inner_parts import SIDES, rigid_motion
from facewright.imaging.lid_skin import unit_normals
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.photo_light import PhotoLight, harmonics
from facewright.imaging.rasterise import rasterise
from facewright.imaging.wide_blur import wide_blur
from facewright.mesh.connectivity import vertex_adjacency

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: Shading changes at most by this in logarithm, and this share of what the meshes say, which know no fine folds.
_MOST, _SHARE = 0.22, 0.8
_ROUNDS = 8  # of smoothing over the mesh
#: Changes of light below this are not drawn, for they cannot be seen.
_LEAST = 0.012
#: So far from lips and lids, mm, the change begins and is whole.
_AWAY_MM = (1.0, 6.0)
#: Nasolabial folds: from the wing of the nose past the corner of the mouth, mm from these landmarks of the right side.
_WING, _CORNER, _SIDE_CORNER = 47, 54, 60
_FOLD_WIDTH_MM = 9.0
#: Blurs, mm, between which wrinkles lie, and how much of a fold a removed smile takes away.
_FINE_MM, _WIDE_MM, _REMOVED = 0.3, 6.0, 0.85
#: Logarithm of the light: the deepest fold, and what is not more than pores and grain.
_DEEPEST, _PORES = 3.0, 0.07


@dataclass(frozen=True, eq=False)
class ExpressionShading:
    """How the light on a photo's skin follows the expression.

    Parameters
    ----------
    folds : ndarray of shape (h, w, 3), float32
        Logarithm of the photo's linear light in smile folds against their surroundings.
    origin : tuple of int
        Column and row of the photo at its first pixel.
    """

    folds: NDArray[np.float32]
    origin: tuple[int, int]
    _faces: NDArray[np.int32]
    _vertices: NDArray[np.intp]
    _zone: NDArray[np.float64]
    _fold_zone: NDArray[np.float64]  # (2, M), right and left
    _smooth: sparse.csr_matrix
    _then: NDArray[np.float64]  # (M, 3) in the camera's axes
    _lit: NDArray[np.float64]  # (M,) luminance in the photo
    _pixels: NDArray[np.float64]
    _corners: NDArray[np.intp]
    _smile: NDArray[np.float64]  # (2, 3) what a smile does to the corners, in the camera's axes
    _luminance: NDArray[np.float64]  # (9,)

    @classmethod
    def of(cls, photo: NDArray[np.uint8], source: MeshView, face: Face, light: PhotoLight) -> ExpressionShading:
        """Prepare a photo whose fitted mesh is `source`, all parts of `face`."""
        topology, n = face.topology, face.n_skin
        region = np.zeros(topology.n_vertices, bool)
        region[topology.masks["face_region"]] = True
        region[n:] = False
        chosen = topology.faces[region[topology.faces].all(axis=1)]
        vertices = np.unique(chosen)
        faces = np.searchsorted(vertices, chosen).astype(np.int32)
        mean = face.mean_shape[vertices].astype(np.float64)
        zone = _zone(face, vertices, faces, mean)
        fold_zone = _fold_zone(face, mean) * zone
        adjacency = vertex_adjacency(faces, len(vertices)).astype(np.float64)
        degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
        smooth = (sparse.diags(0.5 / degree) @ adjacency + sparse.diags(np.full(len(vertices), 0.5))).tocsr()
        pixels, seen = source.pixels[vertices], source.camera_vertices[vertices]
        corners = topology.landmarks["fw74"][[_CORNER, _SIDE_CORNER]]
        head, _ = rigid_motion(face.mean_shape[vertices].astype(np.float64), seen)
        smiles = [face.blendshape_deltas[face.blendshape_names.index(f"mouthSmile_{s[0].upper()}")] for s in SIDES]
        smile = np.stack([head @ np.asarray(s[c], np.float64) for s, c in zip(smiles, corners, strict=True)])
        luminance = light.terms @ _LUMINANCE
        folds, origin = _folds(photo, pixels, source.depth[vertices], faces, fold_zone.max(axis=0), source.perspective)
        places = np.searchsorted(vertices, corners)
        return cls(
            folds, origin, faces, vertices, zone, fold_zone, smooth, seen,
            _lit(seen, faces, luminance), pixels, places, smile, luminance,
        )  # fmt: skip

    def paint(
        self, image: NDArray[np.uint8], marks: NDArray[np.bool_], target: MeshView, head: NDArray[np.floating]
    ) -> None:
        """Change the light on the skin of the warped photo, in place.

        Parameters
        ----------
        image : ndarray of shape (H, W, 3), uint8
            The photo warped to `target`.
        marks : ndarray of shape (H, W), bool
            Set where pixels were changed.
        target : MeshView
            The wanted view, all parts.
        head : ndarray of shape (3, 3)
            Rotation of the head from the photo to the view: it is not the head's turn that is lit anew.
        """
        seen = target.camera_vertices[self._vertices]
        back = seen @ head  # as the photo's head stands
        less = self._smiles_removed(back)
        gain = self._relit(back)
        fold = np.tensordot(_REMOVED * less, self._fold_zone, 1)
        active = (np.abs(gain) > _LEAST) | (fold > _LEAST)
        if not active.any():
            return
        values = np.column_stack([self._pixels, _beyond(gain, _LEAST), fold]).astype(np.float32)
        pixels = target.pixels[self._vertices]
        low = np.maximum(np.floor(pixels[active].min(axis=0)).astype(int) - 2, 0)
        high = np.minimum(np.ceil(pixels[active].max(axis=0)).astype(int) + 3, image.shape[1::-1])
        if (high <= low).any():
            return
        depth = target.depth[self._vertices]
        size = (int(high[1] - low[1] + 1) // 2, int(high[0] - low[0] + 1) // 2)
        # the light changes slowly: one sample for 2 x 2 pixels
        at = (pixels - low + 0.5) / 2 - 0.5
        found = rasterise(at, depth, self._faces, size, perspective=target.perspective)
        _shade(
            image, marks, int(low[0]), int(low[1]), found.face_index, found.barycentric, self._faces, values,
            self.folds, float(self.origin[0]), float(self.origin[1]),
        )  # fmt: skip

    def _smiles_removed(self, back: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how much of a smile went away on either side, (2,) in [0, 1]."""
        moved = back - self._then
        # against the cheeks' middle motion: the head may have moved
        still = np.median(moved[self._zone > 0.9], axis=0) if (self._zone > 0.9).any() else np.zeros(3)
        step = moved[self._corners] - still
        amount = -(step * self._smile).sum(axis=1) / np.maximum((self._smile**2).sum(axis=1), 1e-9)
        return np.asarray(np.clip((amount - 0.08) / 0.4, 0.0, 1.0))

    def _relit(self, back: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the logarithm of the change of light at the vertices, (M,)."""
        ratio = np.log(_lit(back, self._faces, self._luminance) / self._lit)
        for _ in range(_ROUNDS):
            ratio = self._smooth @ ratio
        return np.asarray(self._zone * _MOST * np.tanh(_SHARE * ratio / _MOST))


def _beyond(values: NDArray[np.floating], least: float) -> NDArray[np.float64]:
    """Let what is within `least` of 0 be 0, without a step."""
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - least, 0.0))


def _lit(seen: NDArray[np.float64], faces: NDArray[np.int32], luminance: NDArray[np.float64]) -> NDArray[np.float64]:
    normals = unit_normals(np.ascontiguousarray(seen), faces)
    return np.asarray(np.maximum(harmonics(normals) @ luminance, 0.15 * abs(luminance[0])))


def _zone(face: Face, vertices: NDArray[np.intp], faces: NDArray[np.int32], mean: NDArray[np.float64]) -> NDArray:
    """Return where skin may be lit anew, (M,): away from lips, lids, nostrils and the border of the face."""
    masks = face.topology.masks
    names = [name for name in masks if name.startswith(("lips", "eyelid", "lash_line", "nostril", "brow"))]
    apart = np.unique(np.concatenate([masks[name] for name in names]))
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    lines, counts = np.unique(edges, axis=0, return_counts=True)
    border = np.concatenate([mean[np.unique(lines[counts == 1])], face.mean_shape[apart].astype(np.float64)])
    away = cKDTree(border).query(mean)[0]
    t = np.clip((away - _AWAY_MM[0]) / (_AWAY_MM[1] - _AWAY_MM[0]), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _fold_zone(face: Face, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the folds of a smile lie, right and left, (2, M) in [0, 1]."""
    points = face.mean_shape[face.topology.landmarks["fw74"]].astype(np.float64)
    wing, corner = points[_WING, :2], points[_CORNER, :2]
    between = 0.5 * (wing + corner)
    line = np.array([
        wing + (-1.0, 11.0), wing + (-2.5, 4.0), between + (-7.0, 4.0), corner + (-9.0, 5.0), corner + (-10.0, -6.0),
        corner + (-8.0, -18.0),
    ])  # fmt: skip
    t = np.linspace(0, len(line) - 1, 60)
    dense = np.column_stack([np.interp(t, np.arange(len(line)), line[:, k]) for k in range(2)])
    zones = []
    for side in (1.0, -1.0):
        away = cKDTree(dense * (side, 1.0)).query(mean[:, :2])[0]
        zones.append(np.clip(1.5 * np.exp(-((away / _FOLD_WIDTH_MM) ** 2)), 0, 1) * (mean[:, 2] > 60.0))
    return np.stack(zones)


def _folds(
    photo: NDArray[np.uint8],
    pixels: NDArray[np.float64],
    depth: NDArray[np.float64],
    faces: NDArray[np.int32],
    zone: NDArray[np.float64],
    perspective: bool,
) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Return the wrinkles of a photo where folds may be, (h, w, 3) in logarithm, and where the first pixel is."""
    shown = pixels[zone > 0.01]
    edges = np.linalg.norm(pixels[faces[:, 0]] - pixels[faces[:, 1]], axis=1)
    if len(shown) == 0 or not np.isfinite(edges).all():
        return np.zeros((1, 1, 3), np.float32), (0, 0)
    scale = float(np.linalg.norm(shown.max(axis=0) - shown.min(axis=0))) / 105.0  # both zones' diagonal, mm
    margin = 2.0 * _WIDE_MM * scale + 3
    low = np.clip(np.floor(shown.min(axis=0) - margin), 0, photo.shape[1::-1]).astype(int)
    high = np.clip(np.ceil(shown.max(axis=0) + margin), 0, photo.shape[1::-1]).astype(int)
    if (high - low < 4).any():
        return np.zeros((1, 1, 3), np.float32), (0, 0)
    size = (int(high[1] - low[1]), int(high[0] - low[0]))
    part = rasterise(pixels - low, depth, faces, size, perspective=perspective)
    wide_zone = np.clip(4.0 * zone, 0, 1)[:, None].astype(np.float32)
    known = part.interpolate(faces, wide_zone)[..., 0] * part.covered  # lips, nostrils and beyond tell nothing
    linear = linear_from_srgb(photo[low[1] : high[1], low[0] : high[0]].astype(np.float32) / 255.0)
    light = np.log(linear + 0.006)  # channel by channel: folds are redder than what is beside them

    def blurred(sigma: float) -> NDArray[np.float32]:
        mass = wide_blur(known, sigma)
        return np.asarray(wide_blur(light * known[..., None], sigma) / np.maximum(mass, 1e-3)[..., None], np.float32)

    fine, wide = blurred(max(0.4, _FINE_MM * scale)), blurred(_WIDE_MM * scale)
    # the skin beside a fold tells how light it would be without: dark lines count, the cheeks' own form does not
    folds = np.clip(_beyond(fine - wide, _PORES), -_DEEPEST, 0.1) * np.clip(known, 0, 1)[..., None]
    return np.ascontiguousarray(folds, np.float32), (int(low[0]), int(low[1]))


@njit(cache=True, nogil=True)
def _shade(image, marks, x0, y0, face_index, barycentric, faces, values, folds, origin_x, origin_y):  # type: ignore[no-untyped-def]
    """Multiply the light of the pixels that see the skin; one sample for 2 x 2 of them.

    `values` (M, 4): place in the photo, gain, share of folds.
    """
    height, width = face_index.shape
    rows, columns = folds.shape[:2]
    for py in range(height):
        for px in range(width):
            f = face_index[py, px]
            if f < 0:
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            u, v, w = barycentric[py, px, 0], barycentric[py, px, 1], barycentric[py, px, 2]
            gain = u * values[a, 2] + v * values[b, 2] + w * values[c, 2]
            share = u * values[a, 3] + v * values[b, 3] + w * values[c, 3]
            if abs(gain) < 1e-4 and share < 0.004:
                continue
            x = u * values[a, 0] + v * values[b, 0] + w * values[c, 0] - origin_x - 0.5
            y = u * values[a, 1] + v * values[b, 1] + w * values[c, 1] - origin_y - 0.5
            folded = share >= 0.004 and 0 <= x < columns - 2 and 0 <= y < rows - 2
            i, j = (int(x), int(y)) if folded else (0, 0)
            s, t = x - i, y - j
            same = np.exp(gain / 2.2)  # sRGB values go with about the 2.2nd root of light
            for iy in range(y0 + 2 * py, min(y0 + 2 * py + 2, image.shape[0])):
                for ix in range(x0 + 2 * px, min(x0 + 2 * px + 2, image.shape[1])):
                    for k in range(3):
                        factor = same
                        if folded:
                            m, n = j + (iy - y0) % 2, i + (ix - x0) % 2
                            fold = (1 - t) * ((1 - s) * folds[m, n, k] + s * folds[m, n + 1, k])
                            fold += t * ((1 - s) * folds[m + 1, n, k] + s * folds[m + 1, n + 1, k])
                            factor = np.exp((gain - share * fold) / 2.2)
                        image[iy, ix, k] = np.uint8(min(image[iy, ix, k] * factor + 0.5, 255.0))
                    marks[iy, ix] = True
