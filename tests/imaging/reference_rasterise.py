"""Obvious loops that the z-buffer must equal; imports numpy only."""

import numpy as np


def rasterise_naively(pixels, depth, faces, size, perspective):
    height, width = size
    face_index = np.full((height, width), -1)
    barycentric = np.zeros((height, width, 3))
    nearest = np.full((height, width), np.inf)
    for y in range(height):
        for x in range(width):
            for f, (a, b, c) in enumerate(faces):
                z3 = depth[[a, b, c]]
                if perspective and (z3 <= 0).any():
                    continue
                system = np.vstack([pixels[[a, b, c]].T, np.ones(3)])
                if abs(np.linalg.det(system)) < 1e-12:
                    continue
                weights = np.linalg.solve(system, [x, y, 1.0])
                if (weights < -1e-9).any():
                    continue
                if perspective:
                    weights = weights / z3
                    z = 1 / weights.sum()
                    weights = weights * z
                else:
                    z = weights @ z3
                if z < nearest[y, x]:
                    nearest[y, x], face_index[y, x], barycentric[y, x] = z, f, weights
    return face_index, barycentric, nearest
