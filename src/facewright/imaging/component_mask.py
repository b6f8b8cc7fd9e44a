"""Face components: which blendshapes make them, where they lie on the skin and in a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from facewright.errors import TopologyError
from facewright.faces.face import Face
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.mesh.geodesics import path_graph
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_choice

COMPONENTS = ("mouth", "eyes", "brows", "nose", "face")
"""What can be carried from one picture into another."""

# Blendshapes are told by how their names begin: chin and cheeks follow the mouth, skin below an eye follows the eye.
_SHAPES: dict[str, tuple[str, ...]] = {
    "mouth": ("mouth", "jaw", "cheekPuff"),
    "eyes": ("eye", "cheekSquint"),
    "brows": ("brow",),
    "nose": ("noseSneer",),
    "face": ("",),
}
_SIDES = ("left", "right")
_EYES = tuple(f"eyelid_{lid}_{side}" for lid in ("upper", "lower") for side in _SIDES) + tuple(
    f"lash_line_{side}" for side in _SIDES
)
_BROWS = tuple(f"brow_{side}" for side in _SIDES)


@dataclass(frozen=True)
class _Place:
    """Where a component lies: masks it consists of, how far round them it goes and what it keeps away from (mm)."""

    core: tuple[str, ...]
    inner_mm: float
    outer_mm: float
    away_from: tuple[str, ...] = ()


_PLACES = {
    "mouth": _Place(("lips",), 18.0, 36.0, ("nose", *_EYES)),
    "eyes": _Place(_EYES, 1.0, 13.0, _BROWS),
    "brows": _Place(_BROWS, 3.5, 16.0, _EYES),
    "nose": _Place(("nose",), 0.0, 10.0, ("lips", *_EYES)),
    "face": _Place(("lips", "nose", "chin", *_EYES, *_BROWS), 16.0, 36.0),
}
# What stays as it is when a component moves: a wrinkled nose must not open lips, nor a brow lids.
_HELD: dict[str, tuple[str, ...]] = {
    "mouth": _EYES,
    "eyes": ("lips",),
    "brows": ("lips", *_EYES),
    "nose": ("lips", *_EYES),
    "face": (),
}
_HELD_MM, _FREE_MM = 1.0, 9.0  # so near what is held nothing moves, from so far on everything does
_WHOLE_MM = 3.0  # so near its masks a component comes as a whole, whatever else is near
_GAP_MM, _BAND_MM = 1.0, 5.0  # from what a component keeps away from, and how wide the band of the seam is there
_RIM_MM, _RIM_BAND_MM = 8.0, 12.0  # from the rim of the face: the outline's own light and background stay out


def component_shapes(component: str, names: Sequence[str]) -> NDArray[np.bool_]:
    """Tell which blendshapes move a component.

    Parameters
    ----------
    component : str
        One of `COMPONENTS`.
    names : sequence of str
        Blendshapes, named as in `facewright.faces.blendshape_names`.

    Returns
    -------
    ndarray of shape (B,), bool
        True where the coefficient comes with the component. Each shape belongs to one component, and to ``"face"``.

    Raises
    ------
    ValueRangeError
        If the component is unknown.

    Examples
    --------
    >>> component_shapes("mouth", ["jawOpen", "browDown_L", "mouthSmile_R"]).tolist()
    [True, False, True]
    """
    check_choice("component", component, COMPONENTS)
    return np.array([name.startswith(_SHAPES[component]) for name in names], dtype=bool)


@lru_cache(maxsize=16)
def component_level(face: Face, component: str) -> NDArray[np.float64]:
    """Return how much each vertex belongs to a component.

    Parameters
    ----------
    face : Face
        With the masks ``lips``, ``nose``, ``chin``, ``eyelid_*``, ``lash_line_*``, ``brow_*`` and
        ``face_region`` on its skin.
    component : str
        One of `COMPONENTS`.

    Returns
    -------
    ndarray of shape (V,), float64
        At least 1 where the component must come as a whole (lips and the skin next to them), falling to 0 through the
        band in which a seam may run, negative outside; -1 off the skin. Distances are along the generic neutral's skin.

    Raises
    ------
    ValueRangeError
        If the component is unknown.
    TopologyError
        If the face lacks one of the masks.
    """
    check_choice("component", component, COMPONENTS)
    place = _PLACES[component]
    distance = _SkinDistance(face)
    core = distance.from_masks(*place.core)
    level = (place.outer_mm - core) / (place.outer_mm - place.inner_mm)
    if place.away_from:
        level = np.minimum(level, (distance.from_masks(*place.away_from) - _GAP_MM) / _BAND_MM)
    level = np.minimum(level, (distance.from_rim() - _RIM_MM) / _RIM_BAND_MM)
    if component != "face":  # a face must not come as a whole: its outline is the target's
        level = np.where(core <= min(place.inner_mm, _WHOLE_MM), np.maximum(level, 1.0), level)
    whole = np.full(face.topology.n_vertices, -1.0)
    whole[: face.n_skin] = np.maximum(level, -1.0)
    whole.flags.writeable = False
    return whole


@lru_cache(maxsize=16)
def component_freedom(face: Face, component: str) -> NDArray[np.float64]:
    """Return how much each vertex follows when a component moves.

    Parameters
    ----------
    face : Face
        See `component_level`.
    component : str
        One of `COMPONENTS`.

    Returns
    -------
    ndarray of shape (V,), float64
        1 within the component and far from others' lips and lids, 0 at those. Eyes, teeth and the like follow as the
        skin nearest to them does, and not at all with brows and noses.

    Raises
    ------
    ValueRangeError, TopologyError
        See `component_level`.
    """
    level, held = component_level(face, component), _HELD[component]
    free = np.ones(face.topology.n_vertices)
    if held:
        distance = _SkinDistance(face).from_masks(*held)
        share = np.clip((distance - _HELD_MM) / (_FREE_MM - _HELD_MM), 0.0, 1.0)
        n = face.n_skin
        free[:n] = np.maximum(share * share * (3.0 - 2.0 * share), np.clip(level[:n], 0.0, 1.0))
        _, nearest = cKDTree(face.mean_shape[:n]).query(face.mean_shape[n:])
        free[n:] = 0.0 if component in ("brows", "nose") else free[nearest]
    free.flags.writeable = False
    return free


class _SkinDistance:
    """Distances along the skin of a generic neutral, millimetres."""

    def __init__(self, face: Face) -> None:
        self._face = face
        skin = face.skin()
        self._n = skin.topology.n_vertices
        self._graph = path_graph(skin.mean_shape, skin.topology.faces)

    def from_masks(self, *names: str) -> NDArray[np.float64]:
        """Return the distance (V_skin,) from the nearest vertex of the masks."""
        ids = [self._mask(name) for name in names]
        return self._from(np.unique(np.concatenate(ids)))

    def from_rim(self) -> NDArray[np.float64]:
        """Return the distance (V_skin,) from the skin round the region of the face: zero there."""
        outside = np.setdiff1d(np.arange(self._n), self._mask("face_region"))
        if len(outside):  # the largest piece: the insides of lips and nostrils may be outside the region as well
            _, labels = connected_components(self._graph[outside][:, outside], directed=False)
            outside = outside[labels == np.argmax(np.bincount(labels))]
        return self._from(outside)

    def _mask(self, name: str) -> NDArray[np.int32]:
        ids = self._face.topology.masks.get(name)
        if ids is None or not len(ids):
            raise TopologyError(f"topology {self._face.topology.name!r} must have a mask {name!r}, got none.")
        return ids[ids < self._n]

    def _from(self, ids: NDArray[np.integer]) -> NDArray[np.float64]:
        if not len(ids):
            return np.full(self._n, np.inf)
        return np.asarray(dijkstra(self._graph, indices=ids, min_only=True))


@dataclass(frozen=True, eq=False)
class SkinPixels:
    """What the pixels of a picture see of a face's skin, and its openings.

    Parameters
    ----------
    fragments : Fragments
        Of the skin's front side.
    faces : ndarray of shape (F, 3)
        The skin's triangles.
    openings : ndarray of shape (H, W), bool
        Pixels between lips or lids: enclosed by skin, not skin.
    facing : ndarray of shape (V_skin,)
        Cosine between each vertex's normal and its ray to the camera.
    """

    fragments: Fragments
    faces: NDArray[np.int32]
    openings: NDArray[np.bool_]
    facing: NDArray[np.float64]

    @classmethod
    def of(cls, face: Face, view: MeshView, size: tuple[int, int]) -> SkinPixels:
        """Rasterise the skin of a face as a view shows it."""
        skin = face.skin().topology
        n = skin.n_vertices
        fragments = rasterise(
            view.pixels[:n], view.depth[:n], skin.faces, size, perspective=view.perspective, cull_back_faces=True
        )
        covered = fragments.covered
        openings = ndimage.binary_fill_holes(covered) & ~covered
        return cls(fragments, skin.faces, openings, facing_camera(view, face))

    def interpolate(self, attributes: NDArray[np.floating]) -> NDArray[np.float32]:
        """Interpolate attributes (V, C) of the skin's vertices to (H, W, C); 0 where no skin is seen."""
        return self.fragments.interpolate(self.faces, np.asarray(attributes)[: len(self.facing)])


def facing_camera(view: MeshView, face: Face) -> NDArray[np.float64]:
    """Return the cosine between each skin vertex's normal and its ray to the camera, (V_skin,)."""
    skin = face.skin().topology
    seen = view.camera_vertices[: skin.n_vertices]
    normals = vertex_normals(seen, skin.faces)
    if not view.perspective:
        return np.asarray(-normals[:, 2])
    return np.asarray(-(normals * seen).sum(axis=1) / np.maximum(np.linalg.norm(seen, axis=1), 1e-9))


def component_pixels(pixels: SkinPixels, level: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the level of a component in a picture.

    Parameters
    ----------
    pixels : SkinPixels
        Of the view.
    level : ndarray of shape (V,)
        From `component_level`.

    Returns
    -------
    ndarray of shape (H, W), float32
        Interpolated over the skin; -1 where none is seen. An opening belongs to the component (level 2) where the skin
        around it does, on average over its border, and to nothing (-1) else.
    """
    picture = pixels.interpolate(np.asarray(level)[:, None])[..., 0]
    picture[~pixels.fragments.covered] = -1.0
    labels, count = ndimage.label(pixels.openings, np.ones((3, 3)))
    if count:
        around = ndimage.grey_dilation(labels, size=(3, 3)) * pixels.fragments.covered
        border = ndimage.mean(picture, around, np.arange(1, count + 1))
        inside = np.concatenate([[False], border >= 0.5])
        picture[inside[labels] & pixels.openings] = 2.0
    return picture
