"""Inner loop that draws skin from its mirror image."""

from __future__ import annotations

import numpy as np
from numba import njit

from facewright.imaging.resample import _cubic, _neighbours, _sample


@njit(cache=True, nogil=True)
def paint_mirrored(  # type: ignore[no-untyped-def]
    image, touched, photo, face_index, barycentric, origin, faces, near, weights, attributes, share
):
    """Blend the photo's colours at mirrored places into `image`, see `MirroredSkin.paint`.

    `weights` (V, 2) for pixels of the person and of what lies behind, told by `share` (h, w) uint8, or (1, 1) for
    everywhere; `attributes` (V, 5): pixel of the mirror image, ratios of red, green, blue. Half as much at the pixels
    of the silhouette.
    """
    same = share.size == 1
    rows, cols = face_index.shape
    height, width, _ = photo.shape
    zero, half, white = np.float32(0), np.float32(0.5), np.float32(255)
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    for y in range(rows):
        for x in range(cols):
            f = face_index[y, x]
            if f < 0 or not near[f]:
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            p, q, r = barycentric[y, x, 0], barycentric[y, x, 1], barycentric[y, x, 2]
            w = p * weights[a, 0] + q * weights[b, 0] + r * weights[c, 0]
            if not same:
                person = np.float32(share[y, x]) / white
                if person < np.float32(1):
                    over = p * weights[a, 1] + q * weights[b, 1] + r * weights[c, 1]
                    w += (np.float32(1) - person) * (over - w)
            if w <= np.float32(0.004):
                continue
            covered = 0
            for k in range(-1, 2):
                for m in range(-1, 2):
                    if 0 <= y + k < rows and 0 <= x + m < cols:
                        g = face_index[y + k, x + m]
                        covered += 1 if g >= 0 else 0
            w *= min(max(np.float32(covered - 3) / np.float32(6), zero), np.float32(1))
            px = p * attributes[a, 0] + q * attributes[b, 0] + r * attributes[c, 0]
            py = p * attributes[a, 1] + q * attributes[b, 1] + r * attributes[c, 1]
            x0, x1, x2, x3, tx = _neighbours(np.float32(min(max(px, zero), right)), width)
            y0, y1, y2, y3, ty = _neighbours(np.float32(min(max(py, zero), bottom)), height)
            u, v = _cubic(tx), _cubic(ty)
            touched[y + origin[1], x + origin[0]] = True
            for k in range(3):
                ratio = p * attributes[a, 2 + k] + q * attributes[b, 2 + k] + r * attributes[c, 2 + k]
                level = ratio * _sample(photo, x0, x1, x2, x3, y0, y1, y2, y3, u, v, np.uint64(k))
                level = min(max(level, zero), white)
                was = np.float32(image[y + origin[1], x + origin[0], k])
                image[y + origin[1], x + origin[0], k] = np.int32(was + w * (level - was) + half)
