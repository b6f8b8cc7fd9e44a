import errno
import io
from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import FileFormatError, ShapeError, StoreError, ValueRangeError
from facewright.io.container import read_container, write_container
from facewright.models.bilinear_store import FORMAT_VERSION, KIND, load_bilinear, save_bilinear


@pytest.fixture
def saved(model, tmp_path):
    path = tmp_path / "model.fwbm"
    save_bilinear(model, path)
    return path


def test_round_trip_keeps_everything(model, saved):
    loaded = load_bilinear(saved)
    for name in (
        "identity_weights",
        "expression_weights",
        "identity_singular_values",
        "expression_singular_values",
        "identity_mean",
        "identity_covariance",
        "expression_mean",
        "expression_covariance",
    ):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(model, name), err_msg=name)
    assert loaded.expression_names == model.expression_names
    assert loaded.provenance["face"] == "grid"
    a, b = loaded.topology, model.topology
    assert (a.name, a.n_vertices, a.parts, a.fingerprint) == (b.name, b.n_vertices, b.parts, b.fingerprint)
    for name in ("faces", "quads", "uv", "uv_faces", "mirror"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        assert getattr(a, name).dtype == getattr(b, name).dtype
        assert getattr(a, name).flags.writeable
    for group in ("masks", "landmarks"):
        assert getattr(a, group).keys() == getattr(b, group).keys()
        for name, ids in getattr(b, group).items():
            np.testing.assert_array_equal(getattr(a, group)[name], ids)


@pytest.mark.parametrize("max_error_mm", [0.05, 0.5])
def test_stated_error_holds(model, tmp_path, max_error_mm):
    path = tmp_path / "model.fwbm"
    bound = save_bilinear(model, path, max_error_mm=max_error_mm)
    loaded = load_bilinear(path)
    assert loaded.provenance["stored_max_error_mm"] == bound <= max_error_mm
    float32_rounding_mm = 1e-4
    rng = np.random.default_rng(0)
    pairs = [(w_id, w_exp) for w_id in model.identity_weights for w_exp in model.expression_weights]
    sd = [np.sqrt(np.diag(c)) for c in (model.identity_covariance, model.expression_covariance)]
    for _ in range(300):  # corners of the box of 3 standard deviations
        pairs.append(
            (
                model.identity_mean + 3 * sd[0] * rng.choice([-1, 1], size=8),
                model.expression_mean + 3 * sd[1] * rng.choice([-1, 1], size=6),
            )
        )
    worst = max(np.linalg.norm(model.synthesise(*w) - loaded.synthesise(*w), axis=1).max() for w in pairs)
    assert 0 < worst <= bound + float32_rounding_mm


def test_model_without_optional_parts(model, tmp_path):
    topology = replace(
        model.topology, quads=None, uv=None, uv_faces=None, parts={}, masks={}, landmarks={}, mirror=None
    )
    private = replace(model, topology=topology, identity_weights=np.zeros((0, 8)), provenance={})
    save_bilinear(private, tmp_path / "m")
    loaded = load_bilinear(tmp_path / "m")
    assert loaded.identity_weights.shape == (0, 8)
    assert loaded.topology.quads is None
    assert loaded.topology.mirror is None


def test_identity_of_a_model(model, saved, tmp_path):
    """Saving, loading and saving again keep it; another core, shapes or truncation change it."""
    loaded = load_bilinear(saved)
    assert loaded.provenance["model_id"] == loaded.model_id == model.model_id
    save_bilinear(loaded, tmp_path / "again")
    assert load_bilinear(tmp_path / "again").model_id == model.model_id
    private = replace(model, identity_weights=np.zeros((0, model.n_identity)))
    assert private.model_id == model.model_id
    core = model.core_rows.copy()
    core[-1, -1, -1, -1] += 1e-3
    others = [replace(model, core_rows=core), replace(model, expression_weights=model.expression_weights[:, ::-1])]
    others.append(loaded.truncated(model.n_identity - 1, model.n_expression))
    assert len({other.model_id for other in (model, *others)}) == 4


def test_a_file_that_states_no_identity(saved):
    container = read_container(saved, KIND, FORMAT_VERSION)
    blocks = {name: bytes(block) for name, block in container.blocks.items()}
    del container.meta["provenance"]["model_id"]
    write_container(saved, KIND, FORMAT_VERSION, container.meta, blocks)
    first, second = load_bilinear(saved), load_bilinear(saved)
    assert first.provenance["model_id"] == second.provenance["model_id"] == first.model_id


def test_loaded_model_projects(model, saved, rng):
    loaded = load_bilinear(saved)
    w = model.in_gauge(model.sample_identity(rng), model.sample_expression(rng))
    np.testing.assert_allclose(loaded.project(model.synthesise(*w))[0], w[0], atol=0.02)


def test_saving_again_gives_the_same_bytes(model, saved, tmp_path):
    save_bilinear(model, tmp_path / "again")
    assert (tmp_path / "again").read_bytes() == saved.read_bytes()


def test_truncated_corrupt_empty(saved):
    data = saved.read_bytes()
    saved.write_bytes(data[: len(data) // 2])
    with pytest.raises(FileFormatError, match=r"model\.fwbm is truncated: expected \d+ bytes, got \d+"):
        load_bilinear(saved)
    rng = np.random.default_rng(0)
    for position in rng.integers(len(data), size=200):
        changed = bytearray(data)
        changed[position] ^= 1 << rng.integers(8)
        if bytes(changed[8:12]) != data[8:12]:
            continue
        saved.write_bytes(changed)
        with pytest.raises(FileFormatError, match=r"model\.fwbm"):
            load_bilinear(saved)
    saved.write_bytes(b"")
    with pytest.raises(FileFormatError, match="empty"):
        load_bilinear(saved)


def test_foreign_and_missing(tmp_path):
    buffer = io.BytesIO()
    np.savez(buffer, shape_bm_core=np.zeros((3, 2, 2)))
    (tmp_path / "facescape.npz").write_bytes(buffer.getvalue())
    with pytest.raises(FileFormatError, match=r"must be a facewright bilinear model, got a ZIP.*FaceScape"):
        load_bilinear(tmp_path / "facescape.npz")
    with pytest.raises(StoreError, match="No such file"):
        load_bilinear(tmp_path / "none.fwbm")


def test_newer_version(saved):
    container = read_container(saved, KIND, FORMAT_VERSION)
    blocks = {name: bytes(block) for name, block in container.blocks.items()}
    write_container(saved, KIND, FORMAT_VERSION + 1, container.meta, blocks)
    with pytest.raises(FileFormatError, match=f"version {FORMAT_VERSION + 1}.*upgrade"):
        load_bilinear(saved)


def edits():
    def drop(name):
        def edit(meta, blocks):
            del blocks[name]

        return edit

    def set_meta(*keys, value):
        def edit(meta, blocks):
            for key in keys[:-1]:
                meta = meta[key]
            meta[keys[-1]] = value

        return edit

    return {
        "missing block": drop("identity_mean"),
        "missing row": drop("core/3/0"),
        "no topology": set_meta("topology", value=None),
        "billions of vertices": set_meta("topology", "n_vertices", value=10**10),
        "one vertex less": set_meta("topology", "n_vertices", value=179),
        "negative vertices": set_meta("topology", "n_vertices", value=-5),
        "vertices as text": set_meta("topology", "n_vertices", value="many"),
        "huge array": set_meta("arrays", "identity_mean", value=["<f8", [10**12]]),
        "overflowing array": set_meta("arrays", "identity_mean", value=["<f8", [2**40, 2**40]]),
        "object array": set_meta("arrays", "identity_mean", value=["|O", [8]]),
        "fractional shape": set_meta("arrays", "identity_mean", value=["<f8", [8.5]]),
        "wrong shape": set_meta("arrays", "identity_mean", value=["<f8", [4, 2]]),
        "wrong count of planes": set_meta("planes", value=[2, 2]),
        "absurd planes": set_meta("planes", value=[10**9] * 8),
        "too few names": set_meta("expression_names", value=["neutral"]),
        "parts not ranges": set_meta("topology", "parts", value={"face": [1]}),
        "provenance not a mapping": set_meta("provenance", value=[1, 2]),
        "error not a number": set_meta("max_error_mm", value=None),
    }


@pytest.mark.parametrize("name", list(edits()))
def test_inconsistent_content_with_valid_checksums(saved, name):
    container = read_container(saved, KIND, FORMAT_VERSION)
    meta, blocks = dict(container.meta), {key: bytes(block) for key, block in container.blocks.items()}
    edits()[name](meta, blocks)
    write_container(saved, KIND, FORMAT_VERSION, meta, blocks)
    with pytest.raises(FileFormatError, match=r"model\.fwbm.* corrupt"):
        load_bilinear(saved)


def test_full_disk_and_interruption_leave_the_old_file(model, saved, monkeypatch):
    before = saved.read_bytes()
    for error, expected in ((OSError(errno.ENOSPC, "full"), StoreError), (KeyboardInterrupt(), KeyboardInterrupt)):

        def fail(fd, error=error):
            raise error

        monkeypatch.setattr("os.fsync", fail)
        with pytest.raises(expected):
            save_bilinear(model, saved)
        assert saved.read_bytes() == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_bad_arguments(model, tmp_path):
    with pytest.raises(ValueRangeError, match="max_error_mm"):
        save_bilinear(model, tmp_path / "m", max_error_mm=0)
    for value in (np.zeros(3), float("nan")):
        with pytest.raises(ValueRangeError, match="provenance"):
            save_bilinear(replace(model, provenance={"x": value}), tmp_path / "m")
    with pytest.raises(StoreError, match="does not exist"):
        save_bilinear(model, tmp_path / "no" / "m")
    assert list(tmp_path.iterdir()) == []


def test_labels_are_kept_and_belong_to_the_people(model, tmp_path):
    labels = {"age": tuple(20.5 + i for i in range(15)) + (None,), "sex": ("f", "m") * 8, "glasses": (True, False) * 8}
    labelled = replace(model, labels=labels)
    save_bilinear(labelled, tmp_path / "m")
    loaded = load_bilinear(tmp_path / "m")
    assert loaded.labels == labels and loaded.labels["glasses"][0] is True
    assert loaded.truncated(4, 3).labels == labels
    assert load_bilinear(tmp_path / "m").model_id == model.model_id
    with pytest.raises(ShapeError, match="one value for each of the 16 training people, got 2"):
        replace(model, labels={"age": (1.0, 2.0)})
    with pytest.raises(ShapeError, match="0 training people"):  # removing people for privacy must remove their labels
        replace(labelled, identity_weights=np.zeros((0, 8)))


def rewritten(path, change):
    """Write a model's container again with other labels in its header."""
    container = read_container(path, KIND, FORMAT_VERSION)
    meta = dict(container.meta)
    change(meta)
    write_container(path, KIND, FORMAT_VERSION, meta, {name: bytes(block) for name, block in container.blocks.items()})


def test_a_file_from_before_labels_has_none(saved):
    rewritten(saved, lambda meta: meta.pop("labels"))
    assert load_bilinear(saved).labels == {}


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"version": 2, "values": {}}, "labels of version 2, this program reads version 1; update facewright"),
        ({"version": 1, "values": {"age": [1, 2]}}, "corrupt: label 'age'"),
        ({"version": 1, "values": {"age": [[1]] * 16}}, "corrupt: label 'age'"),
        ({"version": 1, "values": {"age": 3}}, "corrupt"),
        ({"values": {}}, "corrupt"),
    ],
)
def test_refuses_other_labels(saved, labels, message):
    rewritten(saved, lambda meta: meta.update(labels=labels))
    with pytest.raises(FileFormatError, match=message):
        load_bilinear(saved)
