"""The tensor over people: every block equals the arrays it is made of; damage and rewriting are told."""

import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facewright.errors import FileFormatError, StoreError
from facewright.models.nmode_svd import nmode_svd
from facewright.warehouse.store import Warehouse

pytest.importorskip("zarr")

N = 5


@pytest.fixture
def people(store, make_subject):
    """Five people in a store, and their blendshapes as one array."""
    subjects = [make_subject(f"p{k}", seed=k) for k in range(N)]
    for subject in subjects:
        store.write_subject(subject)
    store.write_subject(make_subject("z_without", seed=9, blendshapes=False))
    return store, np.stack([subject.blendshapes for subject in subjects])


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 300), st.integers(0, N), st.integers(0, N)), max_size=6))
def test_any_sequence_of_blocks_equals_the_arrays(people, blocks):
    store, expected = people
    tensor = store.blendshape_tensor()
    assert tensor.shape == expected.shape and tensor.names == tuple(f"p{k}" for k in range(N))
    for a, b, m, n in blocks:
        found = tensor[min(m, n) : max(m, n), :, min(a, b) : max(a, b)]
        np.testing.assert_array_equal(found, expected[min(m, n) : max(m, n), :, min(a, b) : max(a, b)])


@pytest.mark.parametrize("step", [1, 50, 113, 128, 200, 300, 500])
def test_each_chunk_is_read_once_in_a_pass(people, step, monkeypatch):
    store, expected = people
    tensor = store.blendshape_tensor()
    decoded = []
    decode = type(tensor)._decode
    monkeypatch.setattr(type(tensor), "_decode", lambda self, n, *rest: decoded.append(n) or decode(self, n, *rest))
    blocks = [tensor[:, :, a : a + step] for a in range(0, 300, step)]
    np.testing.assert_array_equal(np.concatenate(blocks, axis=2), expected)
    assert len(decoded) == 3 * N
    assert tensor._kept is None  # nothing stays in memory after the pass


def test_decomposition_of_the_store_equals_that_of_the_array(people):
    store, expected = people
    # in double: single products leave 1e-4 of values that are a hundredth of the largest
    one = nmode_svd(store.blendshape_tensor(), N, 47, block_mb=0.05, precision="double")
    two = nmode_svd(expected, N, 47, precision="double")
    for svd in (one, two):
        full = np.einsum("ievc,ni,se->nsvc", svd.core, svd.identity_factors, svd.expression_factors)
        np.testing.assert_allclose(full, expected, atol=2e-3)
    np.testing.assert_allclose(one.identity_singular_values, two.identity_singular_values, rtol=1e-8)


def test_chosen_people_in_the_given_order(people):
    store, expected = people
    tensor = store.blendshape_tensor(["p3", "p0"])
    np.testing.assert_array_equal(tensor[:, :, 7:260], expected[[3, 0]][:, :, 7:260])
    copy = pickle.loads(pickle.dumps(tensor))
    np.testing.assert_array_equal(copy[1:2, :, :], expected[[0]])
    assert len(pickle.dumps(store.blendshape_tensor())) < 4000  # small on the way to a worker


def test_from_memory_as_from_an_object_store(grid_topology, make_subject):
    pytest.importorskip("fsspec")
    store = Warehouse.create("memory://tensor/faces.zarr", grid_topology, exist_ok=True)
    for k in range(3):
        store.write_subject(make_subject(f"p{k}", seed=k), overwrite=True)
    expected = np.stack([make_subject(seed=k).blendshapes for k in range(3)])
    np.testing.assert_array_equal(store.blendshape_tensor()[:, :, 90:290], expected[:, :, 90:290])


@pytest.mark.parametrize("index", [0, (slice(None), 0, slice(0, 5)), (slice(None), slice(None), slice(0, 9, 2))])
def test_other_slices_are_refused(people, index):
    with pytest.raises(IndexError, match="tensor"):
        people[0].blendshape_tensor()[index]


def test_people_without_blendshapes_are_refused(people, store):
    with pytest.raises(StoreError, match="no blendshapes for z_without"):
        store.blendshape_tensor(["p0", "z_without"])
    with pytest.raises(StoreError, match="no blendshapes for absent"):
        store.blendshape_tensor(["absent"])
    for name in store.subject_names():
        store.remove_subject(name)
    with pytest.raises(StoreError, match="no blendshapes for any subject"):
        store.blendshape_tensor()


@pytest.mark.parametrize("damage", ["bit in a chunk", "bit in the index", "truncated", "missing"])
def test_damage_names_the_subject(people, damage):
    store, _ = people
    tensor = store.blendshape_tensor()
    entry = store.entry("p2")
    path = store.objects.root / entry.folder / "blendshapes" / "c.0.0.0"
    data = bytearray(path.read_bytes())
    if damage == "missing":
        path.unlink()
    elif damage == "truncated":
        path.write_bytes(data[:-1000])
    else:
        data[1000 if damage == "bit in a chunk" else -10] ^= 1
        path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"blendshapes of subject 'p2' are (corrupt|missing)"):
        tensor[:, :, 0:300]


def test_a_subject_written_again_meanwhile_is_told(people, make_subject):
    store, _ = people
    tensor = store.blendshape_tensor()
    tensor[:, :, 0:10]
    store.write_subject(make_subject("p1", seed=7), overwrite=True)
    with pytest.raises(StoreError, match="'p1' was written again or removed"):
        tensor[:, :, 200:300]
    store.remove_subject("p4")
    with pytest.raises(StoreError, match="'p4' was written again or removed"):
        tensor[4:, :, 200:300]
