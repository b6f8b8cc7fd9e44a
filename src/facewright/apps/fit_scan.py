"""A scan of a head becomes a mesh of the template's topology: parameters, mesh, texture, error map."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingExtraError, NoFaceError, ValueRangeError
from facewright.numeric.check import check_choice

if TYPE_CHECKING:
    from facewright.apps.find_in_scan import FoundFace
    from facewright.faces.face import Face
    from facewright.fitting.scan import ScanFit
    from facewright.imaging.scan_views import ScanViewer
    from facewright.io.mesh_data import MeshData
    from facewright.numeric.similarity import Similarity

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]

_STAGES = 6
#: A fit is nonsense beyond these: distance of matched vertices from the scan and of landmarks (RMS), and the least
#: share of the face's vertices with a point of the scan.
_MOST_RMS_MM, _MOST_LANDMARK_MM, _LEAST_MATCHED = 2.0, 8.0, 0.4
#: Colours are taken from a scan within this distance, mm.
_TEXTURE_REACH_MM = 6.0
_PICTURES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True)
class FitScanRequest:
    """What to fit and where to write.

    Parameters
    ----------
    mesh : Path
        The scan: ``.obj`` or ``.ply`` with triangles.
    out : Path
        Folder for the results; made where it does not exist.
    face : str
        Template, see `facewright.faces.load_face`.
    landmarks : Path, optional
        Points placed on the scan (``.ljson``, ``.json``, ``.csv``): 74, 68 or 5 of three coordinates, in the scan's
        frame. The detector is then not asked, but for what five points leave open, if it is installed.
    texture : Path, optional
        The scan's texture; what its material names, else a picture beside it of the same name, where absent.
    unit : str
        ``"auto"``, ``"mm"``, ``"cm"``, ``"m"`` or ``"in"``.
    frame : {"scan", "model"}
        Where the written mesh lies: on the scan, in its frame and unit, or upright in model space in mm.
    region : {"face", "head"}
        What is matched: the face in front of ears and hair line, or the whole skin (bald or capped heads).
    texture_size : int
        Side of the texture, pixels.
    task_file : Path, optional
        MediaPipe ``face_landmarker.task`` file, for MediaPipe releases without the built-in face mesh.
    """

    mesh: Path
    out: Path
    face: str = "builtin"
    landmarks: Path | None = None
    texture: Path | None = None
    unit: str = "auto"
    frame: str = "scan"
    region: str = "face"
    texture_size: int = 1024
    task_file: Path | None = None

    def __post_init__(self) -> None:
        check_choice("unit", self.unit, ("auto", "mm", "cm", "m", "in"))
        check_choice("frame", self.frame, ("scan", "model"))
        check_choice("region", self.region, ("face", "head"))
        if not 16 <= self.texture_size <= 8192:
            raise ValueRangeError(f"texture_size must be in [16, 8192], got {self.texture_size}.")


@dataclass(frozen=True, eq=False)
class FitScanResult:
    """A fitted scan and what was written.

    Parameters
    ----------
    fit : ScanFit
        The fit of the skin.
    vertices : ndarray of shape (V, 3), float64, millimetres
        All parts of the face, in model space.
    found : FoundFace
        Unit, pose and landmarks.
    scan_from_model : Similarity
        From model space to the scan's frame and unit.
    paths : mapping of str to Path
        ``parameters``, ``landmarks``, ``obj``, ``picture``, and ``texture`` where the scan has colours.
    """

    fit: ScanFit
    vertices: Array
    found: FoundFace
    scan_from_model: Similarity
    paths: dict[str, Path]


def fit_scan(request: FitScanRequest, progress: Progress | None = None) -> FitScanResult:
    """Fit the template to a scan and write what was found.

    Parameters
    ----------
    request : FitScanRequest
        Scan, folder and options.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    FitScanResult
        The fit and the files: ``fit.json``, ``landmarks.json`` (the points that were fitted, to correct and give
        again), ``face.obj``, ``texture.png`` where the scan has colours, ``fit.png`` (scan, mesh, mesh over scan and
        distances from three sides); all of them or none.

    Raises
    ------
    NoFaceError
        If no face is found, or the fit is not good enough to be one.
    ValueRangeError
        If the face is not of human size.
    FileFormatError, StoreError
        If a file is missing, corrupt, foreign or cannot be written.
    MissingExtraError
        If the detector is needed and not installed.
    """
    from facewright.apps.scan_sheet import scan_sheet
    from facewright.faces.attach_parts import parts_attacher
    from facewright.faces.load import load_face
    from facewright.fitting.scan import ScanFitOptions, ScanFitter
    from facewright.fitting.scan_placement import scan_target
    from facewright.imaging.scan_views import ScanViewer
    from facewright.io.atomic import write_set_atomically
    from facewright.io.image import write_image

    def report(stage: str, done: int) -> None:
        if progress is not None:
            progress(stage, done, _STAGES)

    report("reading", 0)
    mesh = read_scan(request.mesh)
    picture, picture_path = _read_texture(request, mesh)
    face = load_face(request.face)
    viewer = ScanViewer(mesh, picture)
    with write_set_atomically(request.out) as folder:  # before the work: tells at once where it cannot be made
        found = _find(request, viewer, face, progress)
        report("fitting", 2)
        target = scan_target(mesh.vertices, mesh.faces, found.placement, found.landmarks, found.confidence)
        fit = ScanFitter(face, ScanFitOptions(region=request.region)).fit_neutral(target)
        check_fit(fit)
        vertices = parts_attacher(face).neutral(fit.vertices)
        scan_from_model = _scan_from_model(found, fit)
        report("writing the mesh", 3)
        texture = _bake(request, face, mesh, picture, scan_from_model.apply(vertices), scan_from_model.scale)
        names = _write_mesh(request, folder, face, texture, vertices, scan_from_model)
        report("drawing", 4)
        names["picture"] = "fit.png"
        sheet = scan_sheet(viewer, face, vertices, fit, target, scan_from_model, texture)
        write_image(folder / names["picture"], sheet)
        names |= _write_parameters(request, folder, face, fit, found, scan_from_model, picture_path)
    report("done", _STAGES)
    paths = {key: request.out / name for key, name in names.items()}
    return FitScanResult(fit, vertices, found, scan_from_model, paths)


def read_scan(path: Path) -> MeshData:
    """Read a scan: ``.obj`` or ``.ply``, with triangles and finite vertices.

    Raises
    ------
    FileFormatError
        If it is of another kind, corrupt, or has no triangles.
    StoreError
        If it cannot be read.
    """
    from facewright.io.obj import read_obj
    from facewright.io.ply import read_ply

    readers = {".obj": read_obj, ".ply": read_ply}
    if path.suffix.lower() not in readers:
        raise FileFormatError(f"{path} must be a mesh ending in .obj or .ply.")
    mesh = readers[path.suffix.lower()](path)
    if not len(mesh.faces):
        raise FileFormatError(
            f"{path} must hold a surface, got {mesh.n_vertices} points without triangles: reconstruct one first."
        )
    return mesh


def check_fit(fit: ScanFit) -> None:
    """Refuse a fit that cannot be a face's.

    Raises
    ------
    NoFaceError
        If too little of the face lies on the scan, or too far from it; the message says what.
    """
    report = fit.report
    share, rms = float(report["matched_share"]), float(report["stage2_rms_mm"])
    landmarks = float(report["landmark_rms_mm"])
    hint = "check landmarks and unit, or give a scan that shows the whole face"
    if not share >= _LEAST_MATCHED:
        raise NoFaceError(
            f"the scan must hold at least {100 * _LEAST_MATCHED:.0f} % of the face, got {100 * share:.0f} %: {hint}."
        )
    if not rms <= _MOST_RMS_MM:
        raise NoFaceError(
            f"the fitted face must lie within {_MOST_RMS_MM:g} mm of the scan (RMS), got {rms:.1f} mm: {hint}."
        )
    if landmarks > _MOST_LANDMARK_MM:
        raise NoFaceError(
            f"the fitted face must lie within {_MOST_LANDMARK_MM:g} mm of the landmarks (RMS), "
            f"got {landmarks:.1f} mm: {hint}."
        )


def fit_parameters(
    request: FitScanRequest, face: Face, fit: ScanFit, found: FoundFace, scan_from_model: Similarity
) -> dict[str, Any]:
    """Return all parameters of a fit as JSON values."""
    from facewright.fitting.scan_placement import UNITS

    unit = found.placement.unit
    return {
        "format": "facewright scan fit",
        "version": 1,
        "scan": str(request.mesh),
        "face": face.name,
        "topology": face.topology.fingerprint,
        "unit": unit,
        "millimetres_per_unit": UNITS[unit],
        "unit_given": request.unit != "auto",
        "mesh_frame": request.frame,
        "mesh_unit": unit if request.frame == "scan" else "mm",
        "scan_from_model": {
            "meaning": "x_scan = scale * rotation @ x_model + translation; model: mm, y up, face along +z, left is +x",
            "scale": scan_from_model.scale,
            "rotation": scan_from_model.rotation.tolist(),
            "translation": scan_from_model.translation.tolist(),
        },
        "size": found.placement.size,
        "identity_coefficients": fit.coefficients.tolist(),
        "residuals": {key: _number(value) for key, value in fit.report.items()},
        "region": request.region,
        "landmarks": {
            "scheme": "fw74",
            "from": "detector" if request.landmarks is None else str(request.landmarks),
            "looks": found.looks,
            "frame": "scan",
            "points": [None if np.isnan(p).any() else p.tolist() for p in found.landmarks],
            "confidence": found.confidence.tolist(),
        },
    }


def _number(value: float | int | str) -> float | int | str | None:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _read_texture(request: FitScanRequest, mesh: MeshData) -> tuple[NDArray[np.uint8] | None, Path | None]:
    """Return the scan's texture and where it was found, if there is one to be used."""
    from facewright.io.image import read_image

    if request.texture is not None:
        if mesh.uv_faces is None:
            raise FileFormatError(f"{request.mesh} must have texture coordinates for {request.texture}, got none.")
        return read_image(request.texture), request.texture
    if mesh.uv_faces is None:
        return None, None
    named = [] if mesh.texture is None else [mesh.texture]
    for path in [*named, *(request.mesh.with_suffix(suffix) for suffix in _PICTURES)]:
        if path.is_file():
            return read_image(path), path
    return None, None


def _find(request: FitScanRequest, viewer: ScanViewer, face: Face, progress: Progress | None) -> FoundFace:
    """Return the face by the points of a file, else by the detector; five points are completed by the detector."""
    from facewright.apps.find_in_scan import complete_by_detector, find_face, hand_placed
    from facewright.landmarks.detector import open_detector

    if request.landmarks is not None:
        from facewright.fitting.hand_landmarks import landmarks_from_points
        from facewright.io.points import read_points

        file = read_points(request.landmarks)
        if file.points.shape[1] != 3 or len(file.points) not in (74, 68, 5):
            raise FileFormatError(
                f"{request.landmarks} must hold 74, 68 or 5 points of three coordinates, got {file.points.shape}."
            )
        given = hand_placed(face, *landmarks_from_points(face, file.points, file.confidence), request.unit)
        if len(file.points) > 5:
            return given
        try:
            with open_detector(request.task_file, thorough=False) as detector:
                return complete_by_detector(viewer, face, detector, given, request.unit)
        except (MissingExtraError, NoFaceError):  # five points are little, but all there is
            return given
    with open_detector(request.task_file, thorough=False) as detector:
        return find_face(viewer, face, detector, request.unit, progress)


def _scan_from_model(found: FoundFace, fit: ScanFit) -> Similarity:
    """Return the map from the fit's model space to the scan: pose in the placed frame, then the placement."""
    from facewright.numeric.similarity import Similarity

    pose = fit.target_from_model
    return found.placement.scan_from_model.compose(Similarity(1.0, pose.rotation, pose.translation))


def _bake(
    request: FitScanRequest,
    face: Face,
    mesh: MeshData,
    picture: NDArray[np.uint8] | None,
    in_scan: Array,
    units_per_mm: float,
) -> NDArray[np.uint8] | None:
    """Return the fitted mesh's texture, where the scan has colours and the template texture coordinates."""
    from facewright.imaging.scan_texture import bake_scan_texture

    if face.topology.uv_faces is None or (picture is None and mesh.vertex_colors is None):
        return None
    return bake_scan_texture(
        mesh,
        picture,
        in_scan,
        face.topology,
        reach=_TEXTURE_REACH_MM * units_per_mm,
        size=request.texture_size,
        textured=np.arange(len(in_scan)) < face.n_skin,
    )


def _write_mesh(
    request: FitScanRequest,
    folder: Path,
    face: Face,
    texture: NDArray[np.uint8] | None,
    vertices: Array,
    scan_from_model: Similarity,
) -> dict[str, str]:
    """Write mesh and texture; returns their names."""
    from facewright.io.image import write_image
    from facewright.io.obj import write_obj

    names = {"obj": "face.obj"}
    if texture is not None:
        names["texture"] = "texture.png"
        write_image(folder / names["texture"], texture)
    where = "the scan's frame and unit" if request.frame == "scan" else "model space, millimetres"
    write_obj(
        folder / names["obj"],
        scan_from_model.apply(vertices) if request.frame == "scan" else vertices,
        face.topology.faces,
        uv=face.topology.uv,
        uv_faces=face.topology.uv_faces,
        texture=names.get("texture"),
        comment=f"facewright: face fitted to {request.mesh.name}, in {where}",
    )
    return names


def _write_parameters(
    request: FitScanRequest,
    folder: Path,
    face: Face,
    fit: ScanFit,
    found: FoundFace,
    scan_from_model: Similarity,
    picture_path: Path | None,
) -> dict[str, str]:
    """Write parameters and landmarks; returns their names."""
    from facewright.io.atomic import write_atomically
    from facewright.io.points import write_points

    names = {"parameters": "fit.json", "landmarks": "landmarks.json"}
    parameters = fit_parameters(request, face, fit, found, scan_from_model)
    parameters["texture"] = None if picture_path is None else str(picture_path)
    write_points(folder / names["landmarks"], found.landmarks, "fw74", found.confidence)
    text = json.dumps(parameters, indent=1, allow_nan=False) + "\n"
    with write_atomically(folder / names["parameters"]) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return names
