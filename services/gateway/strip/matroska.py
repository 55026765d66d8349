"""webm and mkv (RFC 8794, RFC 9559): tags, attachments, names and dates become Void; so do tracks of text and data.

What stays is listed, not what goes, and no byte moves. Checksums over what has changed go with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from services.gateway.uploads.cleaned import Buffer, Cleaned, UnreadableError, blank, is_blank, unique

_EBML, _SEGMENT, _INFO, _TRACKS, _CLUSTER = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
_TRACK, _NUMBER, _TYPE, _GROUP, _BLOCK, _SIMPLE_BLOCK = 0xAE, 0xD7, 0x83, 0xA0, 0xA1, 0xA3
_VOID, _CRC = 0xEC, 0xBF
_SEEK_HEAD, _CUES = 0x114D9B74, 0x1C53BB6B
_TOP = {_SEEK_HEAD, _INFO, _TRACKS, _CLUSTER, _CUES}
_IN_INFO = {0x2AD7B1, 0x4489, 0x4D80}  # scale of the times, duration, and the muxer, which readers ask for
_LEFT_TRACK = {0x536E}  # its name
_LEFT_GROUP = {0x75A1}  # what is added to a block
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
_KEPT_TYPES = {1, 2}  # picture and sound
_MOST_ELEMENTS = 400_000  # an hour of pictures and sound; they are held at 150 bytes each
_UNKNOWN = -1  # an element's size: those that are written while they are filmed end where the next one begins
_BROKEN = "the film's index is damaged"


@dataclass(frozen=True, slots=True)
class _Element:
    """`kind` is its EBML ID; the content lies from `body` to `end`."""

    kind: int
    start: int
    body: int
    end: int


@dataclass(slots=True)
class _Film:
    """gone: numbers of the removed tracks; elements: how many were looked at."""

    data: Buffer
    removed: list[str] = field(default_factory=list)
    gone: set[int] = field(default_factory=set)
    elements: int = 0


def clean(data: Buffer) -> Cleaned:
    """Metadata in place. Raises UnreadableError."""
    film = _Film(data)
    top = list(_elements(film, 0, len(data)))
    if not top or top[0].kind != _EBML:
        raise UnreadableError("this is no webm or mkv film, whatever its name says")
    for element in top[1:]:
        if element.kind == _SEGMENT:
            _clean_segment(film, element)
        else:
            _release(film, element)
    if not any(element.kind == _SEGMENT for element in top):
        raise UnreadableError("the film is cut short: nothing follows its header")
    return Cleaned(unique(film.removed), len(data))


def _clean_segment(film: _Film, segment: _Element) -> None:
    parts = list(_elements(film, segment.body, segment.end))
    if not any(part.kind == _TRACKS for part in parts):
        raise UnreadableError("the film has no index: it is cut short, or its recording was interrupted")
    changed = [_clean_part(film, part) for part in sorted(parts, key=lambda part: part.kind == _CLUSTER)]
    if any(changed):
        _release_checksums(film, parts)


def _clean_part(film: _Film, part: _Element) -> bool:
    """One of the segment's parts; whether anything in it has changed."""
    if part.kind not in (_INFO, _TRACKS, _CLUSTER):
        return _cleaned_leaf(film, part, part.kind in _TOP)
    children = list(_elements(film, part.body, part.end))
    cleaners = {_INFO: _clean_info, _TRACKS: _clean_track, _CLUSTER: _clean_block}
    changed = [cleaners[part.kind](film, child) for child in children]
    if any(changed):
        _release_checksums(film, children)
    return any(changed)


def _clean_info(film: _Film, element: _Element) -> bool:
    return _cleaned_leaf(film, element, element.kind in _IN_INFO)


def _clean_track(film: _Film, track: _Element) -> bool:
    """A track that is neither picture nor sound goes; of the others, the name."""
    if track.kind != _TRACK:
        return _cleaned_leaf(film, track, kept=False)
    children = list(_elements(film, track.body, track.end))
    facts = {child.kind: _integer(film.data, child) for child in children if child.kind in (_NUMBER, _TYPE)}
    if facts.get(_TYPE, 1) not in _KEPT_TYPES:
        film.gone.add(facts.get(_NUMBER, 0))
        _release(film, track, f"track type {facts[_TYPE]}")
        return True
    changed = [_cleaned_leaf(film, child, child.kind not in _LEFT_TRACK) for child in children]
    if any(changed):
        _release_checksums(film, children)
    return any(changed)


def _clean_block(film: _Film, element: _Element) -> bool:
    """A cluster's child: blocks of removed tracks go, and what other blocks have added to them."""
    if element.kind == _SIMPLE_BLOCK:
        return _cleaned_leaf(film, element, _block_track(film, element) not in film.gone)
    if element.kind != _GROUP:
        return _cleaned_leaf(film, element, kept=True)
    children = list(_elements(film, element.body, element.end))
    if any(child.kind == _BLOCK and _block_track(film, child) in film.gone for child in children):
        return _cleaned_leaf(film, element, kept=False)
    changed = [_cleaned_leaf(film, child, child.kind not in _LEFT_GROUP) for child in children]
    return any(changed)


def _cleaned_leaf(film: _Film, element: _Element, kept: bool) -> bool:
    """Void, or its content blanked where it is that already; whether anything has changed."""
    if element.kind == _VOID:
        filled = not is_blank(film.data, element.body, element.end)
        blank(film.data, element.body, element.end)
        return filled
    if kept or element.kind == _CRC:
        return False
    _release(film, element)
    return True


def _release(film: _Film, element: _Element, name: str = "") -> None:
    """Make it Void, which every reader skips, of the same length; `name` is how a report calls it."""
    data, length = film.data, element.end - element.start
    if element.kind not in (_VOID, _CRC, _SIMPLE_BLOCK, _GROUP):
        film.removed.append(name or _NAMES.get(element.kind, f"element {element.kind:X}"))
    size = bytes((0x80 | length - 2,)) if length < 9 else b"\x01" + (length - 9).to_bytes(7, "big")
    head = bytes((_VOID,)) + size
    data[element.start : element.start + len(head)] = head
    blank(data, element.start + len(head), element.end)


def _release_checksums(film: _Film, children: list[_Element]) -> None:
    for child in children:
        if child.kind == _CRC:
            _release(film, child)


def _block_track(film: _Film, block: _Element) -> int:
    return _number(film.data, block.body, block.end)[0]


def _integer(data: Buffer, element: _Element) -> int:
    if element.end - element.body > 8:
        raise UnreadableError(_BROKEN)
    return int.from_bytes(data[element.body : element.end], "big")


def _elements(film: _Film, start: int, end: int) -> Iterator[_Element]:
    """The elements side by side in a range. Raises UnreadableError when one leaves it, and when there are too many."""
    at = start
    while at < end:
        _count(film)
        kind, body = _kind(film.data, at, end)
        size, body = _number(film.data, body, end)
        stop = body + size
        if size == _UNKNOWN:
            stop = _open_end(film, kind, body, end)
        if stop > end:
            raise UnreadableError(f"the film is cut short: an element says {size:,} bytes, {end - body:,} are there")
        yield _Element(kind, at, body, stop)
        at = stop


def _count(film: _Film) -> None:
    film.elements += 1
    if film.elements > _MOST_ELEMENTS:
        raise UnreadableError(f"the film has more than {_MOST_ELEMENTS:,} elements")


def _open_end(film: _Film, kind: int, body: int, end: int) -> int:
    """Where an element of unknown size ends: only the segment and its clusters may be so."""
    if kind == _SEGMENT:
        return end
    if kind != _CLUSTER:
        raise UnreadableError(_BROKEN)
    at = body
    while at < end:
        _count(film)
        kind, after = _kind(film.data, at, end)
        if kind in _TOP or kind in _NAMES:
            return at
        size, after = _number(film.data, after, end)
        if size == _UNKNOWN or after + size > end:
            raise UnreadableError(_BROKEN)
        at = after + size
    return end


def _kind(data: Buffer, at: int, end: int) -> tuple[int, int]:
    """An EBML ID, its marker included, of one to four bytes; and where it ends."""
    length = 9 - data[at].bit_length()
    if length > 4 or at + length > end:
        raise UnreadableError(_BROKEN)
    return int.from_bytes(data[at : at + length], "big"), at + length


def _number(data: Buffer, at: int, end: int) -> tuple[int, int]:
    """An EBML variable-size integer of one to eight bytes, _UNKNOWN where all its bits are set; and where it ends."""
    length = 9 - data[at].bit_length() if at < end else 9
    if length > 8 or at + length > end:
        raise UnreadableError(_BROKEN)
    mask = (1 << 7 * length) - 1
    value = int.from_bytes(data[at : at + length], "big") & mask
    return (_UNKNOWN if value == mask else value), at + length
