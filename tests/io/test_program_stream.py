"""Program streams that were broken off."""

from pathlib import Path

import pytest

from facewright.io.program_stream import breaks_off

PACK_1 = b"\x00\x00\x01\xba" + b"\x21" + bytes(7)
PACK_2 = b"\x00\x00\x01\xba" + b"\x44" + bytes(8) + b"\xfa" + b"\xff\xff"
PICTURES = b"\x00\x00\x01\xe0" + (500).to_bytes(2, "big") + bytes(500)
END = b"\x00\x00\x01\xb9"


@pytest.mark.parametrize("pack", [PACK_1, PACK_2])
def test_whole_streams_and_broken_ones_are_told_apart(tmp_path: Path, pack: bytes) -> None:
    path, stream = tmp_path / "a.mpg", (pack + PICTURES) * 3
    for whole in (stream, stream + END, stream + b"\xff" * 900, (pack + PICTURES) * 900):
        path.write_bytes(whole)
        assert not breaks_off(path)
    packet = len(pack + PICTURES)
    for left in (1, 3, 5, 200, 499, len(PICTURES) - 2):
        path.write_bytes(stream[:-left])
        assert breaks_off(path), left
    path.write_bytes(stream[: 2 * packet + 9])  # within a pack's header
    assert breaks_off(path)


def test_what_is_no_program_stream_says_nothing(tmp_path: Path) -> None:
    for content in (b"", b"\x00" * 5000, b"something else"):
        (tmp_path / "a").write_bytes(content)
        assert not breaks_off(tmp_path / "a")
