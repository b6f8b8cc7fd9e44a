"""Obvious loops over triangles; NumPy only."""

import math

import numpy as np


def cotangent_laplacian(vertices, faces):
    L = np.zeros((len(vertices), len(vertices)))
    for triangle in faces:
        for k in range(3):
            i, j, o = triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]
            a, b = vertices[i] - vertices[o], vertices[j] - vertices[o]
            weight = 0.5 * (a @ b) / np.linalg.norm(np.cross(a, b))
            L[i, j] -= weight
            L[j, i] -= weight
            L[i, i] += weight
            L[j, j] += weight
    return L


def frame(a, b, c):
    n = np.cross(b - a, c - a)
    return np.stack([b - a, c - a, n / math.sqrt(np.linalg.norm(n))], axis=1)


def closest_on_triangle(p, a, b, c):
    """Nearest of: foot in the plane if inside, feet on the three sides."""
    candidates = []
    for s, e in ((a, b), (b, c), (c, a)):
        length = (e - s) @ (e - s)
        t = min(max((p - s) @ (e - s) / length, 0.0), 1.0) if length > 0 else 0.0
        candidates.append(s + t * (e - s))
    M = np.stack([b - a, c - a], axis=1)
    if np.linalg.matrix_rank(M) == 2:
        v, w = np.linalg.lstsq(M, p - a, rcond=None)[0]
        if v >= 0 and w >= 0 and v + w <= 1:
            candidates.append(a + M @ [v, w])
    return min(candidates, key=lambda q: np.linalg.norm(q - p))


def shortest_paths(graph, source):
    """Bellman-Ford on a dense matrix, zero meaning no edge."""
    n = len(graph)
    distance = np.full(n, np.inf)
    distance[source] = 0.0
    for _ in range(n):
        for i in range(n):
            for j in range(n):
                if graph[i, j] > 0:
                    distance[j] = min(distance[j], distance[i] + graph[i, j])
    return distance
