"""Obvious loops that the fast face code is compared with; numpy only."""

import numpy as np


def nearest_rings(polygons, loop, n_vertices):
    """Rings of polygon edges from the loop, by growing a set."""
    neighbours = [set() for _ in range(n_vertices)]
    for polygon in polygons:
        ids = [int(v) for v in polygon if v >= 0]
        for a, b in zip(ids, ids[1:] + ids[:1]):
            neighbours[a].add(b)
            neighbours[b].add(a)
    ring = np.full(n_vertices, np.inf)
    front, distance = set(map(int, loop)), 0
    while front:
        for v in front:
            ring[v] = distance
        front = {w for v in front for w in neighbours[v] if not np.isfinite(ring[w])}
        distance += 1
    return ring


def pose(neutral, deltas, weights):
    """Neutral plus weighted displacements, one shape at a time."""
    result = np.array(neutral, dtype=np.float64)
    for weight, delta in zip(weights, deltas):
        result += weight * delta
    return result


def mutual_pairs(points, upper, lower, limit):
    """Pairs that are each other's nearest within the limit."""
    pairs = set()
    for u in upper:
        distances = [np.linalg.norm(points[u] - points[v]) for v in lower]
        v = lower[int(np.argmin(distances))]
        back = [np.linalg.norm(points[v] - points[w]) for w in upper]
        if upper[int(np.argmin(back))] == u and min(distances) <= limit:
            pairs.add((int(u), int(v)))
    return pairs
