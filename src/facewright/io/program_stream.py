"""Whether an MPEG program stream (.mpg, .vob) was broken off: it states no length, only its packets do."""

from __future__ import annotations

from pathlib import Path

_PREFIX, _PACK, _END = b"\x00\x00\x01", 0xBA, 0xB9
#: Of the file's end: what holds a pack in any case, whose packets have at most 65,541 bytes each.
_TAIL = 1 << 18


def breaks_off(path: Path) -> bool:
    """Tell whether the last packet of a program stream states more bytes than the file has.

    A file that was cut between two packets cannot be told from a whole one.
    """
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - _TAIL))
        tail = stream.read()
    at = tail.rfind(_PREFIX + bytes([_PACK]))
    while 0 <= at < len(tail):
        header = tail[at : at + 6]
        if not header.startswith(_PREFIX):
            return len(header) < 3  # else filling, or what we do not know
        if header[3:4] == bytes([_END]):
            return False
        if len(header) < 6:
            return True
        if header[3] == _PACK:  # MPEG-2: 14 bytes and stuffing; MPEG-1: 12
            two = header[4] >> 6 == 1
            if at + (14 if two else 12) > len(tail):
                return True
            at += 14 + (tail[at + 13] & 7) if two else 12
        else:
            at += 6 + int.from_bytes(header[4:6], "big")
    return at > len(tail)
