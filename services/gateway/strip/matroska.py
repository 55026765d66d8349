"""Strip webm and mkv files (RFC 8794, RFC 9559): turn metadata, and tracks of text and data, into Void elements.

Metadata are tags, attachments, names and dates. Works with allow lists and moves no byte. Checksums of changed parts
are removed too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from capture2vr.gateway.strip.in_place import Buffer, CleanResult, UnreadableError, blank, is_blank, unique_names
from capture2vr.sentences.sentence import say

_EBML, _SEGMENT, _INFO, _TRACKS, _CLUSTER = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
_TRACK, _NUMBER, _TYPE, _GROUP, _BLOCK, _SIMPLE_BLOCK = 0xAE, 0xD7, 0x83, 0xA0, 0xA1, 0xA3
_VOID, _CRC = 0xEC, 0xBF
_SEEK_HEAD, _CUES = 0x114D9B74, 0x1C53BB6B
_ALLOWED_TOP = {_SEEK_HEAD, _INFO, _TRACKS, _CLUSTER, _CUES}
_ALLOWED_IN_INFO = {0x2AD7B1, 0x4489, 0x4D80}  # time scale, duration, and the muxer's name, which readers require
_REMOVED_IN_TRACK = {0x536E}  # the track's name
_REMOVED_IN_GROUP = {0x75A1}  # additional data of a block
_NAMES = {
    0x1254C367: "Tags",
    0x1941A469: "Attachments",
    0x1043A770: "Chapters",
    0x4461: "DateUTC",
    0x7BA9: "Title",
    0x5741: "WritingApp",
    0x7384: "SegmentFilename",
    0x73A4: "SegmentUUID",
    0x536E: "Name",
    0x75A1: "BlockAdditions",
}
_ALLOWED_TYPES = {1, 2}  # track types: video and audio
_MOST_ELEMENTS = 400_000  # an hour of video and audio; each takes 150 bytes of memory
_UNKNOWN_SIZE = -1  # of an element written during the recording: it ends where the next one begins
_BROKEN = say("video_index_damaged")


@dataclass(frozen=True, slots=True)
class _EbmlElement:
    """An element. kind: its EBML ID; its content lies from byte `body` to `end`."""

    kind: int
    start: int
    body: int
    end: int


@dataclass(slots=True)
class _MatroskaFilm:
    """State while a file is stripped. removed_tracks: their numbers; elements: how many were parsed"""

    data: Buffer
    removed: list[str] = field(default_factory=list)
    removed_tracks: set[int] = field(default_factory=set)
    elements: int = 0


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Raises UnreadableError."""
    film = _MatroskaFilm(data)
    top = list(_elements(film, 0, len(data)))
    if not top or top[0].kind != _EBML:
        raise UnreadableError(say("not_webm_mkv_video_although"))
    for element in top[1:]:
        if element.kind == _SEGMENT:
            _clean_segment(film, element)
        else:
            _make_void(film, element)
    if not any(element.kind == _SEGMENT for element in top):
        raise UnreadableError(say("video_cut_short_nothing_follows"))
    return CleanResult(unique_names(film.removed), len(data))


def _clean_segment(film: _MatroskaFilm, segment: _EbmlElement) -> None:
    parts = list(_elements(film, segment.body, segment.end))
    if not any(part.kind == _TRACKS for part in parts):
        raise UnreadableError(say("video_has_no_index_cut"))
    changed = [_clean_part(film, part) for part in sorted(parts, key=lambda part: part.kind == _CLUSTER)]
    if any(changed):
        _void_checksums(film, parts)


def _clean_part(film: _MatroskaFilm, part: _EbmlElement) -> bool:
    """Strip one of the segment's parts. Returns whether it has changed."""
    if part.kind not in (_INFO, _TRACKS, _CLUSTER):
        return _clean_leaf(film, part, part.kind in _ALLOWED_TOP)
    children = list(_elements(film, part.body, part.end))
    cleaners = {_INFO: _clean_info, _TRACKS: _clean_track, _CLUSTER: _clean_block}
    changed = [cleaners[part.kind](film, child) for child in children]
    if any(changed):
        _void_checksums(film, children)
    return any(changed)


def _clean_info(film: _MatroskaFilm, element: _EbmlElement) -> bool:
    return _clean_leaf(film, element, element.kind in _ALLOWED_IN_INFO)


def _clean_track(film: _MatroskaFilm, track: _EbmlElement) -> bool:
    """Remove a track that is neither video nor audio; remove the name of others. Returns whether it has changed."""
    if track.kind != _TRACK:
        return _clean_leaf(film, track, keep=False)
    children = list(_elements(film, track.body, track.end))
    facts = {child.kind: _integer(film.data, child) for child in children if child.kind in (_NUMBER, _TYPE)}
    if facts.get(_TYPE, 1) not in _ALLOWED_TYPES:
        film.removed_tracks.add(facts.get(_NUMBER, 0))
        _make_void(film, track, f"track type {facts[_TYPE]}")
        return True
    changed = [_clean_leaf(film, child, child.kind not in _REMOVED_IN_TRACK) for child in children]
    if any(changed):
        _void_checksums(film, children)
    return any(changed)


def _clean_block(film: _MatroskaFilm, element: _EbmlElement) -> bool:
    """Remove a block of a removed track, and the additional data of other blocks. Returns whether it has changed."""
    if element.kind == _SIMPLE_BLOCK:
        return _clean_leaf(film, element, _block_track(film, element) not in film.removed_tracks)
    if element.kind != _GROUP:
        return _clean_leaf(film, element, keep=True)
    children = list(_elements(film, element.body, element.end))
    if any(child.kind == _BLOCK and _block_track(film, child) in film.removed_tracks for child in children):
        return _clean_leaf(film, element, keep=False)
    changed = [_clean_leaf(film, child, child.kind not in _REMOVED_IN_GROUP) for child in children]
    return any(changed)


def _clean_leaf(film: _MatroskaFilm, element: _EbmlElement, keep: bool) -> bool:
    """Turn an element into Void unless it is to be kept; blank existing Void. Returns whether it has changed."""
    if element.kind == _VOID:
        filled = not is_blank(film.data, element.body, element.end)
        blank(film.data, element.body, element.end)
        return filled
    if keep or element.kind == _CRC:
        return False
    _make_void(film, element)
    return True


def _make_void(film: _MatroskaFilm, element: _EbmlElement, name: str = "") -> None:
    """Turn an element into Void of the same length, which every reader skips. name: for the list of removed metadata"""
    data, length = film.data, element.end - element.start
    if element.kind not in (_VOID, _CRC, _SIMPLE_BLOCK, _GROUP):
        film.removed.append(name or _NAMES.get(element.kind, f"element {element.kind:X}"))
    size = bytes((0x80 | length - 2,)) if length < 9 else b"\x01" + (length - 9).to_bytes(7, "big")
    head = bytes((_VOID,)) + size
    data[element.start : element.start + len(head)] = head
    blank(data, element.start + len(head), element.end)


def _void_checksums(film: _MatroskaFilm, children: list[_EbmlElement]) -> None:
    for child in children:
        if child.kind == _CRC:
            _make_void(film, child)


def _block_track(film: _MatroskaFilm, block: _EbmlElement) -> int:
    return _number(film.data, block.body, block.end)[0]


def _integer(data: Buffer, element: _EbmlElement) -> int:
    if element.end - element.body > 8:
        raise UnreadableError(_BROKEN)
    return int.from_bytes(data[element.body : element.end], "big")


def _elements(film: _MatroskaFilm, start: int, end: int) -> Iterator[_EbmlElement]:
    """Yield the consecutive elements in a range. Raises UnreadableError when one exceeds it, or there are too many."""
    at = start
    while at < end:
        _count(film)
        kind, body = _kind(film.data, at, end)
        size, body = _number(film.data, body, end)
        stop = body + size
        if size == _UNKNOWN_SIZE:
            stop = _open_end(film, kind, body, end)
        if stop > end:
            remaining = say("only_left", left=end - body)
            raise UnreadableError(say("video_cut_short_element_should", size=size, left=remaining))
        yield _EbmlElement(kind, at, body, stop)
        at = stop


def _count(film: _MatroskaFilm) -> None:
    film.elements += 1
    if film.elements > _MOST_ELEMENTS:
        raise UnreadableError(say("video_has_too_many_elements", most=_MOST_ELEMENTS))


def _open_end(film: _MatroskaFilm, kind: int, body: int, end: int) -> int:
    """Return the end of an element of unknown size. Only the segment and its clusters may have one."""
    if kind == _SEGMENT:
        return end
    if kind != _CLUSTER:
        raise UnreadableError(_BROKEN)
    at = body
    while at < end:
        _count(film)
        kind, after = _kind(film.data, at, end)
        if kind in _ALLOWED_TOP or kind in _NAMES:
            return at
        size, after = _number(film.data, after, end)
        if size == _UNKNOWN_SIZE or after + size > end:
            raise UnreadableError(_BROKEN)
        at = after + size
    return end


def _kind(data: Buffer, at: int, end: int) -> tuple[int, int]:
    """Read an EBML ID of one to four bytes, including its marker; returns it and the offset behind it."""
    length = 9 - data[at].bit_length()
    if length > 4 or at + length > end:
        raise UnreadableError(_BROKEN)
    return int.from_bytes(data[at : at + length], "big"), at + length


def _number(data: Buffer, at: int, end: int) -> tuple[int, int]:
    """Read an EBML variable-size integer of one to eight bytes; returns it and the offset behind it.

    _UNKNOWN_SIZE where all its bits are set.
    """
    length = 9 - data[at].bit_length() if at < end else 9
    if length > 8 or at + length > end:
        raise UnreadableError(_BROKEN)
    mask = (1 << 7 * length) - 1
    value = int.from_bytes(data[at : at + length], "big") & mask
    return (_UNKNOWN_SIZE if value == mask else value), at + length
