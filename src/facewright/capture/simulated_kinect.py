"""What a Kinect v1 would measure of a scene whose depth is known: noise, disparity steps, shadow, grazing surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from facewright.camera.pinhole import Intrinsics
from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape

#: Colour and depth of a Kinect v1 as its drivers hand them over, registered on one grid.
KINECT_SIZE = (480, 640)
KINECT_INTRINSICS = Intrinsics(575.8, 575.8, 319.5, 239.5)
FRAMES_PER_SECOND = 30.0

_NEARLY_FRONTAL = 0.97  # cosine above which the angle of a surface makes no difference
_PATCH_PX = 2  # by which failures are coarser than the noise of depth
_EDGE_MM = 12.0  # neighbours that differ by more per pixel are different surfaces, between which nothing is measured


@dataclass(frozen=True)
class KinectNoise:
    """Depth noise of the structured-light Kinect.

    Parameters
    ----------
    axial_mm, axial_per_square_m : float
        Standard deviation along the optical axis: ``axial_mm + axial_per_square_m (z - 0.4 m)^2``, mm.
    lateral_px : float
        Standard deviation of the place in the picture that a pixel's depth comes from, for a frontal surface.
    correlation_px : float
        The noise of neighbours is alike over about this many pixels, because depth comes from windows of the picture;
        0 for independent pixels.
    disparity_step_px, focal_px, baseline_mm : float
        Depth is stored in steps of disparity, ``focal_px baseline_mm / z``; the projector stands a baseline to the
        right of the camera (+x).
    grazing_degrees : float
        Surfaces that are seen at a larger angle off their normal return nothing.
    range_mm : (float, float)
        Nearest and farthest distance measured.

    Notes
    -----
    Axial and lateral noise and their growth at grazing angles follow Nguyen, Izadi and Lovell, Modeling Kinect sensor
    noise for improved 3D reconstruction and tracking (3DIMPVT 2012); disparity steps follow Khoshelham and Elberink,
    Accuracy and resolution of Kinect depth data for indoor mapping applications (Sensors 2012).
    """

    axial_mm: float = 1.2
    axial_per_square_m: float = 1.9
    lateral_px: float = 0.75
    correlation_px: float = 1.0
    disparity_step_px: float = 0.125
    focal_px: float = 580.0
    baseline_mm: float = 75.0
    grazing_degrees: float = 70.0
    range_mm: tuple[float, float] = (450.0, 4000.0)

    def __post_init__(self) -> None:
        values = (self.axial_mm, self.axial_per_square_m, self.lateral_px, self.correlation_px, self.baseline_mm)
        if not (np.isfinite(values).all() and min(values) >= 0):
            raise ValueRangeError(f"noise of a Kinect must be finite and not negative, got {values}.")
        if not (self.disparity_step_px > 0 and self.focal_px > 0 and 0 < self.grazing_degrees <= 90):
            raise ValueRangeError(
                "disparity_step_px and focal_px must be positive and grazing_degrees in (0, 90], got "
                f"{self.disparity_step_px}, {self.focal_px} and {self.grazing_degrees}."
            )

    def observe(
        self,
        depth: NDArray[np.floating],
        intrinsics: Intrinsics,
        rng: np.random.Generator,
        *,
        absorbed: NDArray[np.floating] | None = None,
    ) -> NDArray[np.float32]:
        """Return what the sensor reports of a true depth map.

        Parameters
        ----------
        depth : ndarray of shape (H, W), millimetres
            True distance along the optical axis at pixel centres; 0 where there is nothing.
        intrinsics : Intrinsics
            The camera.
        rng : numpy.random.Generator
            Source of randomness.
        absorbed : ndarray of shape (H, W), optional
            Share in [0, 1] of the surface's measurements that fail because it swallows or scatters the pattern: dark
            hair, lenses. Failures come in patches.

        Returns
        -------
        ndarray of shape (H, W), float32, millimetres
            Measured depth; 0 where the sensor reports none.

        Raises
        ------
        ShapeError, ValueRangeError
            If `depth` is not (H, W) or holds values that are negative or not finite, or `absorbed` does not match.
        """
        sizes = check_shape("depth", depth, "H", "W")
        check_finite("depth", depth)
        if (depth < 0).any():
            raise ValueRangeError("depth must not be negative: 0 where there is none.")
        fails_below = np.full((1, 1), -np.inf, np.float32)
        if absorbed is not None:
            check_shape("absorbed", absorbed, "H", "W", **sizes)
            some = np.asarray(absorbed) > 0
            fails_below = np.full(depth.shape, -np.inf, np.float32)
            fails_below[some] = ndtri(np.clip(np.asarray(absorbed)[some], 0.0, 1.0))
        channels = 3 if absorbed is None else 4
        noise = _correlated_noise((channels, sizes["H"], sizes["W"]), self.correlation_px, rng)
        camera = (intrinsics.focal_x, intrinsics.focal_y, intrinsics.centre_x, intrinsics.centre_y)
        sensor = (
            self.axial_mm,
            self.axial_per_square_m,
            self.lateral_px,
            self.focal_px * self.baseline_mm / self.disparity_step_px,
            intrinsics.focal_x * self.baseline_mm,
            float(np.deg2rad(self.grazing_degrees)),
            *self.range_mm,
        )
        return _observe(np.ascontiguousarray(depth, dtype=np.float32), noise, fails_below, camera, sensor)


def _correlated_noise(
    shape: tuple[int, int, int], correlation_px: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw normal noise (C, H, W) of unit variance whose neighbours are alike over `correlation_px`."""
    if correlation_px <= 0:
        return rng.standard_normal(shape, dtype=np.float32)
    # Weighted sums of nine uniform numbers are as good as normal ones, and random bytes come far faster.
    tap = float(np.exp(-0.5 / correlation_px**2))
    size = (1.0 + 2.0 * tap * tap) * float(np.sqrt((256.0**2 - 1.0) / 12.0))
    padded = (shape[0], shape[1] + 2, shape[2] + 2)
    return _smooth_bytes(np.frombuffer(rng.bytes(int(np.prod(padded))), np.uint8).reshape(padded), tap, 1.0 / size)


@njit(cache=True, nogil=True)
def _smooth_bytes(values, tap, scale):  # type: ignore[no-untyped-def]
    """Weight each byte's 3 x 3 neighbours by 1, tap and tap^2 and bring the sum to mean 0."""
    channels, height, width = values.shape[0], values.shape[1] - 2, values.shape[2] - 2
    out = np.empty((channels, height, width), np.float32)
    column = np.empty(width + 2, np.float32)
    t, middle = np.float32(tap), np.float32(127.5 * (1.0 + 2.0 * tap) ** 2)
    for c in range(channels):
        for v in range(height):
            for u in range(width + 2):
                column[u] = values[c, v + 1, u] + t * (np.float32(values[c, v, u]) + np.float32(values[c, v + 2, u]))
            for u in range(width):
                out[c, v, u] = (column[u + 1] + t * (column[u] + column[u + 2]) - middle) * np.float32(scale)
    return out


@njit(cache=True, nogil=True)
def _observe(depth, noise, fails_below, camera, sensor):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    focal_x, focal_y, centre_x, centre_y = camera
    axial, axial_growth, lateral, steps, focal_baseline, grazing, near, far = sensor
    patches = fails_below.shape == depth.shape
    least_cosine = np.cos(grazing)
    out = np.zeros((height, width), np.float32)
    for v in range(height):
        lit = np.inf  # smallest column of the projector that a surface to the right has taken
        for u in range(width - 1, -1, -1):
            z = depth[v, u]
            if z <= 0.0:
                continue
            # What the projector, at +x, sees of a row comes in the order of the columns; the rest is in the shadow.
            projector = u - focal_baseline / z
            shadow = projector >= lit
            lit = min(lit, projector)
            if shadow or z < near or z > far or (patches and _coarse(noise[3], v, u) < fails_below[v, u]):
                continue
            du = _slope(depth, v, u, 0, 1)
            dv = _slope(depth, v, u, 1, 0)
            # The normal of z(u, v) against the pixel's ray.
            x, y = u - centre_x, v - centre_y
            nx, ny, nz = focal_x * du, focal_y * dv, z + x * du + y * dv
            ray = np.sqrt((x / focal_x) ** 2 + (y / focal_y) ** 2 + 1.0)
            cosine = z / (np.sqrt(nx * nx + ny * ny + nz * nz) * ray)
            if cosine < least_cosine:
                continue
            angle = np.arccos(cosine) if cosine < _NEARLY_FRONTAL else 0.0
            oblique = angle / (0.5 * np.pi - angle)
            # Nguyen et al. 2012, eq. (1): 0.8 + 0.035 oblique px
            blur = lateral * (1.0 + 0.044 * oblique)
            seen = _sample(depth, v + blur * noise[1, v, u], u + blur * noise[0, v, u])
            if seen <= 0.0:
                continue
            metres = 0.001 * seen
            spread = axial + axial_growth * (metres - 0.4) ** 2
            if angle > np.pi / 3.0:  # Nguyen et al. 2012, eq. (3)
                spread += 0.1 / np.sqrt(metres) * oblique * oblique
            measured = seen + spread * noise[2, v, u]
            if measured > 0.0:
                out[v, u] = steps / np.rint(steps / measured)
    return out


@njit(cache=True, nogil=True)
def _slope(depth, v, u, down, right):  # type: ignore[no-untyped-def]
    """Return the change of depth per pixel: the smaller of both sides, so that an edge beside does not count."""
    height, width = depth.shape
    z = depth[v, u]
    slope = np.inf
    if v >= down and u >= right and depth[v - down, u - right] > 0.0:
        slope = z - depth[v - down, u - right]
    if v + down < height and u + right < width and depth[v + down, u + right] > 0.0:
        after = depth[v + down, u + right] - z
        if abs(after) < abs(slope):
            slope = after
    return slope if slope < np.inf else 0.0


@njit(cache=True, nogil=True)
def _sample(depth, row, column):  # type: ignore[no-untyped-def]
    """Return the depth between pixels; that of the nearest one where the four lie on different surfaces."""
    height, width = depth.shape
    row = min(max(row, 0.0), height - 1.0)
    column = min(max(column, 0.0), width - 1.0)
    v, u = min(int(row), height - 2), min(int(column), width - 2)
    a, b, c, d = depth[v, u], depth[v, u + 1], depth[v + 1, u], depth[v + 1, u + 1]
    low, high = min(a, b, c, d), max(a, b, c, d)
    if low <= 0.0 or high - low > _EDGE_MM:
        return depth[int(np.rint(row)), int(np.rint(column))]
    s, t = row - v, column - u
    return (a * (1.0 - t) + b * t) * (1.0 - s) + (c * (1.0 - t) + d * t) * s


@njit(cache=True, nogil=True)
def _coarse(noise, v, u):  # type: ignore[no-untyped-def]
    """Return noise whose neighbours are alike over `_PATCH_PX` times as many pixels; variance about 1."""
    i, j = v // _PATCH_PX, u // _PATCH_PX
    s, t = v / _PATCH_PX - i, u / _PATCH_PX - j
    above = noise[i, j] * (1.0 - t) + noise[i, j + 1] * t
    below = noise[i + 1, j] * (1.0 - t) + noise[i + 1, j + 1] * t
    return above * (1.0 - s) + below * s
