"""Gram matrices and projections by blocks as tasks give the decomposition of the whole tensor."""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from facewright.errors import FacewrightError, ShapeError, ValueRangeError
from facewright.models.nmode_svd import gram_matrix, nmode_svd, project_mode
from facewright.warehouse.dask_cluster import Finished, open_cluster
from facewright.warehouse.gram_blocks import BlockedTensor
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

pytest.importorskip("zarr")
pytest.importorskip("distributed")

sys.path.insert(0, str(Path(__file__).parent))
from build_fixtures import tiny_topology

N, V = 9, 700


@pytest.fixture(scope="module")
def people():
    rng = np.random.default_rng(3)
    mean = rng.normal(0, 60, (V, 3))
    modes = rng.normal(0, 3, (N, 1, V, 3)) + rng.normal(0, 2, (1, 47, V, 3)) + rng.normal(0, 1, (N, 47, V, 3))
    return (mean + modes).astype(np.float32)


@pytest.fixture(scope="module")
def store(people, tmp_path_factory):
    store = Warehouse.create(tmp_path_factory.mktemp("store") / "faces.zarr", tiny_topology("tiny", V))
    for number, shapes in enumerate(people):
        store.write_subject(Subject(f"person-{number}", ("neutral",), shapes[:1], shapes))
    return store


@pytest.fixture
def here():
    with open_cluster() as cluster:
        yield cluster


class Reversed:
    """Runs calls in this process and hands the results back last first, as a slow first worker would."""

    in_process, dashboard = True, ""

    def run(self, function, calls, *, retries=0):
        yield from [Finished(label, function(*arguments)) for label, arguments in calls][::-1]


@pytest.mark.parametrize("block_mb", [0.02, 0.3, 64.0])
@pytest.mark.parametrize("mode", [0, 1])
def test_products_equal_those_of_the_whole(people, here, block_mb, mode):
    tensor = BlockedTensor(people, here, block_mb)
    whole = gram_matrix(people, mode, precision="double")
    np.testing.assert_allclose(tensor.gram(mode, True, None), whole, rtol=1e-12)
    np.testing.assert_allclose(tensor.gram(mode, False, None), whole, rtol=1e-5)
    rng = np.random.default_rng(0)
    factors = np.linalg.qr(rng.normal(size=(people.shape[mode], 4)))[0]
    expected = np.einsum("nsk,na->ask" if mode == 0 else "nsk,sa->nak", people.reshape(N, 47, -1), factors)
    np.testing.assert_allclose(tensor.project(factors, mode, None), expected, atol=2e-3)
    np.testing.assert_allclose(project_mode(people, factors, mode), expected, atol=2e-3)


@pytest.mark.parametrize("order", ["identity", "expression"])
def test_the_database_is_decomposed_as_the_array(people, store, here, order):
    stages = []
    tensor = BlockedTensor(store.blendshape_tensor(), here, 1.5)
    assert tensor.blocks() == [(start, min(start + 256, V)) for start in range(0, V, 256)]  # whole chunks
    found = nmode_svd(tensor, 5, 12, order=order, precision="double", progress=lambda *step: stages.append(step))
    expected = nmode_svd(people, 5, 12, order=order, precision="double")
    np.testing.assert_allclose(found.identity_singular_values, expected.identity_singular_values, rtol=1e-4)
    # Components of close singular values may turn into each other: compare what they span.
    for ours, theirs in zip(found[1:3], expected[1:3]):
        np.testing.assert_allclose(ours @ ours.T, theirs @ theirs.T, atol=1e-4)
    rebuilt, wanted = (
        np.einsum("ievc,ni,se->nsvc", svd.core, svd.identity_factors, svd.expression_factors, optimize=True)
        for svd in (found, expected)
    )
    np.testing.assert_allclose(rebuilt, wanted, atol=5e-3)  # mm
    assert {"identity modes", "expression modes", "core tensor"} & {stage for stage, _, _ in stages}
    assert all(0 < done <= total for _, done, total in stages)


def test_the_result_does_not_depend_on_which_block_is_first(people, here):
    forth, back = BlockedTensor(people, here, 0.3), BlockedTensor(people, Reversed(), 0.3)
    assert len(forth.blocks()) > 5
    np.testing.assert_array_equal(forth.gram(0, False, None), back.gram(0, False, None))
    np.testing.assert_array_equal(nmode_svd(forth, 4, 6).core, nmode_svd(back, 4, 6).core)


def test_workers_give_the_same_bits(people, store):
    with open_cluster(2) as cluster, open_cluster() as here:
        tensors = [BlockedTensor(store.blendshape_tensor(), where, 0.5) for where in (cluster, here)]
        grams = [tensor.gram(0, True, None) for tensor in tensors]
        np.testing.assert_allclose(grams[0], grams[1], rtol=1e-12)  # BLAS with fewer threads rounds otherwise


def test_blocks_hold_about_what_was_asked_for():
    class Large:
        shape = (1000, 47, 11248, 3)
        block_vertices = 128

    for block_mb, expected in ((64.0, 128), (150.0, 256), (20.0, 35)):
        blocks = BlockedTensor(Large(), None, block_mb).blocks()
        assert blocks[0] == (0, expected) and blocks[-1][1] == 11248
        assert all(a[1] == b[0] for a, b in pairwise(blocks))


def test_what_is_wrong_is_told(people, here):
    bad = people.copy()
    bad[3, 2, 650, 1] = np.nan
    with pytest.raises(ValueRangeError, match="must be finite"):
        nmode_svd(BlockedTensor(bad, here, 0.3), 3, 3)
    for wrong in ({"block_mb": 0.0}, {"block_mb": np.nan}, {"retries": -1}):
        with pytest.raises(ValueRangeError, match="must be"):
            BlockedTensor(people, here, **wrong)

    class Dies(Reversed):
        def run(self, function, calls, *, retries=0):
            yield Finished(next(calls)[0], error=RuntimeError("killed"), worker_died=True)

    with pytest.raises(FacewrightError, match="make blocks smaller"):
        nmode_svd(BlockedTensor(people, Dies(), 0.3), 3, 3)

    class Wrong:
        shape = people.shape

        def gram(self, mode, double, progress):
            return np.eye(3)

        def project(self, factors, mode, progress):
            return np.zeros((1, 1, 1), np.float32)

    with pytest.raises(ShapeError, match="gram must have"):
        nmode_svd(Wrong(), 3, 3)
    Wrong.gram = lambda self, mode, double, progress: gram_matrix(people, mode)
    with pytest.raises(ShapeError, match="projected tensor must have"):
        nmode_svd(Wrong(), 3, 3)
