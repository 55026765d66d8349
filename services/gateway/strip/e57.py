"""Strip E57 files (ASTM E2807): texts that say who scanned what, where and with which device, and the photos inside.

Points and poses stay. A file is a header of 48 bytes, binary sections, and an XML section that describes them. It lies
in pages of 1,024 bytes, each with a CRC-32C of its other 1,020, which is computed anew for the pages that change.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache

from capture2vr.gateway.strip.in_place import MOST_PARTS, Buffer, CleanResult, UnreadableError, unique_names
from capture2vr.sentences.sentence import say

_HEADER = struct.Struct("<8s2I4Q")  # magic, version, length of the file, offset and length of the XML, page size
_PAGE, _PAYLOAD = 1024, 1020
_MOST_XML = 16 << 20  # bytes; a thousand scans take one megabyte
_SECTION_HEADER = 16  # bytes of a blob before its content
# What readers need of the texts. The others are names, descriptions, serial numbers, and where on earth it is.
_ALLOWED_TEXTS = {b"formatName", b"guid"}
# Possessive, so that a hostile text costs no more than its length.
_TAG = re.compile(rb"<([\w:.-]++)([^<>]*+)>")
_TYPE = re.compile(rb"\btype\s*=\s*[\"'](String|Blob)[\"']")
_NUMBER = {name: re.compile(rb"\b" + name + rb"\s*=\s*[\"'](\d{1,18})[\"']") for name in (b"fileOffset", b"length")}
# XML has texts as they are, in CDATA sections, or as both; and comments.
_SECTIONS = ((b"<![CDATA[", b"]]>"), (b"<!--", b"-->"))
_MARKS = re.compile(rb"<!\[CDATA\[|\]\]>|<!--|-->")  # what is no text in these


def clean(data: Buffer) -> CleanResult:
    """Overwrite texts with blanks and photos with zeros, in place. Raises UnreadableError for a damaged file."""
    if len(data) < _HEADER.size:
        raise UnreadableError(say("e57_cut_short"))
    _, _, _, length, offset, xml_length, page = _HEADER.unpack_from(data, 0)
    if page != _PAGE or length > len(data) or xml_length > _MOST_XML or offset + xml_length > length:
        raise UnreadableError(say("e57_header_contradicts_file_damaged"))
    start = _logical(offset)
    xml = _read(data, start, xml_length)
    removed = []
    touched = set[int]()  # pages; each gets its checksum once, however many texts it has
    photos: dict[bytes, str] = {}
    for number, (tag, text, end) in enumerate(_elements(xml)):
        if number >= MOST_PARTS:
            raise UnreadableError(say("e57_has_too_many_texts"))
        name = tag[1].decode()
        if text is None:
            photos[tag[0]] = name
        elif tag[1] not in _ALLOWED_TEXTS and _MARKS.sub(b"", xml[text:end]).strip():
            _write(data, start + text, b" " * (end - text), touched)
            removed.append(name)
    removed += _blank_photos(data, photos, touched)
    _write_checksums(data, touched)
    return CleanResult(unique_names(removed), len(data))


def _elements(xml: bytes) -> Iterator[tuple[re.Match[bytes], int | None, int]]:
    """Yield the tag of each text and each blob; of a text also its first and end byte, of a blob None and 0."""
    at = 0
    while (tag := _TAG.search(xml, at)) is not None:
        at = tag.end()
        kind = _TYPE.search(tag[2])
        if kind is None:
            continue
        if kind[1] == b"Blob":
            yield tag, None, 0
        elif not tag[2].endswith(b"/"):
            at = _text_end(xml, tag.end())
            yield tag, tag.end(), at


def _text_end(xml: bytes, at: int) -> int:
    """Return where a text that begins at `at` ends: at the next tag that is in no CDATA section and no comment."""
    while (at := xml.find(b"<", at)) >= 0:
        ends = [end for begin, end in _SECTIONS if xml.startswith(begin, at)]
        if not ends:
            return at
        at = xml.find(ends[0], at)
        if at < 0:
            break
    return len(xml)


def _blank_photos(data: Buffer, photos: Mapping[bytes, str], touched: set[int]) -> list[str]:
    """Overwrite the content of all blobs, which are photos and their masks; return their names.

    photos  tag of each blob -> its name
    """
    removed, done = [], 0
    for tag, name in photos.items():
        at, length = (_NUMBER[key].search(tag) for key in (b"fileOffset", b"length"))
        if at is None or length is None:
            raise UnreadableError(say("e57_has_photo_without_place"))
        begin, count = _logical(int(at[1])) + _SECTION_HEADER, int(length[1])
        done += count
        if _physical(begin + count) > len(data) or done > len(data):
            raise UnreadableError(say("e57_has_photo_lies_beyond"))
        if _write_zeros(data, begin, count, touched):
            removed.append(name)
    return removed


def _logical(physical: int) -> int:
    """Convert an offset in the file to one in the file without its checksums."""
    return physical // _PAGE * _PAYLOAD + min(physical % _PAGE, _PAYLOAD)


def _physical(logical: int) -> int:
    return logical // _PAYLOAD * _PAGE + logical % _PAYLOAD


def _read(data: Buffer, start: int, count: int) -> bytes:
    """Read `count` bytes without the checksums, from the logical offset `start`."""
    first, last = start // _PAYLOAD, (start + count) // _PAYLOAD
    pages = b"".join(data[at * _PAGE : at * _PAGE + _PAYLOAD] for at in range(first, last + 1))
    return pages[start % _PAYLOAD :][:count]


def _write(data: Buffer, start: int, content: bytes, touched: set[int]) -> None:
    """Write bytes at a logical offset; the pages are added to `touched`, whose checksums are wrong then."""
    done = 0
    while done < len(content):
        page, within = divmod(start + done, _PAYLOAD)
        part = content[done : done + _PAYLOAD - within]
        at = page * _PAGE
        data[at + within : at + within + len(part)] = part
        touched.add(page)
        done += len(part)


def _write_checksums(data: Buffer, pages: Iterable[int]) -> None:
    """Compute the checksums of pages anew."""
    for page in sorted(pages):  # neighbours are often alike, and computed once
        at = page * _PAGE
        data[at + _PAYLOAD : at + _PAGE] = struct.pack(">I", _crc32c(bytes(data[at : at + _PAYLOAD])))


def _write_zeros(data: Buffer, start: int, count: int, touched: set[int]) -> bool:
    """Overwrite `count` bytes at a logical offset with zeros, page by page; return whether any was not zero."""
    changed = False
    for at in range(start - start % _PAYLOAD, start + count, _PAYLOAD):
        first, last = max(at, start), min(at + _PAYLOAD, start + count)
        if _read(data, first, last - first).strip(b"\0"):
            _write(data, first, bytes(last - first), touched)
            changed = True
    return changed


def _table() -> list[int]:
    """The remainders of all bytes by Castagnoli's polynomial, bits reversed (RFC 3720, appendix B.4)."""
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


_TABLE = _table()


@lru_cache(maxsize=4)  # most pages of a blanked photo are empty
def _crc32c(payload: bytes) -> int:
    value = 0xFFFFFFFF
    for byte in payload:
        value = _TABLE[(value ^ byte) & 0xFF] ^ value >> 8
    return value ^ 0xFFFFFFFF
