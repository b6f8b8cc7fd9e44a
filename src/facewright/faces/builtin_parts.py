"""Eyeballs and teeth of the built-in face: small parametric surfaces placed by measured figures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Eyeball, mm: centre of the left one; radius against the angle from the optical axis (degrees): a globe with a
# corneal bulge. The rings at 8.5 and 20.5 degrees are the borders of pupil and iris.
EYE_CENTRE = (31.24, 36.07, 78.74)
EYE_RINGS = (8.5, 14.5, 20.5, 23.5, 32.0, 45.0, 66.0, 110.0)
EYE_RADII = (17.06, 16.92, 16.62, 16.28, 15.73, 15.40, 15.30, 15.15)
EYE_POLES = (17.13, 15.05)
EYE_SEGMENTS = 16
PUPIL_RINGS, IRIS_RINGS = 1, 3

# Teeth, mm, first incisor to first molar of the left side: x and z of the middle of the labial face, width along the
# arch, thickness at the cutting edge, y of the cutting edge, y of the gum line.
UPPER_TEETH = (
    (4.25, 106.6, 8.7, 2.2, -35.0, -24.8),
    (11.9, 104.1, 7.2, 2.2, -34.3, -25.2),
    (18.1, 99.2, 8.3, 3.0, -34.5, -24.6),
    (22.6, 91.6, 8.6, 5.5, -33.7, -25.2),
    (25.2, 84.0, 7.8, 6.0, -33.3, -25.4),
    (27.8, 75.2, 10.2, 7.0, -32.8, -25.2),
)
LOWER_TEETH = (
    (3.75, 104.1, 7.5, 2.0, -34.2, -43.6),
    (10.4, 101.6, 7.6, 2.2, -33.6, -43.2),
    (16.4, 96.5, 8.2, 3.0, -33.0, -43.6),
    (20.6, 89.3, 8.0, 5.0, -33.0, -42.4),
    (23.2, 82.1, 7.6, 5.5, -33.2, -41.6),
    (25.9, 74.6, 9.8, 6.5, -32.8, -40.6),
)
# Behind the first molar the row ends in two more sections, ever lower and thinner: x and z of the labial face,
# thickness, y of the cutting edge.
UPPER_TAIL = ((29.1, 66.5, 6.0, -30.8), (29.8, 57.5, 3.0, -26.0))
LOWER_TAIL = ((27.5, 65.5, 5.6, -34.8), (28.5, 57.0, 3.0, -39.8))
# Of a section's five points, how far they are in the gum: 0.5 is the gum line, as in the sections below.
GUM_OF_SECTION = (1.5, 0.5, -0.7, -0.7, 3.7)


class Part(NamedTuple):
    """A closed surface with a mirror map and a flat unwrapping of its own in [0, 1] x [0, 1]."""

    vertices: NDArray[np.float64]  # (V, 3) mm
    quads: NDArray[np.int32]  # (Q, 4), -1 pads a triangle
    mirror: NDArray[np.int32]  # (V,) vertex of the mirrored part (teeth: of the same part)
    uv: NDArray[np.float64]  # (V, 2)


def build_eyeball(side: str) -> Part:
    """Build the left or right eyeball as a globe of rings about its optical axis (+z).

    The right one is the mirror image, vertex by vertex, so that left and right share indices.
    """
    n = EYE_SEGMENTS
    azimuth = 2 * np.pi * np.arange(n) / n
    polar, radius = np.radians(EYE_RINGS)[:, None], np.array(EYE_RADII)[:, None]
    rings = np.stack(
        [
            radius * np.sin(polar) * np.cos(azimuth),
            radius * np.sin(polar) * np.sin(azimuth),
            radius * np.cos(polar) * np.ones(n),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = np.concatenate([[[0.0, 0.0, EYE_POLES[0]]], rings, [[0.0, 0.0, -EYE_POLES[1]]]])
    last = len(points) - 1
    spread = np.concatenate([[0.0], np.degrees(polar.ravel()) / 110.0 * 0.45, [0.5]])  # azimuthal unwrapping
    turn = np.concatenate([[0.0], np.tile(azimuth, len(EYE_RINGS)), [0.0]])
    radial = np.concatenate([[0.0], np.repeat(spread[1:-1], n), [0.5]])
    uv = 0.5 + np.stack([radial * np.cos(turn), radial * np.sin(turn)], axis=1)

    k = np.arange(n)
    following = (k + 1) % n
    quads = [np.stack([np.zeros(n), 1 + k, 1 + following, np.full(n, -1)], axis=1)]
    for ring in range(len(EYE_RINGS) - 1):
        inner, outer = 1 + ring * n, 1 + (ring + 1) * n
        quads.append(np.stack([inner + k, outer + k, outer + following, inner + following], axis=1))
    tail = 1 + (len(EYE_RINGS) - 1) * n
    quads.append(np.stack([tail + k, np.full(n, last), tail + following, np.full(n, -1)], axis=1))
    faces = np.concatenate(quads).astype(np.int32)
    points = points + EYE_CENTRE
    if side == "right":
        points = points * [-1.0, 1.0, 1.0]
        uv = np.stack([1.0 - uv[:, 0], uv[:, 1]], axis=1)
        faces = _reversed(faces)
    return Part(points, faces, np.arange(len(points), dtype=np.int32), uv)


def _reversed(quads: NDArray[np.int32]) -> NDArray[np.int32]:
    """Turn faces round, keeping the padding of triangles last."""
    whole = quads[:, 3] >= 0
    out = quads.copy()
    out[whole] = quads[whole][:, ::-1]
    out[~whole, :3] = quads[~whole][:, 2::-1]
    return out


def build_teeth(row: str) -> Part:
    """Build a row of twelve teeth as one closed tube along the arch: three columns a tooth, five points a section.

    Behind the first molars the tube sinks into the gum, so that no end is seen from beside.
    """
    table = np.array(UPPER_TEETH if row == "upper" else LOWER_TEETH)
    x, z, width, thickness, edge, gum = table.T
    arch = np.stack([np.concatenate([-x[::-1], x]), np.concatenate([z[::-1], z])], axis=1)  # right to left
    tangent = np.gradient(arch, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    outward = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)  # to the lips
    both = [np.concatenate([v[::-1], v]) for v in (width, thickness, edge, gum)]
    inwards = 1.0 if row == "upper" else -1.0  # towards the root

    sections = []
    for j in range(len(arch)):
        half, thick = both[0][j] / 2, both[1][j]
        cut, root = both[2][j], both[3][j]
        # the narrow neck between teeth, then the two shoulders of the crown
        left = arch[j] - tangent[j] * half if j == 0 else _between(arch, tangent, both[0], j)
        sections.append(_section(left, outward[j], thick, cut + 0.6 * inwards, root, 0.8, inwards))
        for s in (-0.62, 0.62):
            place = arch[j] + tangent[j] * half * s
            sections.append(_section(place, outward[j], thick, cut, root, 0.0, inwards))
    end = arch[-1] + tangent[-1] * both[0][-1] / 2
    sections.append(_section(end, outward[-1], both[1][-1], both[2][-1] + 0.6 * inwards, both[3][-1], 0.8, inwards))
    tail = []
    for tail_x, tail_z, thick, cut in UPPER_TAIL if row == "upper" else LOWER_TAIL:
        tail.append(_section(np.array([tail_x, tail_z]), outward[-1], thick, cut, gum[-1], 0.4, inwards))
    head = [section * [-1.0, 1.0, 1.0] for section in tail[::-1]]
    points = np.array([*head, *sections, *tail])  # (columns, 5, 3)
    points = 0.5 * (points + points[::-1] * [-1.0, 1.0, 1.0])
    columns, n = points.shape[:2]

    ids = np.arange(columns * n).reshape(columns, n)
    a, b = ids[:-1], ids[1:]
    tube = np.stack([a, b, np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)], axis=-1).reshape(-1, 4)
    caps = [[*ids[0, [0, 1, 3, 4]]], [*ids[0, [1, 2, 3]], -1], [*ids[-1, [4, 3, 1, 0]]], [*ids[-1, [3, 2, 1]], -1]]
    faces = np.concatenate([tube, np.array(caps)]).astype(np.int32)
    faces = faces if _volume(points.reshape(-1, 3), faces) > 0 else _reversed(faces)
    u = np.repeat(np.linspace(0.0, 1.0, columns)[:, None], n, axis=1)
    v = np.repeat(np.linspace(0.0, 1.0, n)[None], columns, axis=0)
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    return Part(points.reshape(-1, 3), faces, ids[::-1].reshape(-1).astype(np.int32), uv)


def _between(arch: NDArray, tangent: NDArray, width: NDArray, j: int) -> NDArray:
    """Return the point of the arch where tooth j meets the one before it."""
    before, after = arch[j - 1] + tangent[j - 1] * width[j - 1] / 2, arch[j] - tangent[j] * width[j] / 2
    return 0.5 * (before + after)


def _section(
    place: NDArray, outward: NDArray, thick: float, cut: float, root: float, inset: float, inwards: float
) -> NDArray:
    """Return five points round a tooth: gum outside, neck, cutting edge outside and inside, gum inside."""
    rows = (
        (-inset - 1.0, root + 7.0 * inwards),
        (-inset * 0.6 + 0.0, root),
        (-inset, cut),
        (-max(thick - inset, 1.0), cut),
        (-thick - 2.5, root + 7.0 * inwards),
    )
    return np.array([[*(place + outward * o), y] for o, y in rows])[:, [0, 2, 1]]


def _volume(points: NDArray, quads: NDArray[np.int32]) -> float:
    last = np.where(quads[:, 3] >= 0, quads[:, 3], quads[:, 0])
    a, b, c, d = points[quads[:, 0]], points[quads[:, 1]], points[quads[:, 2]], points[last]
    return float(np.einsum("nc,nc->", a, np.cross(b, c)) + np.einsum("nc,nc->", a, np.cross(c, d)))


# Four handles per part (left eye, right eye, upper teeth, lower teeth): the part is an affine function of them.
_EYE_HANDLES = np.array(EYE_CENTRE) + [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]]
_UPPER_HANDLES = np.array([[20.0, -30.0, 80.0], [-20.0, -30.0, 80.0], [0.0, -15.0, 80.0], [0.0, -30.0, 105.0]])
_LOWER_HANDLES = np.array([[20.0, -35.0, 80.0], [-20.0, -35.0, 80.0], [0.0, -50.0, 80.0], [0.0, -35.0, 102.0]])
HANDLES = np.concatenate([_EYE_HANDLES, _EYE_HANDLES * [-1.0, 1.0, 1.0], _UPPER_HANDLES, _LOWER_HANDLES])
HANDLE_MIRROR = np.array([4, 5, 6, 7, 0, 1, 2, 3, 9, 8, 10, 11, 13, 12, 14, 15])
RIGID_PARTS = ("eyeball_left", "eyeball_right", "teeth_upper", "teeth_lower")


def build_rigid_parts() -> dict[str, Part]:
    """Build eyeballs and teeth, in the order of `RIGID_PARTS`."""
    return {
        "eyeball_left": build_eyeball("left"),
        "eyeball_right": build_eyeball("right"),
        "teeth_upper": build_teeth("upper"),
        "teeth_lower": build_teeth("lower"),
    }


def handle_weights(part: int, points: NDArray) -> NDArray[np.float64]:
    """Return the affine coordinates (V, 4) of points in the frame of a part's four handles; rows sum to one."""
    corners = HANDLES[4 * part : 4 * part + 4]
    frame = np.concatenate([corners.T, np.ones((1, 4))])
    return np.linalg.solve(frame, np.concatenate([points.T, np.ones((1, len(points)))])).T
