"""Components carried over, measured: pairs with known truth, copy-and-paste, the suite."""

import numpy as np
import pytest

from facewright.errors import ValueRangeError
from facewright.evaluation import component as suite
from facewright.evaluation.component import SYMMETRIC, run
from facewright.evaluation.copy_and_paste import paste_component
from facewright.evaluation.simulated_pair import IMAGE_SIZE, simulate_pair
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.simulate import simulate_person, simulate_population
from facewright.imaging.component_mask import COMPONENTS
from facewright.landmarks.points import Landmarks
from facewright.models.bilinear import fit_bilinear


@pytest.fixture(scope="module")
def person(builtin_face):
    return simulate_person(builtin_face, np.random.default_rng(3))


@pytest.fixture(scope="module")
def pair(builtin_face, person):
    return simulate_pair(builtin_face, person, "mouth", np.random.default_rng(5))


def test_the_truth_differs_from_the_target_only_where_the_mouth_moves(pair):
    changed = (pair.truth != pair.target.image).any(axis=2)
    assert pair.truth.shape == (*IMAGE_SIZE, 3) and pair.region.sum() > 1000
    assert changed[pair.region].mean() > 0.8
    top = int(pair.target.landmarks.points[15:27, 1].min()) - 5  # the mouth's shapes do not reach above the brows
    difference = np.abs(pair.truth.astype(int) - pair.target.image)
    assert difference[:top].mean() < 0.1 * difference[pair.region].mean()


def test_pairs_differ_in_view_and_light(pair):
    a, b = pair.target.landmarks.points, pair.reference.landmarks.points
    assert np.nanmax(np.abs(a - b)) > 10
    assert pair.target.image.mean() != pytest.approx(pair.reference.image.mean(), abs=0.5)


def test_one_sided_mouths_are_one_sided(builtin_face, person):
    crooked = simulate_pair(builtin_face, person, "mouth", np.random.default_rng(6), one_sided=True)
    ids = builtin_face.topology.landmarks["fw74"]
    mouth = ids[54:66]
    seen = crooked.reference.view.camera_vertices[mouth]
    eyes = crooked.reference.view.camera_vertices[ids[27:43]]
    across = eyes[8:].mean(axis=0) - eyes[:8].mean(axis=0)
    across /= np.linalg.norm(across)
    off = abs((seen.mean(axis=0) - eyes.mean(axis=0)) @ across)
    assert off > 2.0  # millimetres


def test_symmetric_shapes_are_symmetric_and_known():
    for shapes in SYMMETRIC.values():
        assert set(shapes) <= set(BLENDSHAPE_NAMES)
        mirrored = {
            name[:-1] + ("R" if name[-1] == "L" else "L") if name[-2:] in ("_L", "_R") else name for name in shapes
        }
        assert mirrored == set(shapes)


@pytest.mark.parametrize("component", COMPONENTS)
def test_paste_undoes_a_similarity_of_the_plane(component, pair):
    """A reference that is the target scaled and turned gives the target back."""
    from scipy import ndimage

    target = ndimage.gaussian_filter(pair.target.image.astype(float), (2, 2, 0)).round().astype(np.uint8)
    angle, scale, centre = 0.2, 1.3, np.array([256.0, 256.0])
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = (pair.target.landmarks.points - centre) @ turn.T + centre
    y, x = np.mgrid[: IMAGE_SIZE[0], : IMAGE_SIZE[1]]
    back = (np.stack([x, y], axis=-1) - centre) @ np.linalg.inv(turn).T + centre
    reference = np.stack(
        [
            ndimage.map_coordinates(c, [back[..., 1], back[..., 0]], order=1, mode="nearest")
            for c in np.moveaxis(target, 2, 0)
        ],
        axis=-1,
    )
    pasted = paste_component(target, reference, pair.target.landmarks, Landmarks("fw74", points), component)
    assert np.abs(pasted.astype(int) - target).mean() < 0.5
    assert (pasted != target).any()


def test_bad_input_is_refused(builtin_face):
    with pytest.raises(ValueRangeError, match="subjects"):
        run(builtin_face, 0, subjects=0)


@pytest.mark.slow
def test_the_suite_beats_copy_and_paste(builtin_face, monkeypatch):
    monkeypatch.setattr(suite, "N_FEW", 6)
    tensor = simulate_population(builtin_face, 40, np.random.default_rng(1))
    names = ("neutral", *builtin_face.blendshape_names)
    model = fit_bilinear(tensor, 30, 47, topology=builtin_face.topology, expression_names=names)
    stages = []
    metrics = run(builtin_face, 0, lambda *stage: stages.append(stage), subjects=1, model=model)
    assert metrics["psnr_db"] > metrics["paste_psnr_db"] and metrics["ssim"] > metrics["paste_ssim"]
    assert metrics["psnr_db"] > metrics["unchanged_psnr_db"]
    assert metrics["asymmetric_psnr_db_150x47"] > metrics["asymmetric_psnr_db_15x10"]
    assert {f"psnr_db_{c}" for c in COMPONENTS} <= set(metrics) and np.isfinite(list(metrics.values())).all()
    assert stages[-1][1] == stages[-1][2]
