"""Numba kernels of `ClosestPoints`: a bounding volume hierarchy over triangles."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def build_tree(boxes, centres, order, leaf_size):  # type: ignore[no-untyped-def]
    """Sort `order` and return node boxes (M, 6) and ranges (M, 3): start, stop, right child (0 for a leaf).

    Children of node m: m + 1 and ranges[m, 2]. Split at the median centre of the longest side.
    """
    F = order.shape[0]
    capacity = 2 * max(F, 1)
    nodes = np.zeros((capacity, 6))
    ranges = np.zeros((capacity, 3), np.int64)
    stack = np.zeros((128, 3), np.int64)  # start, stop, parent whose right child this is, or -1
    top, count = 1, 0
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, F, -1
    while top > 0:
        top -= 1
        start, stop, parent = stack[top, 0], stack[top, 1], stack[top, 2]
        m = count
        count += 1
        if parent >= 0:
            ranges[parent, 2] = m
        ranges[m, 0], ranges[m, 1] = start, stop
        for k in range(3):
            low, high = np.inf, -np.inf
            for p in range(start, stop):
                low = min(low, boxes[order[p], k])
                high = max(high, boxes[order[p], 3 + k])
            nodes[m, k], nodes[m, 3 + k] = low, high
        if stop - start <= leaf_size:
            continue
        axis, best = 0, -1.0
        for k in range(3):
            low, high = np.inf, -np.inf
            for p in range(start, stop):
                low = min(low, centres[order[p], k])
                high = max(high, centres[order[p], k])
            if high - low > best:
                axis, best = k, high - low
        part = order[start:stop].copy()
        keys = np.zeros(stop - start)
        for p in range(stop - start):
            keys[p] = centres[part[p], axis]
        ranked = np.argsort(keys, kind="mergesort")
        for p in range(stop - start):
            order[start + p] = part[ranked[p]]
        middle = (start + stop) // 2
        stack[top, 0], stack[top, 1], stack[top, 2] = middle, stop, m
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = start, middle, -1
        top += 2
    return nodes[:count], ranges[:count]


@njit(cache=True, nogil=True, inline="always")
def _box_distance(nodes, m, x, y, z):  # type: ignore[no-untyped-def]
    dx = max(max(nodes[m, 0] - x, x - nodes[m, 3]), 0.0)
    dy = max(max(nodes[m, 1] - y, y - nodes[m, 4]), 0.0)
    dz = max(max(nodes[m, 2] - z, z - nodes[m, 5]), 0.0)
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def closest_on_triangle(p, a, b, c):  # type: ignore[no-untyped-def]
    """Return barycentric coordinates of the point of triangle (a, b, c) nearest to p (Ericson 2005, section 5.1.5)."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = b[k] - a[k], c[k] - a[k]
        d1 += ab * (p[k] - a[k])
        d2 += ac * (p[k] - a[k])
        d3 += ab * (p[k] - b[k])
        d4 += ac * (p[k] - b[k])
        d5 += ab * (p[k] - c[k])
        d6 += ac * (p[k] - c[k])
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 - d3 > 0.0:
        v = d1 / (d1 - d3)
        return 1.0 - v, v, 0.0
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 - d6 > 0.0:
        w = d2 / (d2 - d6)
        return 1.0 - w, 0.0, w
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0 and (d4 - d3) + (d5 - d6) > 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - w, w
    total = va + vb + vc
    if total <= 0.0:
        return 1.0, 0.0, 0.0
    return va / total, vb / total, vc / total


@njit(cache=True, nogil=True)
def query_tree(nodes, ranges, order, corners, points, faces, weights, squared):  # type: ignore[no-untyped-def]
    """Write for every point the nearest triangle, its barycentric coordinates and the squared distance.

    `squared` holds the search radius squared on entry; where nothing is nearer, the face stays as it was.
    """
    stack = np.zeros(128, np.int64)
    for n in range(points.shape[0]):
        p = points[n]
        x, y, z = p[0], p[1], p[2]
        best = squared[n]
        stack[0] = 0
        top = 1
        while top > 0:
            top -= 1
            m = stack[top]
            if _box_distance(nodes, m, x, y, z) >= best:
                continue
            if ranges[m, 2] == 0:
                for q in range(ranges[m, 0], ranges[m, 1]):
                    f = order[q]
                    a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
                    u, v, w = closest_on_triangle(p, a, b, c)
                    d = 0.0
                    for k in range(3):
                        e = u * a[k] + v * b[k] + w * c[k] - p[k]
                        d += e * e
                    if d < best:
                        best = d
                        faces[n] = f
                        weights[n, 0], weights[n, 1], weights[n, 2] = u, v, w
                continue
            left, right = m + 1, ranges[m, 2]
            if _box_distance(nodes, left, x, y, z) < _box_distance(nodes, right, x, y, z):
                left, right = right, left
            stack[top], stack[top + 1] = left, right  # the nearer one is taken first
            top += 2
        squared[n] = best
