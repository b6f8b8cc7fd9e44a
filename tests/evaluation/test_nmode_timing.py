import subprocess
import sys

import numpy as np
import pytest

from facewright.errors import FacewrightError, MissingExtraError
from facewright.evaluation import nmode_timing
from facewright.evaluation.out_of_core import measure_out_of_core
from facewright.models.nmode_svd import gram_matrix


@pytest.fixture(scope="module")
def tensor():
    return (np.random.default_rng(0).normal(size=(12, 7, 300, 3)) + 5).astype(np.float32)


def test_time_nmode_reports_consistent_figures(tensor):
    figures = nmode_timing.time_nmode(tensor, 5, 4, repeats=2)
    assert set(figures) == {
        "nmode_seconds",
        "gram_seconds",
        "gram_identity_seconds",
        "gram_expression_seconds",
        "ratio_to_limit",
        "extra_peak_mb",
    }
    assert figures["ratio_to_limit"] == pytest.approx(figures["nmode_seconds"] / figures["gram_seconds"])
    assert figures["gram_seconds"] == pytest.approx(
        figures["gram_identity_seconds"] + figures["gram_expression_seconds"]
    )


def test_layouts_compute_the_same_gram_matrix(tensor):
    """What is timed as the limit is the product that the decomposition needs."""
    shapes = tensor.reshape(12, 7, -1)
    np.testing.assert_allclose(np.matmul(shapes, shapes.swapaxes(1, 2)).sum(axis=0), gram_matrix(tensor, 1), rtol=1e-5)
    for mode in (0, 1):
        assert all(seconds > 0 for seconds in nmode_timing.gram_layout_seconds(tensor, mode).values())


def test_out_of_core_runs_in_its_own_process(tensor):
    figures = nmode_timing.time_out_of_core(tensor, 5, 4)
    assert 10 < figures["peak_mb"] < 2000
    assert figures["out_of_core_seconds"] > 0


def test_out_of_core_failure_is_one_sentence(tmp_path):
    (tmp_path / "bad.npy").write_bytes(b"")
    with pytest.raises(FacewrightError, match=r"out-of-core run failed: .*bad\.npy must be a \.npy file"):
        measure_out_of_core(tmp_path / "bad.npy", 2, 2)


def test_tensorly_is_optional(tensor, monkeypatch):
    monkeypatch.setattr(nmode_timing, "has_tensorly", lambda: False)
    with pytest.raises(MissingExtraError, match="pip install tensorly"):
        nmode_timing.time_tensorly(tensor, 5, 4)


def test_tensorly_finds_the_same_model(tensor):
    pytest.importorskip("tensorly", reason="compares with TensorLy: pip install tensorly")
    figures = nmode_timing.time_tensorly(tensor, 5, 4)
    assert figures["tensorly_seconds"] > 0
    assert figures["tensorly_error_ratio"] == pytest.approx(1, abs=0.01)


def test_importing_does_not_import_tensorly():
    code = "import sys, facewright.evaluation.bilinear; print('tensorly' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"
