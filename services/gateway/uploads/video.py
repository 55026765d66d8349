"""mp4 and mov: user data and metadata become free space; so do tracks that are neither picture nor sound.

Phones write the place into `moov/udta/©xyz` or `moov/meta` (com.apple.quicktime.location.ISO6709); action cameras,
drones and Street View write it once a second into a metadata or subtitle track. Size and rotation are elsewhere.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from services.gateway.uploads.boxes import Box, boxes, find, release
from services.gateway.uploads.cleaned import Buffer, Cleaned, UnreadableError, blank, blank_all, unique

_METADATA = {b"udta", b"meta", b"uuid"}
_UNUSED = {b"free", b"skip"}
_CONTAINERS = {b"moov", b"trak", b"mdia", b"minf", b"moof", b"traf"}
_KEPT_TRACKS = {b"vide", b"auxv", b"pict", b"soun", b"tmcd"}
_DEEPEST = 8  # moov, trak, mdia, minf are the deepest that films have
_MOST_TRACKS = 32  # of metadata; phones write up to eight
_MOST_ENTRIES = 1_000_000  # of one table: nine hours at 30 Hz
_KEY = re.compile(rb"com\.[A-Za-z0-9.-]+")


def clean(data: Buffer) -> Cleaned:
    """Metadata in place. Raises UnreadableError."""
    top = list(boxes(data, 0, len(data)))
    if not any(box.kind == b"moov" for box in top):
        raise UnreadableError("the film has no index: it is cut short, or its recording was interrupted")
    removed: list[str] = []
    try:
        for box in top:
            clean_box(data, box, removed)
    except struct.error:
        raise UnreadableError("the film's index is damaged") from None
    return Cleaned(unique(removed), len(data))


def clean_box(data: Buffer, box: Box, removed: list[str], depth: int = 0) -> None:
    """One box and those within it."""
    if depth > _DEEPEST:
        raise UnreadableError("the film's index is damaged: its boxes are nested without end")
    if box.kind in _METADATA:
        removed += _names(data, box)
        release(data, box)
    elif box.kind in _UNUSED:
        blank(data, box.body, box.end)
    elif box.kind == b"trak" and _handler(data, box) not in _KEPT_TRACKS:
        removed.append(f"track {_handler(data, box).decode('latin-1')}")
        if sum(name.startswith("track ") for name in removed) > _MOST_TRACKS:
            raise UnreadableError(f"the film has more than {_MOST_TRACKS} tracks of metadata")
        blank_all(data, _samples(data, box))
        release(data, box)
    elif box.kind in _CONTAINERS:
        for child in list(boxes(data, box.body, box.end)):
            clean_box(data, child, removed, depth + 1)


def _names(data: Buffer, box: Box) -> list[str]:
    """What is in a metadata box, as far as a report can name it."""
    if box.kind == b"udta":
        try:
            kinds = [child.kind for child in boxes(data, box.body, box.end) if any(child.kind)]
        except UnreadableError:
            kinds = []
        return [kind.decode("latin-1") for kind in kinds] or ["udta"]
    keys = [key.decode() for key in _KEY.findall(data, box.body, box.end)]
    return keys or [box.kind.decode()]


def _handler(data: Buffer, track: Box) -> bytes:
    """The track's kind; a track that does not tell counts as a picture, which decoders will refuse by themselves."""
    found = find(data, track, b"mdia", b"hdlr")
    return bytes(data[found.body + 8 : found.body + 12]) if found else b"vide"


def _samples(data: Buffer, track: Box) -> Iterator[tuple[int, int]]:
    """First and end byte of every chunk of the track's samples (ISO/IEC 14496-12, 8.7)."""
    table = find(data, track, b"mdia", b"minf", b"stbl")
    if table is None:
        return
    children = {box.kind: box.body for box in boxes(data, table.body, table.end)}
    if not {b"stsc", b"stsz"} <= children.keys() or not children.keys() & {b"stco", b"co64"}:
        return
    sizes = _sizes(data, children[b"stsz"])
    offsets = (
        _integers(data, children[b"stco"] + 4, "I")
        if b"stco" in children
        else _integers(data, children[b"co64"] + 4, "Q")
    )
    sample = 0
    for offset, count in zip(offsets, _samples_per_chunk(data, children[b"stsc"], len(offsets)), strict=True):
        length = sum(sizes[sample : sample + count])
        sample += count
        yield offset, min(offset + length, len(data))


def _sizes(data: Buffer, body: int) -> tuple[int, ...]:
    common, count = struct.unpack_from(">II", data, body + 4)
    if common:
        return (int(common),) * min(int(count), _MOST_ENTRIES)
    return _integers(data, body + 8, "I")


def _samples_per_chunk(data: Buffer, body: int, chunks: int) -> list[int]:
    """The table's runs, spread out: one count per chunk."""
    flat = struct.unpack_from(f">{3 * _count(data, body + 4, 12)}I", data, body + 8)
    firsts, counts = flat[::3], flat[1::3]
    ends = [*firsts[1:], chunks + 1]
    spread: list[int] = []
    for first, end, count in zip(firsts, ends, counts, strict=True):
        spread += [count] * (min(end, chunks + 1) - first)
        if len(spread) >= chunks:
            break
    return (spread + [0] * chunks)[:chunks]


def _integers(data: Buffer, at: int, kind: str) -> tuple[int, ...]:
    """A table that begins with the number of its entries."""
    count = _count(data, at, struct.calcsize(">" + kind))
    table: tuple[int, ...] = struct.unpack_from(f">{count}{kind}", data, at + 4)
    return table


def _count(data: Buffer, at: int, size: int) -> int:
    """A believable number of entries of `size` bytes: a lie must not cost memory."""
    count = int(struct.unpack_from(">I", data, at)[0])
    if count > _MOST_ENTRIES or count * size > len(data):
        raise UnreadableError(f"the film's index is damaged: {count:,} entries in one table")
    return count
