"""Labels the whole way: people whose shape depends on age and sex, a database, a model, `edit --set "age=+1"`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from typer.testing import CliRunner

pytest.importorskip("zarr")
pytest.importorskip("dask")

from facewright.cli.main import app
from facewright.evaluation.simulated_edit import simulate_scene
from facewright.faces import Face
from facewright.faces.attribute_editor import AttributeEditor
from facewright.faces.simulate import simulate_expressions, simulate_neutrals
from facewright.landmarks.files import write_landmarks
from facewright.models.bilinear import BilinearModel
from facewright.models.bilinear_store import load_bilinear
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

PEOPLE, UNSEEN = 72, 24
BY_HAND = 6  # people whose age is added on the command line, later
MIDDLE_AGE, AGE_SPREAD = 45.0, 15.0


class People(NamedTuple):
    """Neutral faces (N, V, 3), mm, ages and whether male."""

    neutrals: NDArray[np.float64]
    ages: NDArray[np.float64]
    male: NDArray[np.bool_]


def bump(points: NDArray[np.floating], centre: tuple[float, float, float], size: float) -> NDArray[np.float64]:
    return np.exp(-0.5 * ((points - centre) ** 2).sum(axis=1) / size**2)


def effects(face: Face) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what one standard deviation of age does to a face (V, 3), mm, and what being male does."""
    points = face.mean_shape.astype(np.float64)
    jaw = points[face.topology.masks["chin"]].mean(axis=0)
    nose = points[face.topology.masks["nose"]]
    tip = nose[nose[:, 2].argmax()]
    brows = [points[face.topology.masks[f"brow_{side}"]].mean(axis=0) for side in ("left", "right")]
    side = np.sign(points[:, 0]) * np.minimum(np.abs(points[:, 0]) / 20.0, 1.0)
    age, male = np.zeros_like(points), np.zeros_like(points)
    age[:, 1] -= 2.0 * bump(points, tuple(tip), 14.0)  # the nose grows longer and forward
    age[:, 2] += 1.5 * bump(points, tuple(tip), 14.0)
    for x in (-1, 1):  # jowls sag, the jaw of men is broad, their brows are heavy
        age[:, 1] -= 2.0 * bump(points, (x * 42.0, jaw[1] + 12.0, jaw[2] - 35.0), 16.0)
        age[:, 0] += x * 1.5 * bump(points, (x * 42.0, jaw[1] + 12.0, jaw[2] - 35.0), 16.0)
    for middle in brows:
        male[:, 2] += 2.5 * bump(points, tuple(middle), 12.0)
    male[:, 0] += 4.0 * side * np.exp(-0.5 * ((points[:, 1] - jaw[1] - 15.0) / 18.0) ** 2)
    male[:, 1] -= 3.0 * bump(points, tuple(jaw), 16.0)
    age[face.n_skin :] = male[face.n_skin :] = 0.0
    return age, male


def draw_people(face: Face, n: int, rng: np.random.Generator) -> People:
    """Draw people; older ones are more often men, so that the two labels must be told apart."""
    age, male = effects(face)
    years = rng.uniform(MIDDLE_AGE - 1.73 * AGE_SPREAD, MIDDLE_AGE + 1.73 * AGE_SPREAD, n).round()
    is_male = rng.random(n) < np.where(years > MIDDLE_AGE, 0.65, 0.35)
    deviations = (years - MIDDLE_AGE) / AGE_SPREAD
    plain = simulate_neutrals(face, n, rng).astype(np.float64)
    shapes = plain + deviations[:, None, None] * age + (is_male - 0.5)[:, None, None] * male
    return People(shapes, years, is_male)


@pytest.fixture(scope="module")
def model_file(builtin_face: Face, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model built on the command line from a database whose people were labelled there."""
    folder = tmp_path_factory.mktemp("labelled")
    people = draw_people(builtin_face, PEOPLE, np.random.default_rng(5))
    warehouse = Warehouse.create(str(folder / "db"), builtin_face)
    for k, neutral in enumerate(people.neutrals):
        shapes = np.concatenate([neutral[None], neutral + builtin_face.blendshape_deltas]).astype(np.float32)
        attributes: dict[str, object] = {"sex": "male" if people.male[k] else "female"}
        if k >= BY_HAND:
            attributes["age"] = int(people.ages[k])
        warehouse.write_subject(Subject(f"p{k:02d}", ("neutral",), shapes[:1], shapes, attributes=attributes))
    for k, years in enumerate(people.ages[:BY_HAND]):
        run("warehouse", "label", folder / "db", f"p{k:02d}", f"age={years:.0f}")
    run("model", "build", folder / "db", "-o", folder / "m.fwbm", "--identities", 40, "--expressions", 12)
    return folder / "m.fwbm"


@pytest.fixture(scope="module")
def model(model_file: Path) -> BilinearModel:
    return load_bilinear(model_file)


@pytest.fixture(scope="module")
def unseen(builtin_face: Face) -> People:
    return draw_people(builtin_face, UNSEEN, np.random.default_rng(6))


def run(*words: object) -> dict:
    result = CliRunner().invoke(app, [*(str(word) for word in words), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def neutral_basis(model: BilinearModel) -> NDArray[np.float64]:
    return model.expression(model.expression_weights[0]).astype(np.float64)


def weights_of(model: BilinearModel, neutrals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return identity weights (N, I): the model's faces nearest to neutral ones, held by its prior."""
    basis = neutral_basis(model).reshape(model.n_identity, -1)
    precision = np.linalg.inv(model.identity_covariance)
    A = basis @ basis.T + precision  # a millimetre of noise
    b = neutrals.reshape(len(neutrals), -1) @ basis.T + precision @ model.identity_mean
    return np.linalg.solve(A, b.T).T


def readout(model: BilinearModel, label: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Predict a label from identity weights, learned from the model's own people (ridge)."""
    W = (model.identity_weights - model.identity_mean) @ np.linalg.inv(np.linalg.cholesky(model.identity_covariance)).T
    new = (weights - model.identity_mean) @ np.linalg.inv(np.linalg.cholesky(model.identity_covariance)).T
    slope = np.linalg.solve(W.T @ W + 5.0 * np.eye(W.shape[1]), W.T @ (label - label.mean()))
    return label.mean() + new @ slope


def labels(model: BilinearModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    male = np.array([sex == "male" for sex in model.labels["sex"]], float)
    return np.array(model.labels["age"], float), male


def test_list_says_how_well_labels_are_known(model_file: Path) -> None:
    found = {entry["name"]: entry for entry in run("edit", "--list", "--model", model_file)["attributes"]}
    assert {"age", "sex: male", "sex: female"} <= set(found)
    assert found["age"]["n_people"] == PEOPLE and found["age"]["mean"] == pytest.approx(MIDDLE_AGE, abs=6.0)
    assert found["age"]["r_squared"] > 0.5 and found["sex: male"]["r_squared"] > 0.5


def test_labels_are_read_from_the_shapes_of_unseen_people(model: BilinearModel, unseen: People) -> None:
    weights = weights_of(model, unseen.neutrals)
    for known, truth, least in zip(labels(model), (unseen.ages, unseen.male.astype(float)), (0.5, 0.5), strict=True):
        predicted = readout(model, known, weights)
        assert 1.0 - ((predicted - truth) ** 2).sum() / ((truth - truth.mean()) ** 2).sum() > least


@pytest.mark.parametrize("name, which", [("age", 0), ("sex: male", 1)])
def test_a_change_of_a_label_is_what_it_does_to_people(
    model: BilinearModel, unseen: People, builtin_face: Face, name: str, which: int
) -> None:
    editor = AttributeEditor.of_model(model)
    spread = next(label.standard_deviation for label in editor.label_attributes if label.name == name)
    truth = effects(builtin_face)[which] * (spread / AGE_SPREAD if which == 0 else spread)
    basis = neutral_basis(model)
    weights = weights_of(model, unseen.neutrals)[0]
    step = editor.change(weights, {name: 1.0}).weights - weights
    moved = np.tensordot(step, basis, 1)
    # 72 people of random shapes: what else old ones, or men, happen to have comes along
    similarity = float((moved * truth).sum() / np.sqrt((moved**2).sum() * (truth**2).sum()))
    assert similarity > 0.5
    assert 0.6 < float((moved * truth).sum() / (truth**2).sum()) < 1.4
    both = np.stack([effect.ravel() for effect in effects(builtin_face)], axis=1)  # where both change a face, jointly
    shares = np.linalg.lstsq(both, moved.ravel(), rcond=None)[0]
    assert shares[which] * (AGE_SPREAD if which == 0 else 1.0) / spread > 0.5 and abs(shares[1 - which]) < 0.3
    known = labels(model)[which]
    before, after = (readout(model, known, w[None])[0] for w in (weights, weights + step))
    assert 0.6 < (after - before) / spread < 1.4


@pytest.mark.slow
def test_edit_on_the_command_line_makes_a_person_older(
    model_file: Path, builtin_face: Face, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from facewright.errors import MissingExtraError

    def absent(*args: object, **options: object) -> None:
        raise MissingExtraError("no detector in this test")

    monkeypatch.setattr("facewright.landmarks.detector.open_detector", absent)
    scene = simulate_scene(builtin_face, np.random.default_rng(11))
    young = scene.person.neutral - effects(builtin_face)[0]
    person = simulate_expressions(builtin_face, young, np.random.default_rng(scene.personality))
    scene = replace(scene, person=person)
    Image.fromarray(scene.draw()[0]).save(tmp_path / "photo.png")
    write_landmarks(tmp_path / "points.json", scene.landmarks(0.5, np.random.default_rng(0)))
    photo, points = tmp_path / "photo.png", tmp_path / "points.json"
    common = ("edit", photo, "--landmarks", points, "--model", model_file)
    older = run(*common, "--set", "age=+2", "-o", tmp_path / "older.png")
    younger = run(*common, "--set", "age=-2", "-o", tmp_path / "younger.png")
    manly = run(*common, "--set", "sex: male=+2", "-o", tmp_path / "male.png")
    for of, name in ((older, "nose length"), (manly, "jaw width")):
        assert of["change_in_deviations"][name] > 0.4
    assert younger["change_in_deviations"]["nose length"] < -0.4
    assert abs(older["change_in_deviations"]["jaw width"]) < 0.5 * manly["change_in_deviations"]["jaw width"]
    before, after = (np.asarray(Image.open(tmp_path / name)).astype(int) for name in ("photo.png", "older.png"))
    changed = (before != after).any(axis=2)
    assert 0.02 < changed.mean() < 0.9 and not changed[:4, :4].any()
