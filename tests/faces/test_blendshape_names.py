import json

import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.faces.blendshape_names import (
    BLENDSHAPE_NAMES,
    blendshape_index,
    load_name_map,
    mirror_order,
    mirrored_name,
)


def test_there_are_46_distinct_names_with_their_mirror_images():
    assert len(BLENDSHAPE_NAMES) == len(set(BLENDSHAPE_NAMES)) == 46
    assert all(mirrored_name(mirrored_name(name)) == name for name in BLENDSHAPE_NAMES)
    order = mirror_order()
    assert np.array_equal(order[order], np.arange(46))
    assert order[blendshape_index("mouthLeft")] == blendshape_index("mouthRight")


def test_an_unknown_blendshape_is_refused():
    with pytest.raises(ValueRangeError, match="tongueOut"):
        blendshape_index("tongueOut")


def test_arkit_map_loses_only_gaze_and_tongue(rng):
    arkit = load_name_map("arkit52")
    assert len(arkit.names) == 52
    assert set(arkit.without_counterpart) == {
        *(f"eyeLook{way}{side}" for way in ("In", "Out", "Up") for side in ("Left", "Right")),
        "tongueOut",
    }
    # What both schemes tell apart comes back; the two sides of browInnerUp and cheekPuff come back as their mean.
    weights = rng.random(46)
    for name in ("browInnerUp", "cheekPuff"):
        weights[blendshape_index(f"{name}_R")] = weights[blendshape_index(f"{name}_L")]
    assert np.allclose(arkit.to_ours @ (arkit.from_ours @ weights), weights)


def test_facewarehouse_map_has_its_46_names_and_carries_a_smile():
    scheme = load_name_map("facewarehouse46")
    assert len(scheme.names) == 46
    weights = np.zeros(46)
    weights[scheme.names.index("MouthSmile_L")] = 0.7
    ours = scheme.to_ours @ weights
    assert ours[blendshape_index("mouthSmile_L")] == pytest.approx(0.7)
    assert np.count_nonzero(ours) == 1


def test_a_user_can_replace_a_map(tmp_path):
    path = tmp_path / "mine.json"
    table = {"names": ["grin"], "to_ours": {"grin": {"mouthSmile_L": 0.5}}, "from_ours": {"mouthSmile_L": {"grin": 2}}}
    path.write_text(json.dumps(table))
    mine = load_name_map(path)
    assert mine.names == ("grin",)
    assert (mine.from_ours @ mine.to_ours).item() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("{", "JSON"),
        ("[]", "names"),
        ('{"names": ["a"], "to_ours": [], "from_ours": {}}', "objects"),
        ('{"names": ["a"], "to_ours": {"b": {}}, "from_ours": {}}', "'b'"),
        ('{"names": ["a"], "to_ours": {"a": {"nose": 1}}, "from_ours": {}}', "nose"),
        ('{"names": ["a"], "to_ours": {"a": {"jawOpen": "x"}}, "from_ours": {}}', "jawOpen"),
    ],
)
def test_a_bad_map_file_is_refused(tmp_path, content, match):
    path = tmp_path / "bad.json"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=match):
        load_name_map(path)


def test_an_unknown_scheme_or_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueRangeError, match="arkit52"):
        load_name_map("arkit99")
    with pytest.raises(StoreError, match="absent"):
        load_name_map(tmp_path / "absent.json")
