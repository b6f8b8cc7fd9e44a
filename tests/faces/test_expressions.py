import json

import numpy as np
import pytest

from facewright.errors import FileFormatError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, blendshape_index, mirror_order
from facewright.faces.expressions import (
    EXPRESSION_NAMES,
    EXPRESSION_WEIGHTS,
    OPPOSED,
    expression_weights,
    load_expressions,
    random_expression_weights,
)


def test_the_20_expressions_start_with_neutral_and_differ():
    assert EXPRESSION_WEIGHTS.shape == (20, 46)
    assert not EXPRESSION_WEIGHTS[0].any()
    assert len(np.unique(EXPRESSION_WEIGHTS, axis=0)) == 20
    assert EXPRESSION_WEIGHTS.min() >= 0
    assert EXPRESSION_WEIGHTS.max() <= 1


def test_sideways_expressions_mirror_each_other_and_the_rest_is_symmetric():
    order = mirror_order()
    for name in EXPRESSION_NAMES:
        twin = name.replace("left", "R").replace("right", "left").replace("R", "right")
        assert np.array_equal(expression_weights(name)[order], expression_weights(twin)), name


def test_lips_are_closed_only_as_far_as_the_jaw_opens(rng):
    close, jaw = blendshape_index("mouthClose"), blendshape_index("jawOpen")
    for weights in (EXPRESSION_WEIGHTS, random_expression_weights(rng, 500)):
        assert (weights[:, close] <= weights[:, jaw]).all()


def test_weights_handed_out_are_the_callers_own():
    expression_weights("smile")[:] = 5
    assert expression_weights("smile").max() <= 1


def test_random_expressions_are_plausible(rng):
    weights = random_expression_weights(rng, 2000)
    assert weights.shape == (2000, 46)
    assert weights.min() >= 0
    assert weights.max() <= 1
    assert (weights > 0).any(axis=0).all()  # every shape is used
    active = (weights > 0).sum(axis=1).mean()
    assert 3 < active < 20
    for group in OPPOSED:
        columns = [BLENDSHAPE_NAMES.index(name) for name in group]
        assert ((weights[:, columns] > 0).sum(axis=1) <= 1).all()


def test_no_random_expressions_is_an_empty_array(rng):
    assert random_expression_weights(rng, 0).shape == (0, 46)


def test_an_unknown_expression_is_refused():
    with pytest.raises(ValueRangeError, match="smirk"):
        expression_weights("smirk")


def test_a_user_can_replace_the_expressions(tmp_path):
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"expressions": {"rest": {}, "half": {"jawOpen": 0.5}}}))
    names, weights = load_expressions(path)
    assert names == ("rest", "half")
    assert weights[1, blendshape_index("jawOpen")] == 0.5


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("{}", "expressions"),
        ('{"expressions": {}}', "expressions"),
        ('{"expressions": {"a": 3}}', "'a'"),
        ('{"expressions": {"a": {"nose": 1}}}', "nose"),
        ('{"expressions": {"a": {"jawOpen": 1.5}}}', "jawOpen"),
        ('{"expressions": {"a": {"jawOpen": "1"}}}', "jawOpen"),
    ],
)
def test_a_bad_expression_file_is_refused(tmp_path, content, match):
    path = tmp_path / "bad.json"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=match):
        load_expressions(path)
