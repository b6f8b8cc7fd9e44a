"""Where every dense point lies on the measured model, and the cage that best reproduces any field measured there."""

from __future__ import annotations

import itertools

import numpy as np
from builtin_cage import EYE, MOUTH, Cage
from builtin_surface import MeasuredSurface
from scipy import sparse
from scipy.spatial import cKDTree

from facewright.faces.builtin_mesh import edge_ids
from facewright.mesh.subdivide import subdivide_catmull_clark

SMOOTHNESS = 0.5  # of the deviation from the points where the cage starts, against one dense point
MIRROR_X = np.array([-1.0, 1.0, 1.0])


class Measurement:
    """Correspondence of the twice subdivided cage with the measured model, and the least-squares solver."""

    def __init__(self, cage: Cage, data: dict):
        self.cage, self.data = cage, data
        self.surface = MeasuredSurface(data)
        n = self.n = len(cage.names)
        self.first = subdivide_catmull_clark(cage.faces, n)
        self.n_first = self.first.matrix.shape[0]
        self.second = subdivide_catmull_clark(self.first.faces, self.n_first)
        self.S = (self.second.matrix @ self.first.matrix).tocsr()
        self.start, self.cage_uv = self._start_positions()
        patch = np.array(cage.patch)
        self.in_cavity = patch == "cavity"
        self.is_skin = np.zeros(self.S.shape[0], bool)
        quads = self.second.faces
        parents = self.first.parents[self.second.parents]
        self.is_skin[quads[~self.in_cavity[parents]].ravel()] = True
        self.quads, self.parents = quads, parents
        self.W = self._correspond(quads, parents)
        self._prepare_solver()

    # -- geometry of the cage -----------------------------------------------------------------------------------
    def _start_positions(self) -> tuple[np.ndarray, np.ndarray]:
        cage = self.cage
        points, uv = np.zeros((self.n, 3)), np.full((self.n, 2), np.nan)
        for k, name in enumerate(cage.names):
            mirrored = name[0] == "~"
            place = cage.places[name.lstrip("~")]
            if place[0] in ("A", "B"):
                xy = np.array([place[1:]], float)
                triangle, weights, _ = self.surface.by_uv(place[0], xy)
                p = self.surface.at(triangle, weights)[0]
                if place[0] == "A":
                    uv[k] = [1000 - xy[0, 0], xy[0, 1]] if mirrored else xy[0]
            elif place[0] == "ray":
                p = self.surface.by_ray(place[1], place[2])
            else:
                p = np.array(place[1:])
            points[k] = p * MIRROR_X if mirrored else p
        points[cage.mirror == np.arange(self.n), 0] = 0.0
        return points, uv

    def dense_path(self, names: list[str], closed: bool = False) -> np.ndarray:
        """Return the dense vertices along a chain of cage vertices (names; mirrored ones begin with ~)."""
        ids = [self.cage.index(x) for x in names]
        pairs = list(zip(ids, ids[1:] + (ids[:1] if closed else [])))
        path: list[int] = []
        for a, b in pairs if closed else pairs[: len(ids) - 1]:
            m = self.n + int(_edge(self.first.edges, self.n, a, b))
            e1 = self.n_first + int(_edge(self.second.edges, self.n_first, a, m))
            e2 = self.n_first + int(_edge(self.second.edges, self.n_first, m, b))
            path += [a, e1, m, e2]
        return np.array(path if closed else [*path, ids[-1]])

    def mirrored(self, name: str) -> str:
        return self.cage.names[self.cage.mirror[self.cage.index(name)]]

    # -- correspondence -------------------------------------------------------------------------------------------
    def _correspond(self, quads: np.ndarray, parents: np.ndarray) -> sparse.csr_matrix:
        cage, surface = self.cage, self.surface
        ring = ["M0" + k for k in MOUTH]
        other = [self.mirrored(x) for x in ring]
        creases = [[cage.index(a), cage.index(b)] for r in (ring, other) for a, b in itertools.pairwise(r)]
        flat = subdivide_catmull_clark(cage.faces, self.n, levels=2, creases=creases).matrix
        known = np.isfinite(self.cage_uv[:, 0])
        by_uv = self.is_skin & (np.asarray(abs(flat) @ (~known).astype(float)).ravel() == 0)
        uv = flat @ np.where(known[:, None], self.cage_uv, 0.0)
        # rims of eyes and mouth lie exactly on the measured rims
        for names in ([f"R0{k}" for k in EYE], ["~R0" + k for k in EYE], ring, other):
            path = self.dense_path(names, closed=names[0].lstrip("~")[:2] == "R0")
            uv[path] = self._snap_to_rim(uv[path])
        self.uv = uv
        triangle = np.zeros(len(uv), np.int64)
        weights = np.tile([1.0, 0.0, 0.0], (len(uv), 1))
        ids = np.flatnonzero(by_uv)
        triangle[ids], weights[ids], outside = surface.by_uv("A", uv[ids])
        rest = np.setdiff1d(np.flatnonzero(self.is_skin), ids[outside > -0.25])
        dense = self.S @ self.start
        normals = _vertex_normals(dense, quads[~self.in_cavity[parents]])
        triangle[rest], weights[rest] = surface.closest(dense[rest], normals[rest])
        self.triangle, self.weights = triangle, weights
        return surface.matrix(triangle, weights)

    def relax(self, cage_points: np.ndarray) -> None:
        """Let points of smooth regions slide: move them to the closest point of the fitted surface.

        Points of lips, lids, nostrils and ears keep their texture coordinates, which hold the features in place.
        """
        held = np.isin(
            np.array(self.cage.patch)[self.parents],
            ["eye", "lip", "inner_lip", "nostril", "nostril_floor", "ear", "cavity"],
        )
        free = self.is_skin.copy()
        free[self.quads[held].ravel()] = False
        ids = np.flatnonzero(free)
        dense = self.S @ cage_points
        normals = _vertex_normals(dense, self.quads[~self.in_cavity[self.parents]])
        self.triangle[ids], self.weights[ids] = self.surface.closest(dense[ids], normals[ids])
        self.W = self.surface.matrix(self.triangle, self.weights)

    def _snap_to_rim(self, points: np.ndarray) -> np.ndarray:
        rows, flat, _ = self.surface.sheets["A"]
        tri = self.surface.triangles[rows]
        ends = np.sort(np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]]), axis=1)
        where = np.concatenate([flat[:, [0, 1]], flat[:, [1, 2]], flat[:, [2, 0]]])
        _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
        segments = where[first[count == 1]]
        a, ab = segments[:, 0], segments[:, 1] - segments[:, 0]
        t = np.einsum("psc,sc->ps", points[:, None] - a, ab) / np.maximum((ab**2).sum(axis=1), 1e-12)
        foot = a + np.clip(t, 0, 1)[..., None] * ab
        best = np.linalg.norm(foot - points[:, None], axis=-1).argmin(axis=1)
        return foot[np.arange(len(points)), best]

    # -- least squares --------------------------------------------------------------------------------------------
    def _prepare_solver(self) -> None:
        cage = self.cage
        self.upper_lip = self._across([f"M1{k}" for k in MOUTH[:6]])
        self.lower_lip = self._across([f"M1{k}" for k in [*MOUTH[:5:-1], "C"]])
        self.upper_lid = self.dense_path([f"R1E{k}" for k in range(7)])
        self.lower_lid = self.dense_path(["R1E0", *(f"R1E{k}" for k in range(11, 5, -1))])
        self.cavity_cage = np.array([k for k, n in enumerate(cage.names) if n.lstrip("~")[:2] == "V1"])
        edges = self.first.edges
        n = self.n
        adjacency = sparse.csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (n, n))
        adjacency = adjacency + adjacency.T
        degree = np.asarray(adjacency.sum(axis=1)).ravel()
        self.L = sparse.identity(n) - sparse.diags(1 / degree) @ adjacency
        # points deep in the nostrils say little about the rest; rims count more
        weight = self.is_skin.astype(float)
        deep = np.setdiff1d(
            self.quads[np.array(cage.patch)[self.parents] == "nostril_floor"],
            self.quads[np.array(cage.patch)[self.parents] != "nostril_floor"],
        )
        weight[deep] = 0.3
        self.rows = sparse.diags(weight) @ self.S
        self.weight = weight
        pins = sparse.csr_matrix(
            (np.ones(len(self.cavity_cage)), (np.arange(len(self.cavity_cage)), self.cavity_cage)),
            (len(self.cavity_cage), n),
        )
        self.pins = pins
        self.normal = (self.rows.T @ self.rows + pins.T @ pins + SMOOTHNESS * self.L.T @ self.L).toarray()

    def _across(self, half: list[str]) -> np.ndarray:
        """Return a chain from the right end over the midline (first name) to the left end."""
        left = self.dense_path(half)
        right = self.dense_path([self.mirrored(x) for x in half])
        return np.concatenate([right[:0:-1], left])

    def solve(self, field: np.ndarray, cavity: np.ndarray, start: np.ndarray, ties=(), extra=None) -> np.ndarray:
        """Fit cage values to a field at the dense points (weighted, zero off the skin).

        `ties`: (rows of S difference, right-hand side) held with a large weight; `extra`: (dense ids, values, weight).
        """
        rhs = (
            self.rows.T @ (self.weight[:, None] * field)
            + self.pins.T @ cavity
            + SMOOTHNESS * self.L.T @ (self.L @ start)
        )
        normal = self.normal.copy()
        for matrix, value in ties:
            normal += 1e7 * (matrix.T @ matrix).toarray()
            rhs = rhs + 1e7 * (matrix.T @ value)
        if extra is not None:
            ids, values, weight = extra
            rows = self.S[ids]
            normal += weight * (rows.T @ rows).toarray()
            rhs = rhs + weight * (rows.T @ values)
        return np.linalg.solve(normal, rhs)

    def measure(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Read a field of the measured model: at the dense skin points and at the cavity's cage vertices."""
        start, stop = dict(zip(self.data["part_names"], self.data["part_ranges"]))["mouth_socket"]
        tree = cKDTree(self.data["vertices"][start:stop])
        distance, near = tree.query(self.start[self.cavity_cage], k=6)
        weights = 1 / (distance + 1.0)
        weights /= weights.sum(axis=1, keepdims=True)
        cavity = np.einsum("nk,nkc->nc", weights, field[start:stop][near].astype(float))
        return self.W @ field.astype(float) * self.is_skin[:, None], cavity

    def beside_lips(self, inwards: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the dense vertices next to the contact line, above and below it, one step in or out."""
        patch = np.array(self.cage.patch)[self.parents]
        quads = self.quads[patch == ("inner_lip" if inwards else "lip")]
        a, b = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
        n = self.S.shape[0]
        adjacency = sparse.csr_matrix((np.ones(len(a)), (a, b)), (n, n))
        adjacency = (adjacency + adjacency.T).tocsr()
        line = set(self.upper_lip) | set(self.lower_lip)
        out = []
        for path in (self.upper_lip[1:-1], self.lower_lip[1:-1]):
            near = [[v for v in adjacency[p].indices if v not in line] for p in path]
            out.append(np.array([v[0] for v in near]))
        return out[0], out[1]

    def difference(self, a: np.ndarray, b: np.ndarray) -> sparse.csr_matrix:
        return (self.S[a] - self.S[b]).tocsr()


def _edge(edges: np.ndarray, n: int, a: int, b: int) -> int:
    quad = np.array([[a, b, a, b]])
    row = int(edge_ids(quad, edges, n)[0, 0])
    if tuple(edges[row]) != (min(a, b), max(a, b)):
        raise ValueError(f"cage vertices {a} and {b} are not joined")
    return row


def _vertex_normals(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    a, b, c, d = (points[quads[:, k]] for k in range(4))
    face = np.cross(c - a, d - b)
    normals = np.zeros_like(points)
    for k in range(4):
        np.add.at(normals, quads[:, k], face)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
