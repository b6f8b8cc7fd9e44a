"""Bind a character to a region-based model: which weights move skin, teeth, tongue and lashes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from facewright.errors import ShapeError
from facewright.faces.character_contacts import character_seals, lid_clearance
from facewright.faces.face import Face
from facewright.faces.pieces import FOLLOW_MM, FacePieces, face_pieces
from facewright.faces.rigid_motion import RigidMotion
from facewright.mesh.geodesics import path_graph
from facewright.models.dense_drive import CharacterWeights, JawFollowers
from facewright.models.dense_weights import SurfacePlaces, learned_weights, smooth_weights
from facewright.models.region_model import RegionModel
from facewright.numeric.check import check_shape

Progress = Callable[[str, int, int], None]

_MOVES_MM = 0.05  # a vertex that no blendshape moves further is still,
_NEAR_MM = 15.0  # unless it lies so near the model's face;
_FAR_MM = 90.0  # and so far away everything is
_RINGS = 2  # neighbours of a point that tell how the face around it is turned and how large it is
_SIZES = 0.5, 2.0
_JAW_SHARE = 0.3  # points that jawOpen moves by this share of its most tell how the jaw stands
_ARM_MM = 70.0  # from the jaw's joint to the chin, about
_LEAN_TRUST = 0.02  # ridge of what the jaw adds to the skin
_LEAN_MM = 0.1
_FOLLOWED = 16  # points of the skin that a loose vertex looks at
_ALIKE_MM = 1.0
_SHARE_LEAST = 1e-3
_JAW_TRUST = 0.02  # ridge of the jaw's regression, as a share of its mean square


def bind_character(
    model: RegionModel, character: Face, places: SurfacePlaces, progress: Progress | None = None
) -> CharacterWeights:
    """Return the weights by which a model drives a character, all parts.

    The skin follows the model's vertices at their places on it by smooth local weights, which are then adapted so that
    the character's own blendshapes come out as they are. Lower teeth and whatever goes with them turn with the jaw, as
    the displacements around the chin tell; upper teeth and eyeballs stay with the skull. Loose parts (lashes, gums)
    follow the skin next to them.

    Parameters
    ----------
    model : RegionModel
    character : Face
        Its mean shape is the character's neutral, its blendshapes the character's own.
    places : SurfacePlaces
        Where the model's N vertices lie on the character; `facewright.faces.character_places`.
    progress : callable, optional

    Raises
    ------
    ShapeError
        If there is not one place for each vertex of the model.
    """
    N = model.n_vertices
    if len(places.corners) != N:
        raise ShapeError(f"places must be one for each of the model's {N} vertices, got {len(places.corners)}.")
    report = progress or (lambda *_: None)
    report("binding the character", 0, 4)
    pieces = face_pieces(character)
    rest = character.mean_shape.astype(np.float64)
    shapes = character.blendshape_deltas
    coarse = places.of(shapes)
    follow = smooth_weights(rest, pieces.surface_faces, places, _still(character, pieces, places))
    report("binding the character", 1, 4)
    follow = _with_loose(follow, character, pieces)
    jaw, with_jaw = _jaw(character, pieces, coarse, follow)
    report("binding the character", 2, 4)
    follow = sparse.diags(1.0 - jaw.shares) @ follow
    follow = _without(follow, np.concatenate([np.zeros(0, np.intp), *(piece.vertices for piece in pieces.rigid)]))
    follow = learned_weights(follow, coarse, shapes - with_jaw)
    jaw = _with_skin(jaw, character, coarse, shapes - follow_displacements(follow, coarse))
    report("binding the character", 3, 4)
    turns = local_turns(model.neutral, places.of(rest), model.faces)
    report("binding the character", 4, 4)
    return CharacterWeights(
        character.mean_shape.astype(np.float32),
        follow.tocsr(),
        turns,
        jaw,
        character_seals(character),
        lid_clearance(character),
    )


def local_turns(
    source: NDArray[np.floating], target: NDArray[np.floating], faces: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return (N, 3, 3): rotation and size that carry the surroundings of each vertex from one face to another.

    Least squares similarity of the two rings around a vertex, `source` and `target` (N, 3), mm, of one mesh.
    """
    N = check_shape("source", source, "N", 3)["N"]
    check_shape("target", target, N, 3)
    a, b = np.asarray(source, np.float64), np.asarray(target, np.float64)
    rows, columns = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    once = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(N, N))
    once = ((once + once.T) > 0).astype(np.float64)
    near = sum((once**k for k in range(1, _RINGS + 1)), start=sparse.identity(N, format="csr"))
    near = (near > 0).astype(np.float64).tocoo()
    i, k = near.row, near.col
    arms_a, arms_b = a[k] - a[i], b[k] - b[i]
    H = np.zeros((N, 3, 3))
    np.add.at(H, i, np.einsum("na,nb->nab", arms_b, arms_a))
    size_a, size_b = (np.bincount(i, (arms**2).sum(axis=1), minlength=N) for arms in (arms_a, arms_b))
    U, _, Vt = np.linalg.svd(H)
    U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    sizes = np.clip(np.sqrt(size_b / np.maximum(size_a, 1e-12)), *_SIZES)
    sizes[size_a == 0] = 1.0
    return (U @ Vt) * sizes[:, None, None]


def _still(character: Face, pieces: FacePieces, places: SurfacePlaces) -> NDArray[np.intp]:
    """Return vertices that the model does not reach: no blendshape moves them, or they are far away."""
    graph = path_graph(character.mean_shape, pieces.surface_faces)
    nearest = np.unique(places.corners[np.arange(len(places.corners)), places.barycentric.argmax(axis=1)])
    away = dijkstra(graph, directed=False, indices=nearest, min_only=True)
    moves = np.linalg.norm(character.blendshape_deltas, axis=2).max(axis=0, initial=0.0)
    return np.flatnonzero(((moves < _MOVES_MM) & (away > _NEAR_MM)) | (away > _FAR_MM))


def _with_loose(follow: sparse.csr_matrix, character: Face, pieces: FacePieces) -> sparse.csr_matrix:
    """Let loose geometry follow the surface near it, those points of it that blendshapes move alike."""
    loose, rest = pieces.loose, character.mean_shape.astype(np.float64)
    if not len(loose):
        return follow
    surface = np.arange(len(rest))[pieces.surface]
    away, ids = cKDTree(rest[surface]).query(rest[loose], k=_FOLLOWED)
    shapes = character.blendshape_deltas.transpose(1, 0, 2).reshape(len(rest), -1)
    unlike = np.stack([((shapes[loose] - shapes[surface[ids[:, k]]]) ** 2).sum(axis=1) for k in range(_FOLLOWED)], 1)
    unlike = unlike - unlike.min(axis=1, keepdims=True)
    weights = np.exp(-0.5 * (away / FOLLOW_MM) ** 2 - 0.5 * unlike / _ALIKE_MM**2)
    weights *= np.exp(-0.5 * (away[:, :1] / FOLLOW_MM) ** 2) / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    rows = np.repeat(loose, _FOLLOWED)
    nearby = sparse.csr_matrix((weights.ravel(), (rows, surface[ids].ravel())), shape=(len(rest), len(rest)))
    return (follow + nearby @ follow).tocsr()


def _without(follow: sparse.csr_matrix, vertices: NDArray[np.intp]) -> sparse.csr_matrix:
    keep = np.ones(follow.shape[0])
    keep[vertices] = 0.0
    result = (sparse.diags(keep) @ follow).tocsr()
    result.eliminate_zeros()
    return result


def _jaw(
    character: Face, pieces: FacePieces, coarse: NDArray[np.float64], follow: sparse.csr_matrix
) -> tuple[JawFollowers, NDArray[np.float64]]:
    """Return what follows the jaw, and what it moves (B, V, 3), mm, in each blendshape."""
    V, names = character.topology.n_vertices, character.blendshape_names
    kinds = list(character.rigid_parts.values())
    if "jaw" not in kinds or "jawOpen" not in names:
        return JawFollowers.none(V), np.zeros((len(names), 1, 1))
    piece = pieces.rigid[kinds.index("jaw")]
    opened = np.linalg.norm(coarse[names.index("jawOpen")], axis=1)
    points = np.flatnonzero(opened > _JAW_SHARE * opened.max())
    rest = character.mean_shape.astype(np.float64)
    centre = rest[piece.vertices].mean(axis=0)
    arm = float(np.linalg.norm(rest[piece.vertices] - centre, axis=1).mean())
    wanted = np.concatenate([piece.rotations * arm, piece.translations], axis=1)  # (B, 6), mm
    known = coarse[:, points].reshape(len(names), -1)
    gram = known @ known.T
    gram[np.diag_indices_from(gram)] += _JAW_TRUST * np.diag(gram).mean()
    matrix = np.linalg.solve(gram, wanted).T @ known
    matrix[:3] /= arm
    # Inside the mouth each vertex goes partly with the jaw and for the rest with the skin, as the blendshapes tell.
    inside = np.setdiff1d(np.arange(character.n_skin, V), np.concatenate([one.vertices for one in pieces.rigid]))
    carried = _rigid_displacements(piece, rest, centre)
    with_skin = follow_displacements(follow[inside], coarse)
    own = character.blendshape_deltas[:, inside] - with_skin
    other = carried[:, inside] - with_skin
    shares = np.zeros(V)
    shares[inside] = np.clip(
        np.einsum("bvc,bvc->v", own, other) / np.maximum(np.einsum("bvc,bvc->v", other, other), 1e-9), 0.0, 1.0
    )
    shares[shares < _SHARE_LEAST] = 0.0
    shares[piece.vertices] = 1.0
    ids = np.zeros(0, np.intp)
    return JawFollowers(points, matrix, centre, shares, ids, np.zeros((0, 3, 6))), shares[:, None] * carried


def follow_displacements(follow: sparse.csr_matrix, coarse: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return how far vertices go (B, V, 3), mm, that follow points displaced by `coarse` (B, N, 3)."""
    B, N = coarse.shape[:2]
    moved = follow @ np.asarray(coarse, np.float64).transpose(1, 0, 2).reshape(N, -1)
    return np.asarray(moved).reshape(-1, B, 3).transpose(1, 0, 2)


def _with_skin(
    jaw: JawFollowers, character: Face, coarse: NDArray[np.float64], missing: NDArray[np.float64]
) -> JawFollowers:
    """Let the jaw add to the skin what weights leave out: they cannot turn a motion, as it turns under the chin."""
    if not jaw.points.size:
        return jaw
    motions = coarse[:, jaw.points].reshape(len(coarse), -1) @ jaw.matrix.T  # (B, 6)
    scale = np.array([_ARM_MM] * 3 + [1.0] * 3)  # rotations as millimetres at the chin
    gram = (motions * scale).T @ (motions * scale)
    gram[np.diag_indices_from(gram)] += _LEAN_TRUST * np.trace(gram) / len(gram)
    missing = missing[:, : character.n_skin]
    lean = np.einsum("ab,bvc->vca", np.linalg.solve(gram, (motions * scale).T), missing) * scale
    size = np.linalg.norm(np.einsum("vca,ba->bvc", lean, motions), axis=2).max(axis=0)
    lean *= np.clip(size / _LEAN_MM - 1.0, 0.0, 1.0)[:, None, None]  # smoothly none where it is next to nothing
    ids = np.flatnonzero(size > _LEAN_MM)
    return replace(jaw, skin_ids=ids, skin_lean=lean[ids])


def _rigid_displacements(
    piece: RigidMotion, rest: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (B, V, 3): where each blendshape's jaw motion would take everything."""
    from scipy.spatial.transform import Rotation

    arms = rest - centre
    turned = np.einsum("bij,vj->bvi", Rotation.from_rotvec(piece.rotations).as_matrix(), arms)
    return turned - arms + piece.translations[:, None]
