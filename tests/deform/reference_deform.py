"""Deformation transfer and rigging by the book: dense matrices, loops over triangles; NumPy only."""

import math

import numpy as np


def frame(a, b, c):
    n = np.cross(b - a, c - a)
    return np.stack([b - a, c - a, n / math.sqrt(np.linalg.norm(n))], axis=1)


def transfer_with_fourth_vertices(source, deformed, target, faces, weights):
    """Sumner and Popovic as printed: unknown vertices and fourth vertices, one dense least-squares system."""
    V, F = len(target), len(faces)
    rows, right = [], []
    for j, t in enumerate(faces):
        Q = frame(*deformed[t]) @ np.linalg.inv(frame(*source[t]))
        inverse = np.linalg.inv(frame(*target[t]))
        for k in range(3):  # column k of T = [x2 - x1, x3 - x1, x4 - x1] V^-1
            row = np.zeros(V + F)
            row[t[1]] += inverse[0, k]
            row[t[2]] += inverse[1, k]
            row[V + j] += inverse[2, k]
            row[t[0]] -= inverse[:, k].sum()
            rows.append(math.sqrt(weights[j]) * row)
            right.append(math.sqrt(weights[j]) * Q[:, k])
    return np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0][:V]


def rig_gradients(pose_gradients, weights, prior_gradients, penalties, beta):
    """Li et al. per triangle with a B x B system: (A'A + beta W) M = A'S + beta W M*."""
    F, B, C = prior_gradients.shape
    result = np.zeros((F, B, C))
    for f in range(F):
        W = beta * np.diag(penalties[f])
        left = weights.T @ weights + W
        result[f] = np.linalg.solve(left, weights.T @ pose_gradients[f] + W @ prior_gradients[f])
    return result
