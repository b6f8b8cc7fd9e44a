"""Analysis by synthesis: a frame's pose and coefficients from the brightness of the face's own surface points.

Landmarks say little of puffed cheeks, pressed lips or wide eyes; the skin's texture moves with them and its shading
changes. After Thies et al., "Face2Face" (2016), for one grey picture with the clip's own skin as the appearance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from facewright.fitting.clip_person import FrameState
from facewright.fitting.dense_model import CENTRE, N_POSE
from facewright.fitting.face_surface import FaceSurface
from facewright.fitting.rest_appearance import RestAppearance, SkinSamples, light_slope
from facewright.landmarks.face_crops import FaceCrop

#: Errors of neighbouring points are alike: this share of them counts.
_INDEPENDENT = 0.4
#: Error of a picture's brightness beside each point's own, sRGB levels; beyond so many of both it counts little.
_LEVELS, _TAIL = 2.0, 3.0
#: Skin is seen from this cosine on, and fully from the second.
_GRAZING, _FRONTAL = 0.25, 0.5


@dataclass(frozen=True, eq=False)
class ImageTerm:
    """Half the weighted squared difference of a frame's brightness from that of a person's skin under its light.

    Parameters
    ----------
    surface : FaceSurface
        The person's skin.
    appearance : RestAppearance
        Its brightness in this clip.
    """

    surface: FaceSurface
    appearance: RestAppearance

    def quadratic(self, crop: FaceCrop, state: FrameState) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return Gauss-Newton Hessian (6 + B, 6 + B) and gradient in (pose step, beta); the exposure is eliminated.

        Parameters
        ----------
        crop : FaceCrop
            The frame's brightness.
        state : FrameState
            Where it is linearised.
        """
        surface, look = self.surface, self.appearance
        points, normals = surface.at(state.beta)
        picture = softened(crop.pixels)
        seen, camera, pixels, weight = _placed(crop, points, normals, state)
        value, slope_x, slope_y = _sampled(picture, pixels)
        shaded, by_normal = _shaded(look.brightness, look.light, camera)
        spread2 = look.noise**2 + _LEVELS**2
        frontal = weight > 0.5
        gain = float(np.median(value[frontal] / shaded[frontal])) if frontal.sum() > 20 else 1.0
        residual = value - gain * shaded
        weight = _INDEPENDENT * weight / spread2 / (1.0 + residual**2 / (_TAIL**2 * spread2)) ** 2
        pose = state.pose
        J = np.empty((len(points), N_POSE + 1 + surface.deltas.shape[2]), dtype=np.float32)
        _derivatives(
            J,
            np.sqrt(weight),
            gain * shaded,
            gain * by_normal,
            slope_x / crop.step,
            slope_y / crop.step,
            seen,
            camera,
            pose.motion.rotation,
            pose.motion.apply(CENTRE),
            pose.intrinsics.focal_x,
            pose.scale,
            surface.deltas,
            surface.normal_deltas,
        )
        H = (J.T @ J).astype(np.float64)
        g = (J.T @ (np.sqrt(weight) * residual).astype(np.float32)).astype(np.float64)
        return _without(N_POSE, H, g)


def observe(surface: FaceSurface, crops: list[FaceCrop], states: list[FrameState]) -> SkinSamples:
    """Return what crops show of a surface in the given states."""
    rows = []
    for crop, state in zip(crops, states, strict=True):
        points, normals = surface.at(state.beta)
        _, camera, pixels, weight = _placed(crop, points, normals, state)
        value, _, _ = _sampled(softened(crop.pixels), pixels)
        rows.append((value, camera, weight, surface.displaced(state.beta)))
    return SkinSamples(*(np.array(column) for column in zip(*rows, strict=True)))


def _placed(
    crop: FaceCrop, points: NDArray[np.float64], normals: NDArray[np.float64], state: FrameState
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return points and normals in the camera's frame, the points in the crop's pixels, and how well they are seen."""
    pose = state.pose
    seen = pose.motion.apply(points)
    camera = normals @ pose.motion.rotation.T
    pixels = (pose.intrinsics.project(seen) - crop.corner) / crop.step
    facing = -(camera * seen).sum(axis=1) / np.linalg.norm(seen, axis=1)
    weight = np.clip((facing - _GRAZING) / (_FRONTAL - _GRAZING), 0.0, 1.0)
    inside = (pixels > 1.0).all(axis=1) & (pixels < np.array(crop.pixels.shape[::-1]) - 3.0).all(axis=1)
    return seen, camera, pixels, weight * inside


def _without(i: int, H: NDArray[np.float64], g: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the quadratic with unknown i at its own minimum."""
    keep = np.delete(np.arange(len(g)), i)
    column, pivot = H[keep, i], max(H[i, i], 1e-12)
    return H[np.ix_(keep, keep)] - np.outer(column, column) / pivot, g[keep] - column * (g[i] / pivot)


@njit(cache=True, nogil=True)
def softened(pixels):  # type: ignore[no-untyped-def]
    """Return a picture (S, S) smoothed with (1, 2, 1) / 4 along both axes, float32; its border stays."""
    height, width = pixels.shape
    across = np.empty((height, width), np.float32)
    for j in range(height):
        across[j, 0], across[j, width - 1] = pixels[j, 0], pixels[j, width - 1]
        for i in range(1, width - 1):
            left, middle, right = np.float32(pixels[j, i - 1]), np.float32(pixels[j, i]), np.float32(pixels[j, i + 1])
            across[j, i] = np.float32(0.25) * (left + right) + np.float32(0.5) * middle
    out = across.copy()
    for j in range(1, height - 1):
        for i in range(width):
            ends = across[j - 1, i] + across[j + 1, i]
            out[j, i] = np.float32(0.25) * ends + np.float32(0.5) * across[j, i]
    return out


@njit(cache=True, nogil=True)
def _sampled(picture, pixels):  # type: ignore[no-untyped-def]
    """Return brightness and its slopes along x and y at points (N, 2), bilinear; zero within a pixel of the border."""
    height, width = picture.shape
    n = len(pixels)
    value, by_x, by_y = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(n):
        x, y = pixels[k, 0], pixels[k, 1]
        if not (x > 1.0 and y > 1.0 and x < width - 3.0 and y < height - 3.0):
            continue
        i, j = int(x), int(y)
        u, v = x - i, y - j
        for dj in range(2):
            for di in range(2):
                share = (u if di else 1.0 - u) * (v if dj else 1.0 - v)
                a, b = j + dj, i + di
                value[k] += share * picture[a, b]
                by_x[k] += share * 0.5 * (picture[a, b + 1] - picture[a, b - 1])
                by_y[k] += share * 0.5 * (picture[a + 1, b] - picture[a - 1, b])
    return value, by_x, by_y


@njit(cache=True, nogil=True)
def _shaded(brightness, light, normals):  # type: ignore[no-untyped-def]
    """Return the brightness (N,) under the light and its derivative (N, 3) by the normals."""
    n = len(brightness)
    value, slope = np.empty(n), np.empty((n, 3))
    for k in range(n):
        exponent, x, y, z = light_slope(light, normals[k, 0], normals[k, 1], normals[k, 2])
        value[k] = brightness[k] * np.exp(exponent)
        slope[k, 0], slope[k, 1], slope[k, 2] = value[k] * x, value[k] * y, value[k] * z
    return value, slope


@njit(cache=True, nogil=True)
def _derivatives(  # type: ignore[no-untyped-def]
    J,
    root,
    shaded,
    by_normal,
    slope_x,
    slope_y,
    seen,
    normals,
    R,
    middle,
    focal,
    scale,
    deltas,
    normal_deltas,
):
    """Fill J (N, 6 + 1 + B), weighted: residual by pose step, log exposure and coefficients."""
    B = deltas.shape[2]
    for k in range(len(root)):
        w = root[k]
        if w == 0.0:
            J[k] = 0.0
            continue
        x, y, z = seen[k, 0], seen[k, 1], seen[k, 2]
        # brightness by the point in the camera's frame: through the pinhole
        cx, cy = w * slope_x[k] * focal / z, w * slope_y[k] * focal / z
        cz = -(cx * x + cy * y) / z
        lx, ly, lz = w * by_normal[k, 0], w * by_normal[k, 1], w * by_normal[k, 2]
        ax, ay, az = x - middle[0], y - middle[1], z - middle[2]
        nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
        J[k, 0] = ay * cz - az * cy - (ny * lz - nz * ly)
        J[k, 1] = az * cx - ax * cz - (nz * lx - nx * lz)
        J[k, 2] = ax * cy - ay * cx - (nx * ly - ny * lx)
        J[k, 3] = cx / scale
        J[k, 4] = cy / scale
        J[k, 5] = -(cx * middle[0] + cy * middle[1] + cz * middle[2])
        J[k, 6] = -w * shaded[k]
        mx = np.float32(cx * R[0, 0] + cy * R[1, 0] + cz * R[2, 0])
        my = np.float32(cx * R[0, 1] + cy * R[1, 1] + cz * R[2, 1])
        mz = np.float32(cx * R[0, 2] + cy * R[1, 2] + cz * R[2, 2])
        sx = np.float32(lx * R[0, 0] + ly * R[1, 0] + lz * R[2, 0])
        sy = np.float32(lx * R[0, 1] + ly * R[1, 1] + lz * R[2, 1])
        sz = np.float32(lx * R[0, 2] + ly * R[1, 2] + lz * R[2, 2])
        for b in range(B):
            J[k, 7 + b] = (
                mx * deltas[k, 0, b]
                + my * deltas[k, 1, b]
                + mz * deltas[k, 2, b]
                - sx * normal_deltas[k, 0, b]
                - sy * normal_deltas[k, 1, b]
                - sz * normal_deltas[k, 2, b]
            )
