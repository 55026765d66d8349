"""Strip mp4 and mov files: turn metadata boxes, and tracks that are neither video nor audio, into free space.

Phones write the location into `moov/udta/©xyz` or `moov/meta` (com.apple.quicktime.location.ISO6709); action cameras,
drones and Street View write it once a second into a metadata or subtitle track. Size and rotation are elsewhere.
Works with allow lists and moves no byte; of the media data, only samples of removed tracks are changed.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from capture2vr.gateway.strip.in_place import (
    MOST_PARTS,
    Buffer,
    CleanResult,
    UnreadableError,
    blank,
    blank_all,
    is_blank,
    read_metadata,
    unique_names,
)
from capture2vr.gateway.strip.iso_boxes import Box, boxes, find, free_box
from capture2vr.gateway.strip.panorama_tags import projection_of_video
from capture2vr.sentences.sentence import say

_UNUSED = {b"free", b"skip", b"wide"}
# Boxes that stay, by parent (ISO/IEC 14496-12, QuickTime File Format). Boxes that are no key here are not opened.
_ALLOWED_TOP = {b"ftyp", b"styp", b"moov", b"moof", b"mdat", b"mfra", b"sidx", b"ssix", b"pdin"}
_ALLOWED_WITHIN = {
    b"moov": {b"mvhd", b"trak", b"mvex", b"iods", b"ctab", b"clip", b"pssh"},
    b"trak": {b"tkhd", b"edts", b"tref", b"trgr", b"mdia", b"tapt", b"clip", b"matt", b"load"},
    b"mdia": {b"mdhd", b"hdlr", b"minf", b"elng"},
    b"minf": {b"vmhd", b"smhd", b"nmhd", b"gmhd", b"hdlr", b"dinf", b"stbl"},
    b"moof": {b"mfhd", b"traf", b"pssh"},
    b"traf": {b"tfhd", b"tfdt", b"trun", b"sbgp", b"sgpd", b"subs", b"saiz", b"saio", b"senc"},
}
_PICTURES = {b"vide", b"auxv", b"pict"}
_ALLOWED_TRACKS = _PICTURES | {b"soun", b"tmcd"}
_MOST_TRACKS = 32  # metadata tracks; phones write up to eight
_MOST_ENTRIES = 1_000_000  # of one sample table: nine hours at 30 Hz
_SPHERICAL = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")  # of Google's "Spherical Video V1"
_KEY = re.compile(rb"com\.[A-Za-z0-9.-]+")

Range = tuple[int, int]
"""First and end byte in the file."""


@dataclass(slots=True)
class _Mp4Film:
    """State while a file is stripped.

    media           ranges where samples may be
    removed_tracks  their numbers
    pictures        number of video tracks
    """

    data: Buffer
    media: Sequence[Range]
    removed: list[str] = field(default_factory=list)
    removed_tracks: list[int] = field(default_factory=list)
    pictures: int = 0


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Data behind the last box are to be cut off. Raises UnreadableError."""
    top = _top_boxes(data)
    if not any(box.kind == b"moov" for box in top):
        raise UnreadableError(say("video_has_no_index_cut"))
    film = _Mp4Film(data, [(box.body, box.end) for box in top if box.kind == b"mdat"])
    try:
        # moov first, because fragments refer to its tracks.
        _clean_boxes(film, sorted(top, key=lambda box: box.kind != b"moov"), _ALLOWED_TOP)
    except struct.error:
        raise UnreadableError(say("video_index_damaged")) from None
    if not film.pictures:
        raise UnreadableError(say("file_has_no_video_track"))
    if top[-1].end < len(data):
        film.removed.append("Trailer")
    return CleanResult(unique_names(film.removed), top[-1].end)


def clean_sequence(data: Buffer, index: Box, media: Sequence[Range]) -> list[str]:
    """Strip the index (moov box) of a video inside another file format; returns the names of removed metadata.

    media  ranges where its samples are
    """
    film = _Mp4Film(data, media)
    _clean_boxes(film, [index], {b"moov"})
    return film.removed


def _top_boxes(data: Buffer) -> list[Box]:
    """Return the file's top-level boxes.

    A file whose media data are cut short is accepted, being partly playable. What follows index and media and is no
    box is left out, as players do: some cameras write their own data behind the film, and a recording may break off.
    """
    found: list[Box] = []
    try:
        for box in boxes(data, 0, len(data)):
            found.append(box)  # noqa: PERF402 - the boxes before a broken one are needed
    except UnreadableError:
        kinds = {box.kind for box in found}
        at = found[-1].end if found else 0
        if b"moov" in kinds and data[at + 4 : at + 8] == b"mdat":
            found.append(Box(b"mdat", at, at + 8, len(data)))
        elif not {b"moov", b"mdat"} <= kinds or len(found) > MOST_PARTS:
            raise
    return found


def _clean_boxes(film: _Mp4Film, boxes_found: Iterable[Box], allowed: set[bytes]) -> None:
    """Strip consecutive boxes and the boxes within them."""
    for box in boxes_found:
        if box.kind in _UNUSED:
            blank(film.data, box.body, box.end)
        elif box.kind not in allowed:
            if not (box.kind == b"uuid" and _keep_projection(film, box)):
                _remove(film, box)
        elif box.kind == b"trak" and _handler(film.data, box) not in _ALLOWED_TRACKS:
            _remove_track(film, box)
        elif box.kind == b"traf" and _track_number(film.data, box, b"tfhd", 4) in film.removed_tracks:
            raise UnreadableError(say("video_fragmented_has_metadata_track"))
        elif box.kind in _ALLOWED_WITHIN:
            film.pictures += box.kind == b"trak" and _handler(film.data, box) in _PICTURES
            _clean_boxes(film, list(boxes(film.data, box.body, box.end)), _ALLOWED_WITHIN[box.kind])


def _remove(film: _Mp4Film, box: Box) -> None:
    if not is_blank(film.data, box.body, box.end):
        film.removed += _names(film.data, box)
    free_box(film.data, box)


def _keep_projection(film: _Mp4Film, box: Box) -> bool:
    """Leave of a box that describes a video of all sides its projection alone; return whether it is such a box."""
    if bytes(film.data[box.body : box.body + len(_SPHERICAL)]) != _SPHERICAL:
        return False
    start = box.body + len(_SPHERICAL)
    block = read_metadata(film.data, start, box.end)
    kept = projection_of_video(block)
    if kept and kept != block:
        film.data[start : box.end] = kept
        film.removed.append("SphericalVideo")
    return bool(kept)


def _remove_track(film: _Mp4Film, track: Box) -> None:
    film.removed.append(f"track {_handler(film.data, track).decode('latin-1')}")
    film.removed_tracks.append(_track_number(film.data, track, b"tkhd", 12))
    if len(film.removed_tracks) > _MOST_TRACKS:
        raise UnreadableError(say("video_has_too_many_metadata", most=_MOST_TRACKS))
    blank_all(film.data, _clip_to_media(_samples(film.data, track), film.media))
    free_box(film.data, track)


def _clip_to_media(ranges: Iterable[Range], media: Sequence[Range]) -> Iterator[Range]:
    """Intersect ranges with the media data, so that a hostile index cannot have other parts overwritten.

    media  in the order of the file
    """
    number, done = 0, 0
    for first, last in sorted(ranges):
        start, done = max(first, done), max(last, done)
        while number < len(media) and start < last:
            begin, end = max(start, media[number][0]), min(last, media[number][1])
            if begin < end:
                yield begin, end
            if media[number][1] >= last:
                break
            number += 1  # no later range begins before its end


def _names(data: Buffer, box: Box) -> list[str]:
    """Return names of the contents of a metadata box, for the list of removed metadata."""
    if box.kind == b"udta":
        try:
            kinds = [child.kind for child in boxes(data, box.body, box.end) if any(child.kind)]
        except UnreadableError:
            kinds = []
        return [kind.decode("latin-1") for kind in kinds] or ["udta"]
    keys = [key.decode() for key in _KEY.findall(data, box.body, box.end)] if box.kind == b"meta" else []
    return keys or [box.kind.decode("latin-1")]


def _handler(data: Buffer, track: Box) -> bytes:
    """Return the track's handler type. A track without one counts as video, which decoders will then refuse."""
    found = find(data, track, b"mdia", b"hdlr")
    return bytes(data[found.body + 8 : found.body + 12]) if found else b"vide"


def _track_number(data: Buffer, parent: Box, header: bytes, at: int) -> int:
    """Return the track number in a box's header, -1 where it has none. at: its offset in a version 0 header"""
    found = find(data, parent, header)
    if found is None:
        return -1
    wide = 8 if header == b"tkhd" and data[found.body] == 1 else 0
    return int(struct.unpack_from(">I", data, found.body + at + wide)[0])


def _samples(data: Buffer, track: Box) -> Iterator[Range]:
    """Yield the byte range of every chunk of the track's samples (ISO/IEC 14496-12, 8.7)."""
    table = find(data, track, b"mdia", b"minf", b"stbl")
    if table is None:
        return
    children = {box.kind: box.body for box in boxes(data, table.body, table.end)}
    if not (b"stsc" in children and children.keys() & {b"stsz", b"stz2"} and children.keys() & {b"stco", b"co64"}):
        return
    sizes = _sizes(data, children[b"stsz"]) if b"stsz" in children else _compact_sizes(data, children[b"stz2"])
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


def _compact_sizes(data: Buffer, body: int) -> tuple[int, ...]:
    """Read the table of sample sizes whose entries have 4, 8 or 16 bits."""
    bits = data[body + 7]
    if bits not in (4, 8, 16):
        raise UnreadableError(say("video_index_damaged_sample_sizes", bits=bits))
    count = _count(data, body + 8, 1)
    packed = data[body + 12 : body + 12 + (count * bits + 7) // 8]
    if bits == 16:
        return struct.unpack_from(f">{count}H", packed)
    return tuple(packed)[:count] if bits == 8 else tuple(half for byte in packed for half in (byte >> 4, byte & 15))


def _samples_per_chunk(data: Buffer, body: int, chunks: int) -> list[int]:
    """Expand the run-length coded sample-to-chunk table to one sample count per chunk."""
    flat = struct.unpack_from(f">{3 * _count(data, body + 4, 12)}I", data, body + 8)
    firsts, counts = flat[::3], flat[1::3]
    ends = [*firsts, chunks + 1][1:]  # an empty table is legal: the samples of a fragmented film are listed elsewhere
    spread: list[int] = []
    for first, end, count in zip(firsts, ends, counts, strict=True):
        spread += [count] * (min(end, chunks + 1) - first)
        if len(spread) >= chunks:
            break
    return (spread + [0] * chunks)[:chunks]


def _integers(data: Buffer, at: int, kind: str) -> tuple[int, ...]:
    """Read a table that begins with the number of its entries."""
    count = _count(data, at, struct.calcsize(">" + kind))
    table: tuple[int, ...] = struct.unpack_from(f">{count}{kind}", data, at + 4)
    return table


def _count(data: Buffer, at: int, size: int) -> int:
    """Read a number of entries of `size` bytes each. Raises UnreadableError where the file cannot have so many."""
    count = int(struct.unpack_from(">I", data, at)[0])
    if count > _MOST_ENTRIES or count * size > len(data):
        raise UnreadableError(say("video_index_damaged_entries", count=count))
    return count
