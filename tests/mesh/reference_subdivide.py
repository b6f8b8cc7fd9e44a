"""Catmull-Clark by its definition, one vertex at a time; numpy only."""

import numpy as np


def catmull_clark(points, faces):
    """One step without creases: points ordered as old vertices, edges (sorted), faces."""
    faces = [[v for v in face if v >= 0] for face in faces]
    edges = sorted({tuple(sorted(pair)) for face in faces for pair in zip(face, face[1:] + face[:1])})
    users = {edge: [] for edge in edges}
    for k, face in enumerate(faces):
        for pair in zip(face, face[1:] + face[:1]):
            users[tuple(sorted(pair))].append(k)
    centre = [np.mean([points[v] for v in face], axis=0) for face in faces]
    middle = {edge: 0.5 * (points[edge[0]] + points[edge[1]]) for edge in edges}
    on_edge = [
        middle[e]
        if len(users[e]) == 1
        else np.mean([points[e[0]], points[e[1]], *(centre[k] for k in users[e])], axis=0)
        for e in edges
    ]
    moved = []
    for v, p in enumerate(points):
        at = [e for e in edges if v in e]
        border = [e for e in at if len(users[e]) == 1]
        if border:
            moved.append(0.5 * p + 0.25 * (middle[border[0]] + middle[border[1]]))
            continue
        n = len(at)
        Q = np.mean([centre[k] for k, face in enumerate(faces) if v in face], axis=0)
        R = np.mean([middle[e] for e in at], axis=0)
        moved.append((Q + 2 * R + (n - 3) * p) / n)
    return np.array(moved + on_edge + centre)
