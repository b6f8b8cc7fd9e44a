import io
import struct
import zipfile

import numpy as np
import pytest

from facewright.errors import FileFormatError, StoreError
from facewright.io.container import MAGIC, read_container, write_container


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "a.fw"
    write_container(path, "test", 2, {"n": 3, "text": "é"}, {"one": b"12345", "empty": b"", "two": bytes(range(256))})
    return path


def test_round_trip(path):
    container = read_container(path, "test", 2)
    assert container.meta == {"n": 3, "text": "é"}
    assert {name: bytes(block) for name, block in container.blocks.items()} == {
        "one": b"12345",
        "empty": b"",
        "two": bytes(range(256)),
    }


def test_older_versions_are_read(path):
    assert read_container(path, "test", 7).meta["n"] == 3


def test_every_truncation_is_noticed(path):
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(FileFormatError, match=r"truncated|empty|corrupt"):
            read_container(path, "test", 2)
    path.write_bytes(data + b"x")
    with pytest.raises(FileFormatError, match="too long"):
        read_container(path, "test", 2)


def test_every_changed_byte_is_noticed(path):
    data = path.read_bytes()
    for position in range(len(data)):
        changed = bytearray(data)
        changed[position] ^= 0x10
        path.write_bytes(changed)
        if position in range(8, 12):  # the version: an older one reads the same content
            continue
        with pytest.raises(FileFormatError):
            read_container(path, "test", 2)


def foreign_files():
    archive, array = io.BytesIO(), io.BytesIO()
    np.savez(archive, id_mean=np.zeros(50), exp_gmm_means=np.zeros((1, 51)))
    np.save(array, np.zeros(4))
    empty_zip = io.BytesIO()
    zipfile.ZipFile(empty_zip, "w").close()
    return {
        "FaceScape": archive.getvalue(),
        "npy": array.getvalue(),
        "pickle": b"\x80\x04\x95",
        "gzip": b"\x1f\x8b\x08",
        "something else": b"v 1 2 3\n",
        "something": struct.pack("<iii", 46, 11510, 11540),
    }


@pytest.mark.parametrize("word", list(foreign_files()))
def test_foreign_files_are_named(tmp_path, word):
    path = tmp_path / "foreign.bin"
    path.write_bytes(foreign_files()[word])
    with pytest.raises(FileFormatError, match=rf"foreign\.bin must be a facewright test, got .*{word}"):
        read_container(path, "test", 2)


def test_text_mode_transfer_is_named(path):
    path.write_bytes(path.read_bytes().replace(b"\r\n", b"\n"))
    with pytest.raises(FileFormatError, match="line ends"):
        read_container(path, "test", 2)


def test_newer_version_and_other_kind(path):
    with pytest.raises(FileFormatError, match=r"version 2, this facewright reads up to 1; upgrade"):
        read_container(path, "test", 1)
    with pytest.raises(FileFormatError, match="must be a facewright bilinear model, got a facewright test"):
        read_container(path, "bilinear model", 2)


def test_claimed_sizes_are_not_believed(path):
    data = bytearray(path.read_bytes())
    data[12:16] = struct.pack("<I", 0xFFFFFFF0)
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="claims a header of 4294967280 bytes"):
        read_container(path, "test", 2)


@pytest.mark.parametrize(
    "header",
    [
        b"[]",
        b"{}",
        b"not json",
        b'{"kind":"test","meta":[],"blocks":{}}',
        b'{"kind":"test","meta":{},"blocks":{"a":[0,99999,0]}}',
        b'{"kind":"test","meta":{},"blocks":{"a":[-1,0,0]}}',
        b'{"kind":"test","meta":{},"blocks":{"a":"x"}}',
        b'{"kind":"test","meta":{},"blocks":{"a":[0,0,7]}}',
        b"[" * 100_000,
    ],
)
def test_well_formed_file_with_bad_header(tmp_path, header):
    import zlib

    path = tmp_path / "a.fw"
    path.write_bytes(struct.pack("<8sIIIQ", MAGIC, 1, len(header), zlib.crc32(header), 28 + len(header)) + header)
    with pytest.raises(FileFormatError, match="corrupt"):
        read_container(path, "test", 1)


def test_missing_file(tmp_path):
    with pytest.raises(StoreError, match=r"no\.fw cannot be read"):
        read_container(tmp_path / "no.fw", "test", 1)
    with pytest.raises(StoreError, match="cannot be read"):
        read_container(tmp_path, "test", 1)


def test_meta_must_be_json(tmp_path):
    with pytest.raises((TypeError, ValueError)):
        write_container(tmp_path / "a", "test", 1, {"x": object()}, {})
    assert list(tmp_path.iterdir()) == []
