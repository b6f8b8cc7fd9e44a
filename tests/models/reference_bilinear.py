"""Obvious versions of the bilinear model's mathematics; NumPy only."""

import numpy as np


def nmode_svd_full(tensor, n_identity, n_expression):
    """Truncated N-mode SVD (not sequential) by SVDs of the unfoldings of (N, S, V, 3), in double."""
    T = np.asarray(tensor, dtype=np.float64)
    N, S = T.shape[:2]
    u_id, s_id, _ = np.linalg.svd(T.reshape(N, -1), full_matrices=False)
    u_exp, s_exp, _ = np.linalg.svd(T.swapaxes(0, 1).reshape(S, -1), full_matrices=False)
    u_id, u_exp = u_id[:, :n_identity], u_exp[:, :n_expression]
    core = np.einsum("nsvc,ni,se->ievc", T, u_id, u_exp)
    return core, u_id, u_exp, s_id, s_exp


def contract(core_vcie, w_id, w_exp):
    """Eq. (10) on a core (V, 3, I, E) by loops over components."""
    face = np.zeros(core_vcie.shape[:2])
    for i in range(len(w_id)):
        for e in range(len(w_exp)):
            face += core_vcie[:, :, i, e].astype(float) * w_id[i] * w_exp[e]
    return face


def project_by_alternation(core_vcie, target, w_id, w_exp, rounds):
    """Alternating least squares by dense lstsq; the face after each round."""
    core = core_vcie.astype(float)
    x = target.reshape(-1).astype(float)
    errors = []
    for _ in range(rounds):
        a = (core @ w_exp).reshape(len(x), -1)
        w_id = np.linalg.lstsq(a, x, rcond=None)[0]
        b = (core.swapaxes(2, 3) @ w_id).reshape(len(x), -1)
        w_exp = np.linalg.lstsq(b, x, rcond=None)[0]
        errors.append(np.sqrt(((b @ w_exp - x) ** 2).sum() / len(target)))
    return w_id, w_exp, errors
