"""What the 478 detected points are on a face: vertices, and how the detector departs from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from facewright.camera.rotation import FRONTAL
from facewright.errors import TopologyError
from facewright.landmarks.scheme import load_map, load_scheme
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

#: Faces whose points were measured (tools/measure_dense_landmarks.py).
MEASURED_FACES = ("ict", "builtin")
#: Standard deviation, per coordinate, of the points of a face that was not measured, millimetres.
_UNMEASURED_MM = 1.5
#: Frames of one clip are more alike than the measured renders, which share no frame but the person: of the measured
#: standard deviation, so much is noise within a clip.
_WITHIN_CLIP = 0.67
#: Terms of the head's pose that move the detector's points; see `pose_terms`.
N_POSE_TERMS = 6


@dataclass(frozen=True, eq=False)
class DensePoints:
    """A detector's points as points of one face.

    A detected point is, in the plane of the picture and in units of the head's size, the projection of a vertex plus
    ``offset + pose_terms @ pose_response + beta @ expression_response + q @ person_modes + noise``: a detector is a
    network with habits, and these are its habits on renders of simulated people. The axes of the plane are the
    picture's, turned upright with the head; x is towards the picture's right where the head is upright, y down;
    millimetres on the face.

    Parameters
    ----------
    sources : ndarray of shape (N, 478), float64
        How each of the N points is made from the detector's.
    vertices : ndarray of shape (N,), int32
        The vertex of each.
    offset : ndarray of shape (N, 2), millimetres
        Mean departure.
    pose_response : ndarray of shape (6, N, 2), millimetres
        By `pose_terms`.
    expression_response : ndarray of shape (B, N, 2), millimetres
        By the FACS coefficients: what the detector sees more or less of than there is.
    person_modes : ndarray of shape (M, N, 2), millimetres
        How the departure differs from person to person, one standard deviation each.
    whitening : ndarray of shape (K, 2 N), float64, 1 / millimetres
        Directions that tell something of the face, in units of their noise: K independent residuals.
    blendshape_names : tuple of str
        The B shapes; empty where no response was measured.
    """

    sources: NDArray[np.float64]
    vertices: NDArray[np.int32]
    offset: NDArray[np.float64]
    pose_response: NDArray[np.float64]
    expression_response: NDArray[np.float64]
    person_modes: NDArray[np.float64]
    whitening: NDArray[np.float64]
    blendshape_names: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        sizes = check_shape("sources", self.sources, "N", load_scheme("mediapipe478").n_points)
        check_shape("vertices", self.vertices, "N", **sizes)
        check_shape("offset", self.offset, "N", 2, **sizes)
        check_shape("pose_response", self.pose_response, N_POSE_TERMS, "N", 2, **sizes)
        check_shape("expression_response", self.expression_response, len(self.blendshape_names), "N", 2, **sizes)
        check_shape("person_modes", self.person_modes, "M", "N", 2, **sizes)
        check_shape("whitening", self.whitening, "K", 2 * sizes["N"])

    @property
    def n_points(self) -> int:
        """Number of points N."""
        return len(self.vertices)


def dense_points(topology: Topology) -> DensePoints:
    """Return the detector's points on a mesh.

    Parameters
    ----------
    topology : Topology
        Of the built-in or the ICT face, with or without its inner parts; of any other, the marked ``fw74`` landmarks
        are used, without knowledge of the detector's habits.

    Raises
    ------
    TopologyError
        If the mesh is of another face and does not mark the ``fw74`` landmarks.
    """
    for name in MEASURED_FACES:
        points, fingerprints = _measured(name)
        if topology.fingerprint in fingerprints:
            return points
    return _marked(topology)


def pose_terms(rotation: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the six terms of a head's rotation (..., 3, 3) that the detector responds to, (..., 6)."""
    head = FRONTAL @ rotation
    yaw, pitch, roll = -head[..., 2, 0], -head[..., 2, 1], head[..., 0, 1]
    return np.stack([yaw, pitch, yaw * yaw - 0.1, pitch * pitch - 0.03, yaw * pitch, roll], axis=-1)


def head_plane(rotation: NDArray[np.floating], scale: float) -> NDArray[np.float64]:
    """Return the matrix (2, 2) from pixels of the picture to millimetres in the plane that is upright with the head.

    Parameters
    ----------
    rotation : ndarray of shape (3, 3)
        camera_from_model.
    scale : float
        Pixels per millimetre on the face.
    """
    down = -np.asarray(rotation, dtype=np.float64)[:2, 1]
    down = down / max(float(np.hypot(*down)), 1e-9)
    return np.array([[down[1], -down[0]], down]) / scale


@lru_cache(maxsize=2)
def _measured(name: str) -> tuple[DensePoints, tuple[str, ...]]:
    with (
        resources.files("facewright.landmarks").joinpath("data", f"dense478_{name}.npz").open("rb") as file,
        np.load(file, allow_pickle=False) as data,
    ):
        N = len(data["vertices"])
        points = DensePoints(
            sources=np.eye(load_scheme("mediapipe478").n_points)[:N],
            vertices=data["vertices"].astype(np.int32),
            offset=data["offset"].astype(np.float64),
            pose_response=data["pose_response"].astype(np.float64),
            expression_response=data["expression_response"].astype(np.float64),
            person_modes=data["person_modes"].astype(np.float64),
            whitening=data["whitening"].astype(np.float64) / _WITHIN_CLIP,
            blendshape_names=tuple(str(shape) for shape in data["blendshape_names"]),
        )
        return points, tuple(str(mark) for mark in data["fingerprints"])


def _marked(topology: Topology) -> DensePoints:
    """Return the marked landmarks of a mesh that was not measured."""
    ids = topology.landmarks.get("fw74")
    scheme = load_scheme("fw74")
    if ids is None or len(ids) != scheme.n_points or (ids[scheme.fixed] < 0).any():
        raise TopologyError(f"topology {topology.name!r} must mark the 'fw74' landmarks.")
    N = len(scheme.fixed)
    return DensePoints(
        sources=load_map("mediapipe478", "fw74").weights[scheme.fixed],
        vertices=np.asarray(ids)[scheme.fixed].astype(np.int32),
        offset=np.zeros((N, 2)),
        pose_response=np.zeros((N_POSE_TERMS, N, 2)),
        expression_response=np.zeros((0, N, 2)),
        person_modes=np.zeros((0, N, 2)),
        whitening=np.eye(2 * N) / _UNMEASURED_MM,
    )
