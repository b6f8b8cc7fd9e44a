"""A small mesh in three regions, a model of it, and the paper's equations written out row by row."""

import numpy as np

from facewright.models.region_pca import fit_region_pca
from facewright.models.regions import Regions

ROWS, COLUMNS = 5, 9
N = ROWS * COLUMNS


def grid_faces():
    grid = np.arange(N, dtype=np.int32).reshape(ROWS, COLUMNS)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel(), grid[1:, 1:].ravel(), grid[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def grid_regions():
    """Columns 0-3 and 3-8, of which rows 2-4 are a region of their own: some vertices lie in three."""
    grid = np.arange(N).reshape(ROWS, COLUMNS)
    left, upper, lower = grid[:, :4], grid[:3, 3:], grid[2:, 3:]
    return Regions(N, tuple(np.sort(part.ravel()).astype(np.int32) for part in (left, upper, lower)), ("l", "u", "d"))


def grid_neutral():
    y, x = np.mgrid[0.0:ROWS, 0.0:COLUMNS]
    return np.stack([10 * x, -10 * y, 0.3 * x * y], -1).reshape(N, 3)


def smooth_motion(rng, frames):
    """Displacements (frames, N, 3) that vary smoothly over the mesh."""
    places = grid_neutral()[:, :2] / 50
    waves = rng.normal(size=(12, 2))
    basis = np.cos(places @ waves.T + rng.uniform(0, 6, 12))
    return np.einsum("tkc,nk->tnc", rng.normal(size=(frames, 12, 3)), basis)


def small_model(rng, components=5, centred=False, regions=None):
    return fit_region_pca(
        smooth_motion(rng, 60), grid_faces(), grid_neutral(), regions or grid_regions(), components, centred=centred
    )


def matrix(model, i):
    """B^i as (3 N_i, P_i)."""
    return model.bases[i].reshape(len(model.bases[i]), -1).T


def pair_rows(model, i, j):
    """B_j^i, B_i^j and the difference of the means at the shared vertices."""
    a, b = (model.regions.members[k].tolist() for k in (i, j))
    shared = sorted(set(a) & set(b))
    rows_i = [3 * a.index(v) + c for v in shared for c in range(3)]
    rows_j = [3 * b.index(v) + c for v in shared for c in range(3)]
    apart = model.means[i].ravel()[rows_i] - model.means[j].ravel()[rows_j]
    return matrix(model, i)[rows_i], matrix(model, j)[rows_j], apart


def boundary_block_rows(model, beta):
    """The rows of sqrt(beta) (B_j^i c^i - B_i^j c^j), every pair once, and their right-hand side."""
    offsets, rows, right = model.offsets, [], []
    for i in range(len(model.bases)):
        for j in range(i + 1, len(model.bases)):
            own, other, apart = pair_rows(model, i, j)
            block = np.zeros((len(own), model.n_coefficients))
            block[:, offsets[i] : offsets[i + 1]] = own
            block[:, offsets[j] : offsets[j + 1]] = -other
            rows.append(np.sqrt(beta) * block)
            right.append(-np.sqrt(beta) * apart)
    return np.concatenate(rows), np.concatenate(right)


def naive_fit(model, displacement, beta, present=None):
    """Eq. 6 as one least squares problem."""
    offsets, rows, right = model.offsets, [], []
    for i, ids in enumerate(model.regions.members):
        for k, v in enumerate(ids):
            if present is not None and not present[v]:
                continue
            for c in range(3):
                row = np.zeros(model.n_coefficients)
                row[offsets[i] : offsets[i + 1]] = model.bases[i][:, k, c]
                rows.append(row)
                right.append(displacement[v, c] - model.means[i][k, c])
    more, more_right = boundary_block_rows(model, beta)
    return np.linalg.lstsq(np.vstack([rows, more]), np.concatenate([right, more_right]), rcond=None)[0]


def naive_gradient(model, displacement, beta):
    """Eq. 7 as a block system, its misprints mended, for a model without means."""
    offsets, M = model.offsets, len(model.bases)
    H, g = np.zeros((model.n_coefficients,) * 2), np.zeros(model.n_coefficients)
    for i in range(M):
        here = slice(offsets[i], offsets[i + 1])
        B = matrix(model, i)
        H[here, here] += B.T @ B
        g[here] += B.T @ displacement[model.regions.members[i]].ravel()
        for j in range(M):
            if j != i:
                own, other, _ = pair_rows(model, i, j)
                H[here, here] += beta * own.T @ own
                H[here, offsets[j] : offsets[j + 1]] -= beta * own.T @ other
    return np.linalg.solve(H, g)


def naive_pose(model, vertices, targets, rest, beta, gamma, weights=None):
    """Eq. 9 as one least squares problem."""
    offsets, rows, right = model.offsets, [], []
    for k, v in enumerate(vertices):
        w = 1.0 if weights is None else np.sqrt(weights[k])
        for i, ids in enumerate(model.regions.members):
            if v in ids:
                local = ids.tolist().index(v)
                for c in range(3):
                    row = np.zeros(model.n_coefficients)
                    row[offsets[i] : offsets[i + 1]] = w * model.bases[i][:, local, c]
                    rows.append(row)
                    right.append(w * (targets[k][c] - model.neutral[v, c] - model.means[i][local, c]))
    more, more_right = boundary_block_rows(model, beta)
    units = np.sqrt(gamma) * np.concatenate(model.units)
    return np.linalg.lstsq(
        np.vstack([*rows, more, np.diag(units)]), np.concatenate([right, more_right, units * rest]), rcond=None
    )[0]


def naive_average(model, zeta):
    """Average the copies of every vertex, one by one."""
    result, count = np.zeros((model.n_vertices, 3)), np.zeros(model.n_vertices)
    for i, ids in enumerate(model.regions.members):
        c = zeta[model.offsets[i] : model.offsets[i + 1]]
        for k, v in enumerate(ids):
            result[v] += model.means[i][k] + sum(c[p] * model.bases[i][p, k] for p in range(len(c)))
            count[v] += 1
    return result / count[:, None]
