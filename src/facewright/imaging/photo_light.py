"""The light in a photo, from what the skin of its fitted face shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from facewright.errors import DegenerateError
from facewright.faces.appearance import SKIN_TONES
from facewright.faces.face import Face
from facewright.imaging.colour import linear_from_srgb
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import Lights
from facewright.imaging.wide_blur import block_means
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape

_SAMPLES_ACROSS = 110  # skin is looked at on a grid of about so many points across the face
_MIN_SAMPLES = 60
_ROUNDS = 12
#: What pulls the terms of order 0, 1 and 2 towards zero, as a share of the mean brightness squared.
_RIDGE = np.array([0.0, 0.02, 0.02, 0.02, 0.15, 0.15, 0.15, 0.15, 0.15])
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_USUAL_LIGHT = 0.8  # photographers expose so that white facing the camera is about as bright as this
_LEAST_SHARE = 0.08  # of the mean brightness, in the deepest shade


@dataclass(frozen=True, eq=False)
class PhotoLight:
    """How bright surfaces are in a photo, by where they face.

    Parameters
    ----------
    skin_terms : ndarray of shape (9, 3), float64
        Second-order polynomial (spherical harmonics up to order 2) of the unit normal in the camera's axes that gives
        the skin's linear RGB.
    skin_albedo : ndarray of shape (3,), float64
        The skin's own linear colour; with `skin_terms` it tells the light. One photo cannot tell both: light of usual
        strength and little colour is assumed, and human skin.
    highlight : ndarray of shape (3,), float64
        Linear colour of the brightest skin (98 % of it is darker).
    spread : float
        Robust standard deviation of the skin's logarithmic brightness around the fit.
    """

    skin_terms: NDArray[np.float64]
    skin_albedo: NDArray[np.float64]
    highlight: NDArray[np.float64]
    spread: float

    @property
    def terms(self) -> NDArray[np.float64]:
        """The same polynomial for a white surface, (9, 3): linear irradiance over pi."""
        return self.skin_terms / self.skin_albedo

    def irradiance(self, normals: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the linear RGB (N, 3) of white surfaces with unit normals (N, 3) in the camera's axes."""
        check_shape("normals", normals, "N", 3)
        floor = _LEAST_SHARE * self.terms[0]
        return np.maximum(harmonics(np.asarray(normals, np.float64)) @ self.terms, floor)

    def skin(self, normals: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the linear RGB (N, 3) of the person's skin."""
        return self.irradiance(normals) * self.skin_albedo

    def lights(self) -> Lights:
        """Return the light as one directional light and an ambient sky, for `render_mesh`.

        The linear term tells the direction; its strength is what best explains the irradiance of surfaces that face
        the camera, under the renderer's wrapped diffuse shading.
        """
        terms = self.terms
        slope = terms[1:4] @ _LUMINANCE
        strength = float(np.linalg.norm(slope))
        towards = slope / strength if strength > 1e-9 else np.array([0.0, 0.0, -1.0])
        n = _front_normals()
        up = 0.5 - 0.5 * n[:, 1:2]
        diffuse = np.clip((n @ towards + 0.25) / 1.25, 0.0, None)[:, None] ** 1.3
        design = np.hstack([up, 1 - up, diffuse])
        wanted = self.irradiance(n)
        normal = design.T @ design + 1e-3 * len(n) * np.eye(3)
        sky, ground, key = np.maximum(np.linalg.solve(normal, design.T @ wanted), 0.0)
        return Lights(towards[None], key[None], (*map(float, sky),), (*map(float, ground),))  # type: ignore[arg-type]


def harmonics(normals: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the nine real spherical harmonics up to order 2 (unnormalised) of unit vectors (N, 3): (N, 9)."""
    x, y, z = normals[:, 0], normals[:, 1], normals[:, 2]
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, 1.5 * z * z - 0.5, x * z, x * x - y * y], axis=1)


def estimate_light(photo: NDArray[np.uint8], source: MeshView, face: Face) -> PhotoLight:
    """Estimate the light on a face from the skin of the photo it was fitted to.

    Ambient and directional light are told from how the skin's brightness varies with its normal (Lambert; Ramamoorthi
    and Hanrahan 2001: nine numbers a channel hold 98 % of it), robustly: brows, beards, hair and shadows are outliers.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        sRGB photo.
    source : MeshView
        The fitted mesh as the photo sees it, all parts of `face`.
    face : Face
        Its topology; masks tell where skin is.

    Returns
    -------
    PhotoLight
        The light, in the camera's axes.

    Raises
    ------
    ShapeError
        If the view does not have the face's vertices.
    DegenerateError
        If the photo shows too little of the face's skin.
    """
    check_shape("photo", photo, "H", "W", 3)
    check_shape("source.pixels", source.pixels, face.topology.n_vertices, 2)
    colours, normals, certain = _skin_samples(photo, source, face)
    if len(colours) < _MIN_SAMPLES:
        raise DegenerateError(f"the photo must show the face's skin at {_MIN_SAMPLES} places, got {len(colours)}.")
    weight, spread = _robust_weights(colours, normals, certain)
    terms = _solve(colours, normals, weight)
    shown = colours[weight > 0.5 * weight.max()]
    mean = np.maximum(harmonics(normals[weight > 0]) @ terms, 1e-4).mean(axis=0)
    return PhotoLight(terms, _skin_albedo(mean), np.percentile(shown, 98.0, axis=0), spread)


def _skin_samples(
    photo: NDArray[np.uint8], source: MeshView, face: Face
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return linear colours and unit normals of places on the face's skin, and which are surely bare skin."""
    topology, n = face.topology, face.n_skin
    faces = topology.faces[(topology.faces < n).all(axis=1)]
    skin, sure = np.zeros(n), np.zeros(n)
    skin[topology.masks.get("face_region", np.arange(*topology.parts["face"]))] = 1.0
    for name, ids in topology.masks.items():
        if name.startswith(("lips", "eyelid", "lash_line", "brow", "nostril", "ears")):
            skin[ids[ids < n]] = 0.0
        if name.startswith("cheeks") or name == "nose":
            sure[ids[ids < n]] = 1.0
    sure *= skin
    lo, hi = source.pixels[:n].min(axis=0), source.pixels[:n].max(axis=0)
    step = max(float((hi - lo).max()) / (1.6 * _SAMPLES_ACROSS), 1e-6)
    width, height = (np.ceil((hi - lo) / step) + 1).astype(int)
    size = (int(height), int(width))
    at = (source.pixels[:n] - lo) / step
    buffer = rasterise(at, source.depth[:n], faces, size, perspective=source.perspective, cull_back_faces=True)
    normals = vertex_normals(source.camera_vertices[:n], faces)
    values = buffer.interpolate(faces, np.column_stack([normals, skin, sure]))
    rows, columns = np.nonzero(buffer.covered & (values[..., 3] > 0.99))
    x, y = columns * step + lo[0], rows * step + lo[1]
    inside = (x >= 0) & (y >= 0) & (x <= photo.shape[1] - 1) & (y <= photo.shape[0] - 1)
    found = values[rows, columns][inside].astype(np.float64)
    unit = found[:, :3] / np.maximum(np.linalg.norm(found[:, :3], axis=1, keepdims=True), 1e-9)
    steep = -unit[:, 2] > 0.25  # grazing skin: an error of the fit would show the background
    colours = _blurred_linear(photo, x[inside], y[inside], step)
    return colours[steep], unit[steep], found[steep, 4] > 0.5


def _blurred_linear(
    photo: NDArray[np.uint8], x: NDArray[np.float64], y: NDArray[np.float64], step: float
) -> NDArray[np.float64]:
    """Look the photo up, averaged over about `step` pixels, in linear light."""
    if x.size == 0:
        return np.zeros((0, 3))
    x0, y0 = max(int(x.min() - 3 * step) - 1, 0), max(int(y.min() - 3 * step) - 1, 0)
    crop = photo[y0 : int(y.max() + 3 * step) + 2, x0 : int(x.max() + 3 * step) + 2]
    linear = linear_from_srgb(crop.astype(np.float32) / 255.0)
    n = max(1, int(step / 4))  # of a large face a smaller copy tells as much
    if n > 1:
        linear = block_means(linear, n)
    if step > 1:
        linear = ndimage.gaussian_filter(linear, (0.5 * step / n, 0.5 * step / n, 0))
    places = [(y - y0 - 0.5 * (n - 1)) / n, (x - x0 - 0.5 * (n - 1)) / n]
    return np.stack(
        [ndimage.map_coordinates(linear[..., k], places, order=1, mode="nearest") for k in range(3)], axis=1
    ).astype(np.float64)


def _solve(
    colours: NDArray[np.float64], normals: NDArray[np.float64], weight: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weighted least squares with the ridge, (9, 3)."""
    basis = harmonics(normals)
    share = weight / max(float(weight.sum()), 1e-12)
    normal = (basis * share[:, None]).T @ basis + np.diag(_RIDGE)
    return np.asarray(np.linalg.solve(normal, basis.T @ (share[:, None] * colours)))


def _robust_weights(
    colours: NDArray[np.float64], normals: NDArray[np.float64], certain: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Return how much each sample is skin in the face's general light (Tukey's biweight), and the spread."""
    brightness = np.log(colours @ _LUMINANCE + 1e-3)
    share = np.log(colours + 1e-3) - brightness[:, None]  # the colour, apart from its brightness
    start = certain if certain.sum() >= _MIN_SAMPLES else np.ones(len(colours), dtype=bool)
    weight = start.astype(np.float64)
    spread = 1.0
    tone = np.median(share[start], axis=0)
    tone_spread = np.maximum(1.4826 * np.median(np.abs(share[start] - tone), axis=0), 0.05)
    off_tone = (((share - tone) / tone_spread) ** 2).mean(axis=1)
    for _ in range(_ROUNDS):
        fitted = np.maximum(harmonics(normals) @ _solve(colours, normals, weight) @ _LUMINANCE, 1e-3)
        residual = brightness - np.log(fitted)
        spread = max(1.4826 * float(np.median(np.abs(residual[start]))), 0.03)
        # dark outliers (hair, beards, cast shadows) are commoner than bright ones
        off = (residual / spread) ** 2 + 0.5 * off_tone
        weight = np.clip(1 - off / 4.0**2, 0.0, None) ** 2
        weight[residual < -2.5 * spread] *= 0.3
        weight /= fitted  # errors are relative to brightness
    return weight, spread


def _skin_albedo(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the linear albedo of skin whose mean colour in the photo is given.

    Of the tones of human skin, that whose hue is nearest and which asks for the most usual light.
    """
    steps = np.linspace(0, len(SKIN_TONES) - 1, 81)
    tones = np.stack([np.interp(steps, np.arange(len(SKIN_TONES)), SKIN_TONES[:, k]) for k in range(3)], axis=1)
    albedo = linear_from_srgb(tones).astype(np.float64)
    hue = np.log(albedo[:, :2] / albedo[:, 1:]) - np.log(np.maximum(mean[:2], 1e-4) / np.maximum(mean[1:], 1e-4))
    light = np.log((mean @ _LUMINANCE) / (albedo @ _LUMINANCE) / _USUAL_LIGHT)
    cost = (hue[:, 0] / 0.15) ** 2 + (hue[:, 1] / 0.25) ** 2 + (light / 0.35) ** 2
    found = albedo[int(np.argmin(cost))]
    light_colour = np.maximum(mean, 1e-4) / found
    light_colour /= light_colour @ _LUMINANCE
    # what hue is left is as much the skin's own as the light's
    return np.asarray(found * light_colour**0.6)


def _front_normals() -> NDArray[np.float64]:
    """Return unit normals all over the half that faces the camera."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.9, 0.9, 13)] * 2), axis=-1).reshape(-1, 2)
    grid = grid[(grid**2).sum(axis=1) < 0.85]
    return np.column_stack([grid, -np.sqrt(1 - (grid**2).sum(axis=1))])
