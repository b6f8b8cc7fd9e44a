"""Pictures of a scan from any direction, with depth: what a landmark detector looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import Intrinsics
from facewright.errors import DegenerateError, ShapeError
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.imaging.render import Albedo, render_mesh
from facewright.imaging.texture import sample_bilinear, texels_from_uv
from facewright.io.mesh_data import MeshData
from facewright.mesh.normals import face_area_vectors
from facewright.numeric.check import check_finite, check_shape

#: The camera stands this many radii from the middle of what it looks at: a portrait's perspective.
_DISTANCE = 5.0
#: What is nearer to the camera than this many radii before the middle is cut away: it would hide the rest.
_NEAR = 1.5
#: Area of all triangles, in squared radii, beyond which they are no surface; a sphere has 13, a head and shoulders 10.
_MOST_AREA = 300.0
#: sRGB of a scan without colours: detectors know skin better than plaster.
_SKIN = (0.80, 0.62, 0.52)


@dataclass(frozen=True, eq=False)
class ScanView:
    """One picture of a scan.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        sRGB picture.
    depth : ndarray of shape (H, W), float32, the scan's unit
        Distance along the optical axis; 0 where the picture shows nothing.
    intrinsics : Intrinsics
        The camera.
    camera_from_scan : tuple of ndarray (3, 3) and ndarray (3,)
        R and t: a point x of the scan is at R x + t in the camera's frame (x right, y down, z away), the scan's unit.
    """

    image: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: Intrinsics
    camera_from_scan: tuple[NDArray[np.float64], NDArray[np.float64]]

    def to_scan(self, camera_points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return points (..., 3) of the camera's frame in the scan's frame."""
        rotation, translation = self.camera_from_scan
        return np.asarray((np.asarray(camera_points) - translation) @ rotation)


class ScanViewer:
    """Renders one scan many times.

    Parameters
    ----------
    mesh : MeshData
        The scan, with triangles; of any unit and orientation.
    texture : ndarray of shape (H, W, 3), uint8, optional
        Its sRGB texture; vertex colours, else a skin tone, where absent.

    Raises
    ------
    DegenerateError
        If the scan has no triangles, no extent, or triangles that are no surface.
    ShapeError
        If there is a texture and the scan has no texture coordinates.
    """

    def __init__(self, mesh: MeshData, texture: NDArray[np.uint8] | None = None) -> None:
        check_finite("vertices", mesh.vertices)
        if not len(mesh.faces):
            raise DegenerateError("a scan must have triangles to be seen, got points only.")
        self.vertices = np.asarray(mesh.vertices, dtype=np.float64)
        self.faces = mesh.faces
        used = self.vertices[np.unique(mesh.faces)]
        #: Middle (3,) and radius of most of the scan, the scan's unit: spikes and lost pieces do not count.
        self.middle = np.median(used, axis=0)
        self.radius = float(np.percentile(np.linalg.norm(used - self.middle, axis=1), 97))
        if not self.radius > 0:
            raise DegenerateError("a scan must have an extent, got one point.")
        area = 0.5 * np.linalg.norm(face_area_vectors(self.vertices / self.radius, mesh.faces), axis=1).sum()
        if area > _MOST_AREA:
            raise DegenerateError(
                f"a scan's triangles must form a surface, got {len(mesh.faces)} that lie across one another: together "
                f"{area:.0f} squared radii of the scan (a head has about 10)."
            )
        self._albedo = scan_albedo(mesh, texture)

    def view(
        self,
        view_from_scan: NDArray[np.floating],
        *,
        middle: NDArray[np.floating] | None = None,
        radius: float | None = None,
        size: int = 320,
        supersample: int = 1,
    ) -> ScanView:
        """Render the scan.

        Parameters
        ----------
        view_from_scan : ndarray of shape (3, 3)
            Rotation after which the viewer sees x to the right, y up and looks along -z: as model space is seen.
        middle : ndarray of shape (3,), optional
            Point of the scan in the middle of the picture; that of the scan where absent.
        radius : float, optional
            What fits between the middle and the picture's edge, the scan's unit; that of the scan where absent.
        size : int
            Side of the picture, pixels.
        supersample : int
            Samples per pixel side.
        """
        check_shape("view_from_scan", view_from_scan, 3, 3)
        centre = self.middle if middle is None else np.asarray(middle, dtype=np.float64)
        reach = self.radius if radius is None else float(radius)
        turn = np.diag([1.0, -1.0, -1.0]) @ view_from_scan
        translation = np.array([0.0, 0.0, _DISTANCE * reach]) - turn @ centre
        seen = self.vertices @ turn.T + translation
        near = (_DISTANCE - _NEAR) * reach
        shown = seen[:, 2] > near
        focal = 0.5 * size * _DISTANCE / 1.05
        camera = Intrinsics(focal, focal, (size - 1) / 2, (size - 1) / 2)
        pixels = camera.project(np.where(shown[:, None], seen, [0.0, 0.0, near]))
        faces = self.faces
        chosen = None
        if not shown.all():
            chosen = np.flatnonzero(shown[faces].all(axis=1))
            faces = faces[chosen]
        if not len(faces):
            blank = np.full((size, size, 3), 240, np.uint8)
            return ScanView(blank, np.zeros((size, size), np.float32), camera, (turn, translation))
        albedo = self._albedo if chosen is None or not callable(self._albedo) else _of_some(self._albedo, chosen)
        image = render_mesh(
            seen / reach, pixels, faces, (size, size), albedo=albedo, shininess=0.05, supersample=supersample
        ).image
        depth = rasterise(pixels, seen[:, 2], faces, (size, size)).depth
        return ScanView(image, np.where(np.isfinite(depth), depth, 0.0), camera, (turn, translation))


def scan_albedo(mesh: MeshData, texture: NDArray[np.uint8] | None = None) -> Albedo:
    """Return the surface colour of a scan for `render_mesh`: texture, else vertex colours, else a skin tone.

    Raises
    ------
    ShapeError
        If there is a texture and the scan has no texture coordinates.
    """
    if texture is not None:
        if mesh.uv is None or mesh.uv_faces is None:
            raise ShapeError("a scan with a texture must have texture coordinates, got none.")
        positions = texels_from_uv(mesh.uv, (texture.shape[0], texture.shape[1]))
        scaled = texture.astype(np.float32) / 255.0
        uv_faces = mesh.uv_faces

        def albedo(fragments: Fragments) -> NDArray[np.float32]:
            out = np.zeros((*fragments.face_index.shape, 3), np.float32)
            covered = fragments.covered
            out[covered] = sample_bilinear(scaled, fragments.interpolate(uv_faces, positions)[covered])
            return out

        return albedo
    if mesh.vertex_colors is not None:
        return mesh.vertex_colors.astype(np.float64) / 255.0
    return np.tile(np.array(_SKIN), (mesh.n_vertices, 1))


def _of_some(albedo: Albedo, chosen: NDArray[np.integer]) -> Albedo:
    """Return an albedo for a picture in which only some of the triangles were drawn."""
    assert callable(albedo)

    def of_all(fragments: Fragments) -> NDArray[np.floating]:
        index = np.where(fragments.covered, chosen[fragments.face_index], -1).astype(np.int32)
        return albedo(Fragments(index, fragments.barycentric, fragments.depth))

    return of_all


def axis_rotations() -> list[NDArray[np.float64]]:
    """Return the 24 rotations that map axes to axes, likelier frames of scans first (y up, then z up)."""
    eye = np.eye(3)
    found = []
    # up axis of the scan, then the axis that the face looks along
    for up in ((1, 1), (2, 1), (1, -1), (2, -1), (0, 1), (0, -1)):
        for front in ((2, 1), (1, -1), (2, -1), (1, 1), (0, 1), (0, -1)):
            if up[0] == front[0]:
                continue
            y, z = up[1] * eye[up[0]], front[1] * eye[front[0]]
            found.append(np.stack([np.cross(y, z), y, z]))
    return found


def even_rotations(n: int) -> list[NDArray[np.float64]]:
    """Return `n` rotations spread evenly (super-Fibonacci spirals, Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(n) + 0.5
    r, R = np.sqrt(s / n), np.sqrt(1.0 - s / n)
    a, b = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = np.stack([r * np.sin(a), r * np.cos(a), R * np.sin(b), R * np.cos(b)], axis=1)
    return [_rotation(q) for q in quaternions]


def _rotation(q: NDArray[np.float64]) -> NDArray[np.float64]:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
