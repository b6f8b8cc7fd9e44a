import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError
from facewright.models.nmode_svd import nmode_svd
from facewright.models.tensor_file import TensorFile


@pytest.fixture
def path(tmp_path, population):
    np.save(tmp_path / "t.npy", population)
    return tmp_path / "t.npy"


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_blocks_equal_slices(tmp_path, population, dtype):
    np.save(tmp_path / "t.npy", population.astype(dtype))
    file = TensorFile(tmp_path / "t.npy")
    assert file.shape == population.shape
    for start, stop in ((0, 7), (100, 180), (0, 180), (170, 999), (5, 5)):
        block = file[:, :, start:stop]
        assert block.dtype == dtype
        np.testing.assert_array_equal(block, population[:, :, start:stop])


def test_decomposition_from_disk_equals_that_in_memory(path, population):
    disk = nmode_svd(TensorFile(path), 5, 4, block_mb=0.05)
    memory = nmode_svd(population, 5, 4)
    np.testing.assert_allclose(disk.identity_factors, memory.identity_factors, atol=1e-4)
    np.testing.assert_allclose(disk.core, memory.core, atol=1e-2)


def test_wrong_files_are_refused(path, tmp_path, population):
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    with pytest.raises(FileFormatError, match=r"t\.npy must have \d+ bytes .* got"):
        TensorFile(path)
    path.write_bytes(data + b"x")
    with pytest.raises(FileFormatError, match="bytes"):
        TensorFile(path)
    for start in (b"", b"\x93NUM", data[:9], b"PK\x03\x04" * 10, b"\x93NUMPY\x09\x00" + data[8:]):
        path.write_bytes(start)
        with pytest.raises(FileFormatError, match=r"must be a \.npy file"):
            TensorFile(path)
    for array in (population[0], population.astype(np.float16), np.asfortranarray(population), population[..., :2]):
        np.save(path, array)
        with pytest.raises(FileFormatError, match="C-ordered float tensor"):
            TensorFile(path)
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="C-ordered float tensor"):
        TensorFile(path)
    with pytest.raises(StoreError, match="cannot be read"):
        TensorFile(tmp_path / "none.npy")


def test_file_that_changes_is_noticed(path):
    file = TensorFile(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(FileFormatError, match="shortened"):
        file[:, :, 0:10]
    path.unlink()
    with pytest.raises(StoreError, match="cannot be read"):
        file[:, :, 0:10]


def test_other_indices_are_refused(path):
    file = TensorFile(path)
    for index in ((slice(0, 2), slice(None), slice(None)), (slice(None), slice(None), slice(0, 9, 2))):
        with pytest.raises(IndexError, match="read as file"):
            file[index]
