"""Bring a picture's colour and light to another's, from the pixels where both show the same surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from facewright.errors import DegenerateError, ValueRangeError
from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.poisson import mask_box
from facewright.imaging.resample import resample
from facewright.numeric.check import check_shape

#: Longer side at which colours are compared: light varies slowly, and cell means forgive small misalignments.
_CELLS = 160
_MIN_CELLS = 12
#: Largest correction of light beside the gain, as a factor.
_MAX_LIGHT = 1.8
#: Strength with which the offset is held at 0, as a share of the colours' spread that counts as no evidence for it.
_OFFSET_PRIOR = 0.15
_LUT = linear_from_srgb(np.arange(256) / 255.0)
#: sRGB bytes of linear light whose square root is k / 8191: finer than bytes everywhere.
_ENCODED = np.rint(srgb_from_linear((np.arange(8192) / 8191.0) ** 2) * 255.0).astype(np.uint8)
_ROWS = 256


@dataclass(frozen=True, eq=False)
class ColourMatch:
    """A change of colour and light, in linear light: gain x + offset, times a smooth field.

    Parameters
    ----------
    gain : ndarray of shape (3,), float64
        Factor per channel.
    offset : ndarray of shape (3,), float64
        Linear light added per channel; 1 is white.
    light : ndarray of shape (h, w, 3), float32
        Smooth factor on a coarse grid of cells of `cell` pixels.
    cell : int
        Side of a cell in pixels.
    size : (height, width)
        Size of the pictures in pixels.
    """

    gain: NDArray[np.float64]
    offset: NDArray[np.float64]
    light: NDArray[np.float32]
    cell: int
    size: tuple[int, int]

    def apply(self, image: NDArray[np.uint8], where: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
        """Return the picture (H, W, 3) with its colours changed, only where `where` (H, W) is set if it is given.

        Raises
        ------
        ShapeError, ValueRangeError
            If the picture is not uint8 of the size that was matched.
        """
        height, width = self.size
        check_shape("image", image, height, width, 3)
        _check_bytes("image", image)
        mask = np.ones(self.size, np.bool_) if where is None else np.asarray(where, dtype=np.bool_)
        check_shape("where", mask, height, width)
        out = image.copy()
        for top in range(0, height, _ROWS):  # in strips: photos may be large
            strip = slice(top, top + _ROWS)
            y, x = np.nonzero(mask[strip])
            # a cell's value belongs to its centre
            half = (self.cell - 1) / 2
            light = resample(self.light, (x - half) / self.cell, (y + top - half) / self.cell)
            linear = _LUT[image[strip][mask[strip]]] * self.gain.astype(np.float32) + self.offset.astype(np.float32)
            out[strip][mask[strip]] = _encode(linear * light)
        return out


def match_colours(
    source: NDArray[np.uint8], target: NDArray[np.uint8], where: NDArray[np.bool_], *, local: bool = True
) -> NDArray[np.uint8]:
    """Return `source` in the colours and the light of `target`; see `estimate_colour_match`."""
    return estimate_colour_match(source, target, where, local=local).apply(source)


def estimate_colour_match(
    source: NDArray[np.uint8], target: NDArray[np.uint8], where: NDArray[np.bool_], *, local: bool = True
) -> ColourMatch:
    """Find gain, offset and smooth light that bring one picture to another where both show the same surface.

    Parameters
    ----------
    source, target : ndarray of shape (H, W, 3), uint8
        Aligned sRGB pictures.
    where : ndarray of shape (H, W), bool
        Pixels where both show the same surface (skin around the mouth, say). Up to about a third of them may disagree
        (beards, wrinkles, highlights): they are found and left out.
    local : bool
        Also follow differences of light that vary over the picture.

    Returns
    -------
    ColourMatch
        Apply it to the source.

    Raises
    ------
    ShapeError, ValueRangeError
        If the pictures are not uint8 RGB of one size.
    DegenerateError
        If `where` holds too little that is neither black nor clipped.

    Notes
    -----
    Gain and offset per channel by iteratively reweighted least squares (Tukey's biweight); the offset, which is
    ill-determined where colours vary little, is held near 0. The light's logarithm is the weighted mean of the log
    ratios under a Gaussian of a fifth of the region's size, which goes to 0 far from `where`.
    """
    sizes = check_shape("source", source, "H", "W", 3)
    check_shape("target", target, "H", "W", 3, **sizes)
    check_shape("where", where, "H", "W", **sizes)
    _check_bytes("source", source)
    _check_bytes("target", target)
    mask = np.array(where, dtype=np.bool_)
    if mask.any():
        box = mask_box(mask)
        for picture in (source[box], target[box]):  # clipped pixels do not tell their light
            mask[box] &= ((picture > 1) & (picture < 254)).all(axis=2)
    cell = max(1, -(-_extent(mask) // _CELLS))
    share, ours, theirs = _cell_means(mask, source, target, cell)
    used = share > 0.25
    if int(used.sum()) < _MIN_CELLS:
        raise DegenerateError(
            f"where must hold at least {_MIN_CELLS} places that are neither black nor clipped, got {int(used.sum())}."
        )
    gain, offset = np.ones(3), np.zeros(3)
    weights = np.zeros((int(used.sum()), 3))
    for c in range(3):
        gain[c], offset[c], weights[:, c] = _fit_line(ours[used][:, c], theirs[used][:, c], share[used])
    light = np.ones(ours.shape, np.float32)
    if local:
        changed = np.maximum(ours * gain + offset, 1e-3)
        ratio = np.log(np.maximum(theirs, 1e-3) / changed)
        certain = np.zeros_like(ratio)
        certain[used] = weights.min(axis=1, keepdims=True) * share[used][:, None]
        light = _smooth_light(ratio, certain, _extent(mask) / cell)
    return ColourMatch(gain, offset, light, cell, (sizes["H"], sizes["W"]))


def _encode(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Encode linear light as sRGB bytes, by table."""
    return np.asarray(_ENCODED[(np.sqrt(np.clip(linear, 0.0, 1.0)) * 8191.0 + 0.5).astype(np.int32)])


def _extent(mask: NDArray[np.bool_]) -> int:
    """Return the longer side of the mask's bounding box, at least 1."""
    sides = [np.flatnonzero(mask.any(axis=axis)) for axis in (0, 1)]
    return max([int(s[-1] - s[0]) + 1 for s in sides if s.size], default=1)


def _cell_means(
    mask: NDArray[np.bool_], source: NDArray[np.uint8], target: NDArray[np.uint8], cell: int
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return per cell the share of pixels that the mask holds, and both pictures' linear means over them."""
    cells = tuple(-(-n // cell) for n in mask.shape)
    share, ours, theirs = np.zeros(cells), np.zeros((*cells, 3)), np.zeros((*cells, 3))
    if not mask.any():
        return share, ours, theirs
    # only the cells that the mask touches are decoded: photos may be large
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) // cell for axis in (1, 0))
    grid = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    box = tuple(slice(s.start * cell, s.stop * cell) for s in grid)
    padding = [(0, (s.stop - s.start) * cell - n) for s, n in zip(grid, mask[box].shape)]
    weight = np.pad(mask[box], padding).astype(np.float32)
    shape = (weight.shape[0] // cell, cell, weight.shape[1] // cell, cell)
    share[grid] = weight.reshape(shape).mean(axis=(1, 3))
    for picture, means in ((source, ours), (target, theirs)):
        padded = np.pad(_LUT[picture[box]], [*padding, (0, 0)]) * weight[..., None]
        total = padded.reshape(*shape, 3).mean(axis=(1, 3), dtype=np.float64)
        means[grid] = total / np.maximum(share[grid], 1e-6)[..., None]
    return share, ours, theirs


def _fit_line(
    x: NDArray[np.floating], y: NDArray[np.floating], share: NDArray[np.floating]
) -> tuple[float, float, NDArray[np.float64]]:
    """Fit y = gain x + offset robustly; returns both and the points' weights."""
    gain, offset = float(np.median(y / np.maximum(x, 1e-4))), 0.0
    spread = _OFFSET_PRIOR * float(np.median(x))
    for _ in range(20):
        apart = y - gain * x - offset
        scale = 1.4826 * float(np.median(np.abs(apart))) + 1e-4
        weight = np.clip(1.0 - (apart / (4.685 * scale)) ** 2, 0.0, None) ** 2 * share
        total = weight.sum()
        mean_x, mean_y = weight @ x / total, weight @ y / total
        variance = weight @ (x - mean_x) ** 2 / total
        covariance = weight @ ((x - mean_x) * (y - mean_y)) / total
        deviation = float(np.sqrt(variance * (weight @ (y - mean_y) ** 2 / total)))
        likeness = max(float(covariance) / max(deviation, 1e-12), 0.0)
        # ridge on the offset: between the reduced major axis, whose slope misalignment does not flatten, and the line
        # through 0, which is right where the pictures' textures have little in common
        ratio = float(mean_y / max(mean_x, 1e-4))
        slope = float(np.clip(deviation / max(float(variance), 1e-12), 0.5 * ratio, 2.0 * ratio))
        trust = likeness**4 * float(variance / (variance + spread**2))
        gain = trust * slope + (1.0 - trust) * ratio
        gain = min(max(gain, 0.05), 20.0)
        offset = float(mean_y - gain * mean_x)
    return gain, offset, np.asarray(weight / np.maximum(share, 1e-6), dtype=np.float64)


def _smooth_light(ratio: NDArray[np.float64], certain: NDArray[np.float64], extent_cells: float) -> NDArray[np.float32]:
    """Return the smooth factor (h, w, 3) from the log ratios of the cells and their weights."""
    sigma = max(1.0, extent_cells / 5)
    limit = float(np.log(_MAX_LIGHT))
    light = np.ones(ratio.shape, np.float32)
    rows, columns = mask_box(certain.any(axis=2))
    reach = int(np.ceil(4 * sigma)) + 1
    near = (
        slice(max(rows.start - reach, 0), rows.stop + reach),
        slice(max(columns.start - reach, 0), columns.stop + reach),
    )
    pulled = np.clip(ratio[near], -limit, limit) * certain[near]
    total = gaussian_filter(pulled, (sigma, sigma, 0), mode="constant")
    weight = gaussian_filter(certain[near], (sigma, sigma, 0), mode="constant")
    # the little weight beside the cells' own pulls to no change where no cell is near
    light[near] = np.exp(total / (weight + 0.02 * weight.max()))
    return light


def _check_bytes(name: str, image: NDArray[Any]) -> None:
    if image.dtype != np.uint8:
        raise ValueRangeError(f"{name} must be uint8, got {image.dtype}.")
