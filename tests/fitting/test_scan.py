"""Template fitting on depth maps of simulated people that are rendered here."""

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_angle, rotation_from_head_angles
from facewright.errors import NoFaceError, ShapeError, ValueRangeError
from facewright.faces.appearance import visible_faces
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import expression_weights
from facewright.faces.simulate import simulate_person
from facewright.fitting.depth_target import depth_target
from facewright.fitting.scan import ScanFitOptions, ScanFitter
from facewright.fitting.scan_target import ScanTarget
from facewright.landmarks.points import Landmarks
from facewright.mesh.closest_point import closest_points
from facewright.mesh.connectivity import unique_edges
from facewright.mesh.normals import face_area_vectors, vertex_normals

CAMERA = Intrinsics(575.8, 575.8, 319.5, 239.5)
ACTED = 0.85


class Captured:
    """One simulated person, seen by a depth camera with smooth noise, and the fits."""

    def __init__(self, face, seed):
        self.face, self.rng = face, np.random.default_rng(seed)
        self.skin = face.skin()
        self.person = simulate_person(face, self.rng)
        self.fitter = ScanFitter(face)
        self.region = self.skin.topology.masks["face_region"]
        self.neutral_truth, self.neutral_target = self.observe(np.zeros(46))
        self.neutral = self.fitter.fit_neutral(self.neutral_target)

    def observe(self, weights, change=None):
        """Return the true skin in the camera's frame, and the target; `change` edits the depth map."""
        from scipy.ndimage import gaussian_filter

        from facewright.apps.true_landmarks import true_landmarks
        from facewright.imaging.rasterise import rasterise

        rng, topology = self.rng, self.skin.topology
        rotation = rotation_from_head_angles(*rng.uniform(-6, 6, 3))
        shift = np.array([*rng.uniform(-20, 20, 2), 620.0])
        self.motion = RigidMotion(rotation, shift - rotation @ [0, 0, 40.0])
        vertices = self.person.pose(weights)
        seen = self.motion.apply(vertices.astype(np.float64))
        fragments = rasterise(CAMERA.project(seen), seen[:, 2], visible_faces(self.face), (480, 640))
        noise = gaussian_filter(rng.normal(size=(480, 640)), 2.0)
        depth = np.where(fragments.covered, fragments.depth + 0.3 * noise / noise.std(), 0.0)
        if change is not None:
            change(depth, seen)
        marks = true_landmarks(topology, self.skin.mean_shape, vertices[: topology.n_vertices], CAMERA, self.motion)
        marks = Landmarks("fw74", marks.points + rng.normal(0, 0.5, marks.points.shape))
        return seen[: topology.n_vertices], depth_target(depth, CAMERA, marks)

    def surface_rms(self, vertices, truth):
        distances = closest_points(truth, self.skin.topology.faces, vertices[self.region]).distances
        return float(np.sqrt((distances**2).mean()))


@pytest.fixture(scope="module")
def captured(builtin_face):
    return Captured(builtin_face, 3)


def check_mesh(fit, faces):
    """No triangle of the fit is turned over against stage 1, no edge much longer or shorter."""
    before, after = (face_area_vectors(x, faces) for x in (fit.stage1_vertices, fit.vertices))
    cosine = np.einsum("fc,fc->f", before, after)
    cosine /= np.maximum(np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1), 1e-12)
    # triangles of less than 0.05 mm^2 have no side to speak of
    assert (cosine[np.linalg.norm(before, axis=1) > 0.1] < 0).sum() == 0
    edges = unique_edges(faces)
    ratio = [np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (fit.vertices, fit.stage1_vertices)]
    ratio = (ratio[0] / ratio[1])[ratio[1] > 0.5]
    assert ratio.min() > 0.3
    assert ratio.max() < 2.0


def test_neutral_is_within_the_noise_of_the_truth(captured):
    fit, truth = captured.neutral, captured.neutral_truth
    assert captured.surface_rms(fit.posed, truth) < 0.5
    assert fit.report["stage2_rms_mm"] < 0.39  # FaceWarehouse Fig. 2
    assert fit.report["stage2_rms_mm"] < fit.report["stage1_rms_mm"]
    assert fit.report["matched_share"] > 0.85
    assert np.linalg.norm(fit.posed - truth, axis=1)[captured.region].mean() < 1.5
    check_mesh(fit, captured.skin.topology.faces)


def test_sealed_lips_stay_sealed(captured):
    contacts = captured.fitter.contacts
    difference = contacts.gaps("lips", captured.neutral.posed) - contacts.gaps("lips", captured.neutral_truth)
    assert np.abs(difference).mean() < 0.5


@pytest.mark.parametrize("name", ["mouth_stretch", "smile", "eyes_closed"])
def test_expressions_follow_the_capture(captured, name):
    guide = expression_weights(name)
    truth, target = captured.observe(ACTED * guide)
    fit = captured.fitter.fit_expression(captured.neutral, guide, target)
    assert captured.surface_rms(fit.posed, truth) < 0.8
    guessed = fit.target_from_model.apply(captured.fitter.transferred_guide(captured.neutral, guide))
    assert captured.surface_rms(fit.posed, truth) < 0.9 * captured.surface_rms(guessed, truth)
    assert np.rad2deg(rotation_angle(fit.target_from_model.rotation, captured.motion.rotation)) < 1.5
    check_mesh(fit, captured.skin.topology.faces)


def test_what_lies_in_an_open_mouth_does_not_pull_the_lips(captured):
    """The same open mouth, with its cavity filled up to 6 mm behind the lips, as teeth or a tongue would."""
    guide = expression_weights("mouth_stretch")
    ids = captured.skin.topology.landmarks["fw74"][66:74]

    def fill(depth, seen):
        from matplotlib.path import Path

        rim = CAMERA.project(seen[ids])
        y, x = np.mgrid[:480, :640]
        inside = Path(rim).contains_points(np.stack([x.ravel(), y.ravel()], 1)).reshape(480, 640)
        assert inside.sum() > 100
        depth[inside] = seen[ids, 2].mean() + 6.0

    truth, target = captured.observe(ACTED * guide, fill)
    fit = captured.fitter.fit_expression(captured.neutral, guide, target)
    lips = captured.skin.topology.masks["lips"]
    lips = lips[captured.fitter.visibility.allowed[lips]]
    distances = closest_points(truth, captured.skin.topology.faces, fit.posed[lips]).distances
    assert np.sqrt((distances**2).mean()) < 1.2


def test_open_eyes_are_not_glued(captured):
    gaps = captured.fitter.contacts.gaps("lids_left", captured.neutral.posed)
    true = captured.fitter.contacts.gaps("lids_left", captured.neutral_truth)
    assert gaps.max() > 0.7 * true.max() > 3.0


def test_hair_and_glasses_do_not_pull(captured):
    """A cap of hair on the forehead and bars of glasses, 8 and 6 mm before the face."""

    def dress(depth, seen):
        brows = CAMERA.project(seen[captured.skin.topology.landmarks["fw74"][15:27]])
        top, left, right = int(brows[:, 1].min()) - 25, int(brows[:, 0].min()), int(brows[:, 0].max())
        hair, bars = np.zeros(depth.shape, bool), np.zeros(depth.shape, bool)
        hair[:top] = True
        bars[int(brows[:, 1].max()) + 4 : int(brows[:, 1].max()) + 8, left:right] = True
        depth[hair & (depth > 0)] -= 8.0
        depth[bars & (depth > 0)] -= 6.0

    truth, target = captured.observe(np.zeros(46), dress)
    fit = captured.fitter.fit_neutral(target)
    below = captured.region[captured.skin.mean_shape[captured.region, 1] < 30.0]
    distances = closest_points(truth, captured.skin.topology.faces, fit.posed[below]).distances
    assert np.sqrt((distances**2).mean()) < 0.7


def test_a_plain_scan_needs_no_camera(captured):
    """Points all round the head, no contour term."""
    truth, faces = captured.neutral_truth, captured.skin.topology.faces
    target = captured.neutral_target
    plain = ScanTarget(truth, vertex_normals(truth, faces), faces, target.landmarks, target.confidence)
    fit = ScanFitter(captured.face, ScanFitOptions(region="head")).fit_neutral(plain)
    assert captured.surface_rms(fit.posed, truth) < 0.5
    check_mesh(fit, faces)


def test_landmarks_far_from_the_surface_are_refused(captured):
    target = captured.neutral_target
    moved = ScanTarget(target.points, target.normals, target.faces, target.landmarks + [300.0, 0, 0], target.confidence)
    with pytest.raises(NoFaceError, match="check landmarks"):
        captured.fitter.fit_neutral(moved)


def test_a_wall_is_refused(captured):
    pixels = captured.neutral_target.contour_pixels
    target = depth_target(np.full((480, 640), 620.0), CAMERA, Landmarks("fw74", pixels))
    with pytest.raises(NoFaceError, match="standard deviations"):
        captured.fitter.fit_neutral(target)


def test_wrong_arguments_are_refused(captured):
    with pytest.raises(ShapeError, match="guide_weights"):
        captured.fitter.fit_expression(captured.neutral, np.zeros(5), captured.neutral_target)
    with pytest.raises(ValueRangeError, match="guide_weights"):
        captured.fitter.fit_expression(
            captured.neutral, np.full(len(BLENDSHAPE_NAMES), np.nan), captured.neutral_target
        )
    with pytest.raises(ValueRangeError, match="region"):
        ScanFitOptions(region="ear")
    with pytest.raises(ValueRangeError, match="n_modes"):
        ScanFitOptions(n_modes=0)
