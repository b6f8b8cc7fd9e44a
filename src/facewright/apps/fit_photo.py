"""A photograph becomes a 3D face: parameters, mesh, rig with the photo as texture, and an overlay picture."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import NoFaceError, ValueRangeError

if TYPE_CHECKING:
    from facewright.fitting.image import PhotoFit, PhotoFitOptions
    from facewright.landmarks.points import Landmarks

Progress = Callable[[str, int, int], None]

_STAGES = 6


@dataclass(frozen=True)
class FitPhotoRequest:
    """What to fit and where to write.

    Parameters
    ----------
    photo : Path
        The photograph, of any common format.
    model : Path
        Model file, see `facewright.apps.build_model`.
    out : Path
        Folder for the results; made where it does not exist.
    landmarks : Path, optional
        Points file (``.pts``, ``.ljson``, ``.json``). Its points win over detected ones, point by point; without the
        detector they are all there is.
    detect : bool
        Whether to run the landmark detector; without it `landmarks` must be given.
    task_file : Path, optional
        MediaPipe ``face_landmarker.task`` file, for MediaPipe releases without the built-in face mesh.
    face_index : int
        Which of the faces found, the largest being 0.
    perspective : bool
        Refine under full perspective.
    focal_length : float, optional
        Focal length, pixels; from the EXIF data, else guessed, where absent.
    texture_size : int
        Side of the texture, pixels.
    """

    photo: Path
    model: Path
    out: Path
    landmarks: Path | None = None
    detect: bool = True
    task_file: Path | None = None
    face_index: int = 0
    perspective: bool = True
    focal_length: float | None = None
    texture_size: int = 1024

    def __post_init__(self) -> None:
        if not self.detect and self.landmarks is None:
            raise ValueRangeError("landmarks must be given where detect is off, got none.")
        if self.face_index < 0:
            raise ValueRangeError(f"face_index must not be negative, got {self.face_index}.")
        if not 16 <= self.texture_size <= 8192:
            raise ValueRangeError(f"texture_size must be in [16, 8192], got {self.texture_size}.")


@dataclass(frozen=True, eq=False)
class FitPhotoResult:
    """A fitted photo and what was written.

    Parameters
    ----------
    fit : PhotoFit
        The fit itself.
    n_faces : int
        Faces that the detector found; 0 where it did not run.
    fit_ms : float
        Time of the fit with its mesh, without detector, compilation and files.
    paths : mapping of str to Path
        ``parameters``, ``landmarks``, ``obj``, ``glb``, ``texture``, ``overlay``.
    """

    fit: PhotoFit
    n_faces: int
    fit_ms: float
    paths: dict[str, Path]


def fit_photo(request: FitPhotoRequest, progress: Progress | None = None) -> FitPhotoResult:
    """Fit the face in a photograph and write what was found.

    Parameters
    ----------
    request : FitPhotoRequest
        Photo, model, folder and options.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    FitPhotoResult
        The fit and the files: ``fit.json``, ``landmarks.json`` (the points that were fitted, to correct and give
        again), ``face.obj`` (as in the photo), ``face.glb`` (rig of the person, standing at the photo's expression,
        textured by the photo), ``texture.png``, ``overlay.png``; all of them or none.

    Raises
    ------
    NoFaceError
        If no face was found, or fewer than `face_index` asks for.
    FileFormatError, StoreError
        If a file is missing, corrupt, foreign or cannot be written.
    MissingExtraError
        If the detector is needed and not installed.
    DegenerateError
        If too few landmarks are known.
    """
    from facewright.fitting.image import PhotoFitOptions, PhotoFitter
    from facewright.io.atomic import write_set_atomically
    from facewright.io.image import read_focal_length, read_image
    from facewright.models.bilinear_store import load_bilinear

    report = _reporter(progress)
    report("reading", 0)
    photo = read_image(request.photo)
    focal = request.focal_length if request.focal_length is not None else read_focal_length(request.photo)
    given = _given_landmarks(request)
    model = load_bilinear(request.model)
    with write_set_atomically(request.out) as folder:  # before the work: tells at once where it cannot be made
        report("finding landmarks", 1)
        landmarks, n_faces = _find_landmarks(request, photo, given)
        _check_in_picture(request, landmarks, photo)
        report("fitting", 2)
        options = PhotoFitOptions(perspective=request.perspective, focal_length=focal)
        fitter = PhotoFitter(model)
        size = (photo.shape[0], photo.shape[1])
        fitter.fit(landmarks, size, options)  # compiles
        start = time.perf_counter()
        fit = fitter.fit(landmarks, size, options)
        fit_ms = 1e3 * (time.perf_counter() - start)
        names = _write_results(request, folder, photo, fit, options, fit_ms, n_faces, report)
    report("done", _STAGES)
    return FitPhotoResult(fit, n_faces, fit_ms, {key: request.out / name for key, name in names.items()})


def fit_parameters(fit: PhotoFit) -> dict[str, Any]:
    """Return all parameters of a fit as JSON values; arrays as lists, angles in degrees where the name says so.

    ``blendshapes`` holds the weights in [0, 1] by which the displacements of the shapes are added to the neutral, which
    itself is implicit: it always counts once.
    """
    names = fit.model.expression_names
    yaw, pitch, roll = fit.head_angles_degrees
    beta = fit.blendshape_weights
    parameters: dict[str, Any] = {
        "format": "facewright photo fit",
        "version": 1,
        "model": {
            "topology": fit.model.topology.fingerprint,
            **dict(fit.model.provenance),
            "model_id": fit.model.model_id,
        },
        "image_size": list(fit.image_size),
        "identity_weights": fit.identity_weights.tolist(),
        "expression_weights": fit.expression_weights.tolist(),
        "blendshapes": {name: float(weight) for name, weight in zip(names[1:], beta)},
        "head_degrees": {"yaw": yaw, "pitch": pitch, "roll": roll},
        "weak_perspective": {
            "scale": fit.weak_camera.scale,
            "rotation": fit.weak_camera.rotation.tolist(),
            "translation": fit.weak_camera.translation.tolist(),
        },
        "pinhole": None,
        "reprojection_iod": fit.reprojection_iod,
        "landmarks": {
            "scheme": fit.landmarks.scheme,
            "points": _rows(fit.landmarks.points),
            "confidence": fit.landmarks.confidence.tolist(),
            "fitted": _rows(fit.reprojection),
        },
    }
    if fit.intrinsics is not None and fit.camera_from_model is not None:
        parameters["pinhole"] = {
            "focal_length": fit.intrinsics.focal_x,
            "centre": [fit.intrinsics.centre_x, fit.intrinsics.centre_y],
            "rotation": fit.camera_from_model.rotation.tolist(),
            "translation_mm": fit.camera_from_model.translation.tolist(),
        }
    return parameters


def overlay_picture(photo: NDArray[np.uint8], fit: PhotoFit, size: int = 900) -> NDArray[np.uint8]:
    """Return photo, landmarks (found: green, fitted: red), mesh lines and shaded mesh side by side.

    Parameters
    ----------
    photo : ndarray of shape (H, W, 3), uint8
        The photo.
    fit : PhotoFit
        Its fit.
    size : int
        Side of each of the four pictures, pixels.
    """
    from facewright.imaging.overlay import crop_around, draw_mesh_lines, draw_points, draw_shaded
    from facewright.landmarks.contour import face_region

    topology = fit.model.topology
    n_skin = topology.part_slice("face", "head_and_neck").stop
    skin = topology.submesh(n_skin)
    seen, pixels = fit.camera_points(fit.vertices[:n_skin]), fit.project(fit.vertices[:n_skin])
    region = np.zeros(n_skin, dtype=bool)
    region[face_region(skin, fit.model.mean_face[:n_skin])] = True
    shown, origin, zoom = crop_around(photo, pixels[region], height=size, margin=0.1)

    def moved(points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        return (np.asarray(points) + 0.5 - origin) * zoom - 0.5

    perspective = fit.intrinsics is not None
    found = draw_points(shown, moved(fit.landmarks.points), radius=size / 220)
    marked = draw_points(found, moved(fit.reprojection), (230, 40, 60), size / 320)
    polygons = skin.faces if skin.quads is None else skin.quads
    within = np.append(region, True)[polygons].all(axis=1)  # -1 pads a triangle
    lines = draw_mesh_lines(
        shown,
        moved(pixels),
        seen[:, 2],
        skin.faces,
        polygons[within],
        opacity=0.6,
        width=size / 900,
        perspective=perspective,
    )
    plaster = np.full((n_skin, 3), 0.81)
    plaster[skin.masks.get("nostrils", [])] = 0.35  # light does not get in there
    plaster[skin.masks.get("nostril_insides", [])] = 0.12
    fade = _faded_region(seen, skin.faces, region)
    shaded = draw_shaded(shown, seen, moved(pixels), skin.faces, fade, albedo=plaster, perspective=perspective)
    return np.vstack([np.hstack([shown, marked]), np.hstack([lines, shaded])])


def _faded_region(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    region: NDArray[np.bool_],
    fade_mm: float = 8.0,
) -> NDArray[np.float64]:
    """Return 1 inside the region, falling smoothly to 0 within `fade_mm` along the surface beyond it, shape (V,)."""
    from scipy import sparse
    from scipy.sparse.csgraph import dijkstra

    from facewright.mesh.connectivity import vertex_adjacency
    from facewright.mesh.geodesics import path_graph

    graph = path_graph(vertices, faces)
    away = dijkstra(graph, indices=np.flatnonzero(region), min_only=True, limit=4 * fade_mm)
    weight = 1 - np.clip(away / fade_mm, 0, 1)
    neighbours = vertex_adjacency(faces, len(vertices)).astype(np.float64) + sparse.eye(len(vertices))
    mean = sparse.diags(1 / np.asarray(neighbours.sum(axis=1)).ravel()) @ neighbours
    for _ in range(4):  # the region ends in steps of whole triangles
        weight = mean @ weight
    return np.asarray(weight * weight * (3 - 2 * weight))


def _reporter(progress: Progress | None) -> Callable[[str, int], None]:
    def report(stage: str, done: int) -> None:
        if progress is not None:
            progress(stage, done, _STAGES)

    return report


def _given_landmarks(request: FitPhotoRequest) -> Landmarks | None:
    if request.landmarks is None:
        return None
    from facewright.landmarks.files import read_landmarks

    return read_landmarks(request.landmarks)


def _find_landmarks(
    request: FitPhotoRequest, photo: NDArray[np.uint8], given: Landmarks | None
) -> tuple[Landmarks, int]:
    """Return the landmarks to fit to, in scheme ``fw74``, and the number of faces that were found."""
    if not request.detect:
        assert given is not None
        return given.convert("fw74"), 0
    from facewright.landmarks.detector import open_detector

    with open_detector(request.task_file) as detector:
        faces = detector.detect(photo)
    if not faces and given is None:
        raise NoFaceError(f"{request.photo} must show a face, the detector found none.")
    if given is not None:
        by_hand = given.convert("fw74")
        return (_nearest(faces, by_hand).overridden_by(by_hand) if faces else by_hand), len(faces)
    if request.face_index >= len(faces):
        raise NoFaceError(
            f"{request.photo} must show at least {request.face_index + 1} faces for face {request.face_index}, "
            f"the detector found {len(faces)}."
        )
    return faces[request.face_index].convert("fw74"), len(faces)


def _check_in_picture(request: FitPhotoRequest, landmarks: Landmarks, photo: NDArray[np.uint8]) -> None:
    """Refuse landmarks of another picture: most of a face lies in its own."""
    height, width = photo.shape[:2]
    points = landmarks.points[landmarks.present]
    inside = ((points >= -0.5) & (points <= (width - 0.5, height - 0.5))).all(axis=1)
    if inside.mean() < 1 / 3:
        raise ValueRangeError(
            f"landmarks must lie in the picture they belong to: {request.photo} is {width} x {height} pixels, "
            f"and {int((~inside).sum())} of {len(points)} points of {request.landmarks} lie outside."
        )


def _nearest(faces: list[Landmarks], by_hand: Landmarks) -> Landmarks:
    """Return the detected face that points from a file belong to."""
    detected = [face.convert("fw74") for face in faces]
    present = by_hand.present
    distance = [np.nanmean(np.linalg.norm(face.points[present] - by_hand.points[present], axis=1)) for face in detected]
    return detected[int(np.argmin(distance))]


def _write_results(
    request: FitPhotoRequest,
    folder: Path,
    photo: NDArray[np.uint8],
    fit: PhotoFit,
    options: PhotoFitOptions,
    fit_ms: float,
    n_faces: int,
    report: Callable[[str, int], None],
) -> dict[str, str]:
    """Write all results into `folder`; returns what each file is, and its name."""
    from facewright.io.atomic import write_atomically
    from facewright.io.image import write_image
    from facewright.io.obj import write_obj
    from facewright.landmarks.files import write_landmarks

    names = {"parameters": "fit.json", "landmarks": "landmarks.json", "obj": "face.obj"}
    topology = fit.model.topology
    texture = None
    report("baking the texture", 3)
    if topology.uv is not None and topology.uv_faces is not None:
        texture = _texture(photo, fit, request.texture_size)
        names["texture"] = "texture.png"
        write_image(folder / names["texture"], texture)
    report("writing the mesh", 4)
    write_obj(
        folder / names["obj"],
        fit.vertices,
        topology.faces,
        uv=topology.uv if texture is not None else None,
        uv_faces=topology.uv_faces if texture is not None else None,
        texture=None if texture is None else "texture.png",
        comment=f"facewright: face fitted to {request.photo.name}, millimetres",
    )
    names["glb"] = "face.glb"
    _write_rig(folder / names["glb"], fit, texture)
    report("drawing the overlay", 5)
    names["overlay"] = "overlay.png"
    write_image(folder / names["overlay"], overlay_picture(photo, fit))
    parameters = fit_parameters(fit)
    parameters |= {"photo": str(request.photo), "n_faces": n_faces, "fit_ms": fit_ms}
    parameters["options"] = {"perspective": options.perspective, "focal_length": options.focal_length}
    write_landmarks(folder / names["landmarks"], fit.landmarks)
    text = json.dumps(parameters, indent=1, allow_nan=False) + "\n"
    with write_atomically(folder / names["parameters"]) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return names


def _texture(photo: NDArray[np.uint8], fit: PhotoFit, size: int) -> NDArray[np.uint8]:
    from facewright.imaging.texture import bake_texture

    topology = fit.model.topology
    n_skin = topology.part_slice("face", "head_and_neck").stop
    return bake_texture(
        photo,
        fit.project(fit.vertices),
        fit.camera_points(fit.vertices),
        topology,
        size=size,
        textured=np.arange(topology.n_vertices) < n_skin,
        perspective=fit.intrinsics is not None,
    )


def _write_rig(path: Path, fit: PhotoFit, texture: NDArray[np.uint8] | None) -> None:
    """Write the person's rig: neutral, 46 named shapes, the photo as texture."""
    from facewright.apps.export import ExportRequest, export_rig
    from facewright.apps.paint_person import face_of_model, person_colors

    rig = fit.rig
    licence = str(fit.model.provenance.get("licence", ""))
    request = ExportRequest(
        rig, fit.model.topology, path, texture=texture, copyright=licence, weights=fit.blendshape_weights
    )
    colors = person_colors(face_of_model(fit.model))
    export_rig(replace(request, vertex_colors=colors))


def _rows(points: NDArray[np.floating[Any]]) -> list[list[float] | None]:
    return [[float(x), float(y)] if np.isfinite([x, y]).all() else None for x, y in points]
