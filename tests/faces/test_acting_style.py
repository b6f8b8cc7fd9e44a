import numpy as np

from facewright.faces.acting_style import draw_style
from facewright.faces.acting_timing import SHAPE_INDEX
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, mirrored_name


def test_styles_differ_and_are_plausible():
    styles = [draw_style(np.random.default_rng(seed)) for seed in range(12)]
    reach = np.array([style.reach for style in styles])
    assert (reach > 0.3).all() and (reach < 1.7).all() and (reach.std(axis=0) > 0.02).all()
    assert {style.side for style in styles} == {"L", "R"}
    for style in styles:
        assert (style.delays >= 0).all() and style.delays.max() < 0.08
        assert (np.diag(style.recruitment) == 1).all() and (style.recruitment >= 0).all()


def test_sides_differ_but_jaw_and_its_counter_shape_do_not():
    style = draw_style(np.random.default_rng(3))
    pairs = [(i, BLENDSHAPE_NAMES.index(mirrored_name(n))) for i, n in enumerate(BLENDSHAPE_NAMES) if n.endswith("_L")]
    ratio = np.array([style.reach[i] / style.reach[k] for i, k in pairs])
    assert (np.abs(ratio - 1) > 0.005).all() and np.abs(np.log(ratio)).max() < 1.0
    jaw, close = SHAPE_INDEX["jawOpen"], SHAPE_INDEX["mouthClose"]
    assert style.reach[jaw] == style.reach[close] and style.delays[jaw] == style.delays[close]


def test_recruitment_stays_on_its_side():
    recruitment = draw_style(np.random.default_rng(1)).recruitment
    for i, name in enumerate(BLENDSHAPE_NAMES):
        for k in np.flatnonzero(recruitment[:, i]):
            other = BLENDSHAPE_NAMES[k]
            assert not (name[-2:] in ("_L", "_R") and other[-2:] in ("_L", "_R") and name[-2:] != other[-2:])
