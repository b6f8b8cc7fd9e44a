"""What lies behind a person in a photo: seen beside them, in-painted where they hide it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.imaging._patch_kernels import KNOWN, UNUSED, WANTED, add_detail, match_patches, vote
from facewright.imaging.blocks import enlarge, masked_means
from facewright.imaging.inpaint import inpaint
from facewright.imaging.wide_blur import block_means

_WORK = 150  # pixels that the head has where patches are sought
_SMALLEST = 24  # and in the coarsest picture
_PATCH = 5
_ROUNDS, _SEARCHES = 4, 2  # votes a picture, two of the finest; rounds of search each
_BLOCK_ROWS = 512
_ENOUGH = 0.3  # share of a block that must be known
_DETAIL = 0.8  # pixels: finer detail is taken from one patch, not the mean of many
_FADES = 1.4  # trust falls by this per pixel from the border into the hole
_NEAR = 2500.0  # squared levels that a patch as far away as the head is large costs more
_SEED = 20_093  # of the random search: the same photo gives the same plate


def complete_background(
    part: NDArray[np.uint8], hidden: NDArray[np.bool_], person: NDArray[np.bool_], head_size: float
) -> NDArray[np.uint8]:
    """Fill what a person hides so that lines and textures go on behind them.

    From coarse to fine pictures each patch that reaches into the hole is given the patch beside the person that it
    resembles most, and the hole the mean of what its patches propose (Wexler, Shechtman, Irani 2007, "Space-time
    completion"; Barnes et al. 2009, "PatchMatch"). It begins with a membrane (`inpaint`).

    Parameters
    ----------
    part : ndarray of shape (h, w, 3), uint8
        A box of the photo.
    hidden : ndarray of shape (h, w), bool
        What is to be filled.
    person : ndarray of shape (h, w), bool
        What shows the person: nothing is taken from there.
    head_size : float
        Pixels.

    Returns
    -------
    ndarray of shape (h, w, 3), uint8
        To the bit the photo outside `hidden`.
    """
    n = max(1, round(head_size / _WORK))
    known = ~hidden & ~person
    if not known.any():
        return part.copy()
    pictures, roles = [masked_means(part, known, n)[0]], [_roles(hidden, known, n)]
    while min(head_size / n / 2 ** len(pictures), *(k / 4 for k in roles[-1].shape)) > _SMALLEST:
        usable = roles[-1] == KNOWN
        pictures.append(masked_means(pictures[-1], usable, 2)[0])
        roles.append(_roles(roles[-1] == WANTED, usable, 2))
    filled, nearest, cost = None, None, None
    for level in range(len(pictures) - 1, -1, -1):
        near = _NEAR / (head_size / n / 2**level) ** 2
        filled, nearest, cost = _complete(pictures[level], roles[level], near, filled, nearest, _ROUNDS if level else 2)
    if filled is None or nearest is None or cost is None:
        return part.copy()
    out = part.copy()
    blurred = ndimage.gaussian_filter(filled, (_DETAIL, _DETAIL, 0))
    for top in range(0, len(part), _BLOCK_ROWS):
        rows = slice(top, min(top + _BLOCK_ROWS, len(part)))
        if hidden[rows].any():
            whole = enlarge(blurred, n, part.shape[:2], rows)
            add_detail(part, blurred, roles[0], nearest, cost, n, top, whole)
            out[rows][hidden[rows]] = np.clip(np.rint(whole[hidden[rows]]), 0, 255).astype(np.uint8)
    return out


def _roles(hidden: NDArray[np.bool_], known: NDArray[np.bool_], n: int) -> NDArray[np.uint8]:
    """Return the role of each block: known where enough of it is, else wanted where any pixel is."""
    role = np.where(block_means(hidden.astype(np.float32), n) > 0, WANTED, UNUSED).astype(np.uint8)
    role[block_means(known.astype(np.float32), n) > _ENOUGH] = KNOWN
    return role


def _complete(
    picture: NDArray[np.float32],
    role: NDArray[np.uint8],
    near: float,
    coarser: NDArray[np.float32] | None,
    nearest: NDArray[np.int32] | None,
    votes: int,
) -> tuple[NDArray[np.float32], NDArray[np.int32] | None, NDArray[np.float32] | None]:
    """Complete one picture of the pyramid, from the coarser one; returns it, and each patch's source and its cost."""
    wanted = role == WANTED
    source = ndimage.minimum_filter(role == KNOWN, _PATCH, mode="constant", cval=0)
    if coarser is None:
        filled = inpaint(picture, role != KNOWN, grain=0.0)
    else:
        filled = np.where(wanted[..., None], enlarge(coarser, 2, role.shape), picture).astype(np.float32)
    if not source.any() or not wanted.any():
        return filled, None, None
    centres = ndimage.maximum_filter(wanted, _PATCH, mode="constant", cval=0) & (role != UNUSED)
    ys, xs = np.nonzero(centres)
    start = _start(nearest, source, role.shape)
    trust = (_FADES ** -ndimage.distance_transform_edt(wanted)).astype(np.float32)
    cost = np.full(role.shape, 1e30, np.float32)
    for k in range(votes):
        match_patches(filled, role, source, trust, ys, xs, start, cost, _SEARCHES, np.float32(near), _SEED + k)
        spread = np.float32(max(np.percentile(cost[centres], 90), 1.0) * 2)
        vote(filled, role, trust, start, cost, spread, filled)
    return filled, start, cost


def _start(nearest: NDArray[np.int32] | None, source: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Return first guesses of the sources: twice the coarser picture's, or the nearest places."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    back = np.moveaxis(ndimage.distance_transform_edt(~source, return_distances=False, return_indices=True), 0, -1)
    if nearest is None:
        return np.ascontiguousarray(back, dtype=np.int32)
    i, j = np.minimum(y // 2, nearest.shape[0] - 1), np.minimum(x // 2, nearest.shape[1] - 1)
    found = 2 * nearest[i, j] + np.stack([y % 2, x % 2], axis=-1)
    found = np.clip(found, 0, np.array(shape) - 1)
    good = source[found[..., 0], found[..., 1]]
    # where the coarser guess has no patch of known pixels here, the nearest place that has
    moved = back[found[..., 0], found[..., 1]]
    return np.ascontiguousarray(np.where(good[..., None], found, moved), dtype=np.int32)
