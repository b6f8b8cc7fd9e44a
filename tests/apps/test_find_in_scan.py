import numpy as np
import pytest

from facewright.apps.find_in_scan import complete_by_detector, find_face, hand_placed
from facewright.camera.rotation import rotation_from_vector
from facewright.errors import NoFaceError, ValueRangeError
from facewright.imaging.scan_views import ScanViewer
from facewright.io.mesh_data import MeshData
from facewright.landmarks.points import Landmarks


class KnowsTheScan:
    """Finds what it knows where a picture shows it: stands in for a detector that needs no network."""

    def __init__(self, viewer, landmarks, front):
        self.landmarks, self.front, self.looked = landmarks, front, 0
        self._view, viewer.view = viewer.view, self._remembering(viewer.view)

    def _remembering(self, view):
        def remembered(*args, **kwargs):
            self.last = view(*args, **kwargs)
            return self.last

        return remembered

    def detect(self, image):
        self.looked += 1
        assert image is self.last.image
        R, t = self.last.camera_from_scan
        if (R @ self.front)[2] > -0.5 or R[1] @ self.up < 0.3:  # seen from the side or behind, or upside down
            return []
        seen = self.landmarks @ R.T + t
        points = self.last.intrinsics.project(seen)
        x, y = np.rint(points).astype(int).T.clip(0, len(image) - 1)
        shown = np.abs(self.last.depth[y, x] - seen[:, 2]) < 0.05 * seen[:, 2]
        return [Landmarks("fw74", points, np.where(shown, 0.3, 0.0))] if shown.sum() > 40 else []


@pytest.fixture
def few_directions(monkeypatch):
    monkeypatch.setattr("facewright.apps.find_in_scan._EVEN", 2)


@pytest.fixture
def scan(builtin_face, rng):
    """A scan in metres, its landmarks and pose."""
    face = builtin_face.skin()
    person = face.mean_shape + np.tensordot(rng.normal(size=len(face.identity_basis)), face.identity_basis, 1)
    R = rotation_from_vector(rng.normal(size=3))
    vertices = 0.001 * person @ R.T + rng.normal(size=3)
    return MeshData(vertices, face.topology.faces), vertices[face.topology.landmarks["fw74"]], R


def detector_for(viewer, marks, R):
    detector = KnowsTheScan(viewer, marks, R @ [0, 0, 1.0])
    detector.up = -(R @ [0, 1.0, 0])
    return detector


def test_unit_and_pose_are_found(builtin_face, scan):
    mesh, marks, R = scan
    viewer = ScanViewer(mesh)
    steps = []
    found = find_face(viewer, builtin_face, detector_for(viewer, marks, R), progress=lambda *s: steps.append(s))
    assert found.placement.unit == "m"
    assert 0.9 < found.placement.size < 1.1
    assert found.looks >= 3
    turn = R.T @ found.placement.scan_from_model.rotation
    assert np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 6.0
    known = found.confidence > 0
    assert known.sum() > 35
    assert np.median(1000 * np.linalg.norm(found.landmarks - marks, axis=1)[known]) < 1.0
    assert steps[-1][1] == steps[-1][2]


def test_hand_placed_points_stay_where_the_detector_adds_others(builtin_face, scan):
    mesh, marks, R = scan
    viewer = ScanViewer(mesh)
    few = np.full((74, 3), np.nan)
    few[[31, 39, 45, 54, 60]] = marks[[31, 39, 45, 54, 60]] + 0.001
    given = hand_placed(builtin_face, few, np.isfinite(few[:, 0]).astype(float))
    full = complete_by_detector(viewer, builtin_face, detector_for(viewer, marks, R), given)
    assert (full.confidence > 0).sum() > 35
    np.testing.assert_array_equal(full.landmarks[[31, 45, 60]], few[[31, 45, 60]])
    assert full.looks >= 3


def test_without_a_face_every_direction_is_tried(builtin_face, scan, few_directions):
    mesh, marks, R = scan
    viewer = ScanViewer(mesh)
    detector = detector_for(viewer, marks, R)
    detector.detect = lambda image: []
    steps = []
    with pytest.raises(NoFaceError, match="from any direction"):
        find_face(viewer, builtin_face, detector, progress=lambda *s: steps.append(s))
    assert len(steps) == 26


def test_the_inside_of_a_mask_is_not_taken_for_a_face(builtin_face, scan, few_directions):
    """Landmarks that look right in the picture, on a surface whose depth is a face's from behind."""
    mesh, marks, R = scan
    hollow = mesh.vertices.copy()
    centre = hollow.mean(axis=0)
    front = R @ [0, 0, 1.0]
    hollow -= 2.0 * ((hollow - centre) @ front)[:, None] * front
    hollow_marks = marks - 2.0 * ((marks - centre) @ front)[:, None] * front
    viewer = ScanViewer(MeshData(hollow, mesh.faces))
    detector = detector_for(viewer, hollow_marks, R)
    detector.front = -detector.front  # it looks right from within
    with pytest.raises(NoFaceError):
        find_face(viewer, builtin_face, detector)


def test_a_doll_is_named_as_such(builtin_face, scan, few_directions):
    mesh, marks, R = scan
    viewer = ScanViewer(MeshData(0.3 * mesh.vertices, mesh.faces))
    with pytest.raises(ValueRangeError, match="size of a mean face"):
        find_face(viewer, builtin_face, detector_for(viewer, 0.3 * marks, R))


@pytest.mark.landmarks
@pytest.mark.slow
@pytest.mark.parametrize("name", ["scans/james.obj", "meshmonk/DemoFace_10K.obj"])
def test_real_scans_without_colours_in_any_pose(test_data, builtin_face, rng, name):
    pytest.importorskip("mediapipe")
    from facewright.io.obj import read_obj
    from facewright.landmarks.detector import open_detector

    mesh = read_obj(test_data / name)
    R = rotation_from_vector(rng.normal(size=3) * 2)
    turned = MeshData(mesh.vertices @ R.T / 25.4 + 100 * rng.normal(size=3), mesh.faces)
    with open_detector(thorough=False) as detector:
        found = find_face(ScanViewer(turned), builtin_face, detector)
    assert found.placement.unit == "in"
    assert 0.9 < found.placement.size < 1.1
    up = R.T @ found.placement.scan_from_model.rotation @ [0, 1, 0]
    assert up[1] > np.cos(np.deg2rad(20))  # both people sit upright, y up
