"""Pictures of registered markers: the markers over the fitted face, the coarse mesh over it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.fitting.marker_registration import RegisteredPerformer
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import draw_mesh_lines, draw_points
from facewright.imaging.portrait import portrait_view
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import render_mesh
from facewright.models.performer_data import PerformerData

Picture = NDArray[np.uint8]

_SKIN = (0.78, 0.64, 0.58)
_MARKER, _LINE = (250, 210, 40), (40, 90, 200)
_VIEWS = (0.0, 40.0)
_MARGIN = 0.04  # free at each side, of the picture
_N_FRAMES = 3


def markers_over_mesh(performer: RegisteredPerformer, *, size: tuple[int, int] = (420, 360)) -> Picture:
    """Draw the face at rest and in the frames that differ most from it and from each other.

    Above from the front, below turned: the fitted surface, the coarse mesh (blue) and the markers (yellow).
    """
    data = performer.data
    surface = performer.registration.template
    shown = most_different(data, _N_FRAMES)
    rest = performer.registration.placement
    chosen = [("at rest", rest.rest)]
    chosen += [(f"{data.clips[c].name} {data.clips[c].times[t]:.2f} s", _markers(performer, c, t)) for c, t in shown]
    vertices = performer.registration.surface(np.array([markers for _, markers in chosen]))
    vertices[0] = rest.neutral
    moved = [performer.reference_from_head.apply(v[None])[0] for v in vertices]
    dots = [performer.reference_from_head.apply(markers[None])[0] for _, markers in chosen]
    coarse = surface.coarse_places
    frame = _frame(np.concatenate([*moved, *dots]), size)
    rows = []
    for yaw in _VIEWS:
        for v, markers in zip(moved, dots):
            rows.append(_draw(v, surface.faces, v[coarse], data.faces, markers, yaw, size, frame))
    captions = [name for name, _ in chosen] + ["" for _ in chosen]
    return contact_sheet(rows, captions, columns=len(chosen))


def coarse_meshes(data: PerformerData, *, size: tuple[int, int] = (420, 360)) -> Picture:
    """Draw a performer's coarse mesh at rest and in the frames that differ most; where there are no markers."""
    shown = most_different(data, _N_FRAMES)
    chosen = [("at rest", data.neutral)]
    chosen += [(f"{data.clips[c].name} {data.clips[c].times[t]:.2f} s", data.clips[c].vertices[t]) for c, t in shown]
    none = np.empty((0, 3))
    frame = _frame(np.concatenate([v for _, v in chosen]), size)
    rows = [_draw(v, data.faces, v, data.faces, none, yaw, size, frame) for yaw in _VIEWS for _, v in chosen]
    return contact_sheet(rows, [name for name, _ in chosen] + ["" for _ in chosen], columns=len(chosen))


def most_different(data: PerformerData, count: int) -> list[tuple[int, int]]:
    """Return (clip, frame) of the frames farthest from rest and from one another."""
    places = [(c, t) for c, clip in enumerate(data.clips) for t in range(0, clip.n_frames, max(1, clip.n_frames // 60))]
    if not places:
        return []
    flat = np.array([data.clips[c].vertices[t] - data.neutral for c, t in places]).reshape(len(places), -1)
    distance = np.linalg.norm(flat, axis=1)
    found: list[int] = []
    while len(found) < min(count, len(places)):
        found.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(flat - flat[found[-1]], axis=1))
    return [places[k] for k in found]


def _markers(performer: RegisteredPerformer, clip: int, frame: int) -> NDArray[np.float64]:
    return performer.markers[performer.data.clips[clip].name][frame]


class _Frame(NamedTuple):
    """The part of space that is shown: its middle, and its extent from top to bottom, millimetres."""

    centre: tuple[float, float, float]
    height: float


def _frame(points: NDArray[np.floating], size: tuple[int, int]) -> _Frame:
    """Return what shows all points (K, 3) from all sides of `_VIEWS`."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre = 0.5 * (low + high)
    far = np.concatenate(
        [portrait_view(points, size, yaw_degrees=yaw, centre_mm=centre, height_mm=100.0)[1] for yaw in _VIEWS]
    )
    middle = 0.5 * (np.array(size[::-1]) - 1.0)
    share = np.abs(far - middle).max(axis=0) / (middle * (1.0 - 2.0 * _MARGIN))
    x, y, z = (float(c) for c in centre)
    return _Frame((x, y, z), 100.0 * float(share.max()))


def _draw(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    coarse: NDArray[np.floating],
    coarse_faces: NDArray[np.integer],
    markers: NDArray[np.floating],
    yaw: float,
    size: tuple[int, int],
    frame: _Frame,
) -> Picture:
    view = {"yaw_degrees": yaw, "centre_mm": frame.centre, "height_mm": frame.height}
    camera, pixels = portrait_view(vertices, size, **view)  # type: ignore[arg-type]
    albedo = np.broadcast_to(np.array(_SKIN, dtype=np.float32), (len(vertices), 3))
    image = render_mesh(camera, pixels, faces, size, albedo=albedo).image
    # lines a little before the surface, which they would cut through
    near, lines = portrait_view(coarse, size, **view)  # type: ignore[arg-type]
    image = draw_mesh_lines(image, lines, near[:, 2] - 2.0, coarse_faces, colour=_LINE, opacity=0.55)
    if len(markers):
        behind, dots = portrait_view(markers, size, **view)  # type: ignore[arg-type]
        depth = rasterise(pixels, camera[:, 2], faces, size).depth
        x, y = (np.clip(np.round(dots[:, k]).astype(int), 0, size[1 - k] - 1) for k in (0, 1))
        hidden = behind[:, 2] > depth[y, x] + 4.0
        image = draw_points(image, np.where(hidden[:, None], np.nan, dots), _MARKER, 2.2)
    return image
