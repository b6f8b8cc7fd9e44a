import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.label_regression import MIN_PEOPLE, fit_label_regression

PEOPLE, MODES = 120, 6


@pytest.fixture
def labelled(rng):
    """Weights that age moves along mode 0, and being female along mode 1; hair colour moves nothing."""
    age = rng.uniform(18, 70, PEOPLE)
    female = rng.random(PEOPLE) < 0.4
    weights = 0.3 * rng.normal(size=(PEOPLE, MODES))
    weights[:, 0] += 0.05 * (age - 44)
    weights[:, 1] += 1.5 * female
    labels = {
        "age": tuple(float(a) for a in age),
        "sex": tuple("female" if f else "male" for f in female),
        "hair": tuple(rng.choice(["dark", "fair", "red"], PEOPLE).tolist()),
    }
    return weights, labels


def named(attributes):
    return {attribute.name: attribute for attribute in attributes}


def test_each_label_moves_its_own_mode(labelled):
    found, left_out = fit_label_regression(*labelled)
    found = named(found)
    assert left_out == {}
    assert list(found) == ["age", "sex: female", "sex: male", "hair: dark", "hair: fair", "hair: red"]
    age, female = found["age"], found["sex: female"]
    one_deviation = 0.05 * np.std(labelled[1]["age"])
    np.testing.assert_allclose(age.direction, [one_deviation, 0, 0, 0, 0, 0], atol=0.1)
    np.testing.assert_allclose(female.direction / female.standard_deviation, [0, 1.5, 0, 0, 0, 0], atol=0.15)
    np.testing.assert_allclose(found["sex: male"].direction, -female.direction, atol=1e-9)
    assert age.r_squared > 0.7 and female.r_squared > 0.7
    assert found["hair: red"].r_squared < 0.1


def test_labels_that_go_together_are_told_apart(rng):
    """All women of the sample are older, but only age changes the shape."""
    female = rng.random(PEOPLE) < 0.5
    age = rng.uniform(20, 50, PEOPLE) + 12 * female
    weights = 0.1 * rng.normal(size=(PEOPLE, 3))
    weights[:, 0] += 0.1 * age
    labels = {"age": tuple(age.tolist()), "sex": tuple(female.tolist())}
    found = named(fit_label_regression(weights, labels)[0])
    assert list(found) == ["age", "sex: false", "sex: true"]
    assert abs(found["sex: true"].direction[0]) < 0.05 * abs(found["age"].direction[0])


def test_unknown_labels_do_not_count(labelled):
    weights, labels = labelled
    some = {"age": tuple(a if i % 3 else None for i, a in enumerate(labels["age"])), "sex": labels["sex"]}
    found = named(fit_label_regression(weights, some)[0])
    assert found["age"].n_people == 80 and found["sex: female"].n_people == PEOPLE
    whole = named(fit_label_regression(weights, labels)[0])
    np.testing.assert_allclose(found["age"].direction, whole["age"].direction, atol=0.12)


def test_labels_that_say_nothing_are_left_out_with_a_reason(labelled):
    weights, _ = labelled
    labels = {
        "few": tuple(float(i) if i < MIN_PEOPLE - 1 else None for i in range(PEOPLE)),
        "simulated": (True,) * PEOPLE,
        "height": (180.0,) * PEOPLE,
        "note": tuple(f"session {i}" for i in range(PEOPLE)),
        "rare": tuple("yes" if i < 2 else "no" for i in range(PEOPLE)),
    }
    found, left_out = fit_label_regression(weights, labels)
    assert found == ()
    assert set(left_out) == set(labels)
    assert "known of 7 people only" in left_out["few"]
    assert "the same for everybody" in left_out["height"]
    assert "120 different values" in left_out["note"]
    assert "no kind has at least" in left_out["rare"] and "no kind has at least" in left_out["simulated"]


def test_refuses(labelled):
    weights, labels = labelled
    with pytest.raises(ShapeError, match="one value for each of the 120 people, got 3"):
        fit_label_regression(weights, {"age": (1.0, 2.0, 3.0)})
    weights[3, 1] = np.nan
    with pytest.raises(ValueRangeError):
        fit_label_regression(weights, labels)
