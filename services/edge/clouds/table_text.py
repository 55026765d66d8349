"""Decode the text of a table: whatever its encoding and its ends of lines are, in pieces of whole lines."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

PIECE = 2**24  # bytes that are decoded at once: 50 MB as Python's lines, while a table may have a gigabyte
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # before UTF-16's, with which it begins
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_ZEROS = 0.3  # share of zero bytes in which a text is UTF-16 without a mark: Latin letters and digits have one in two
_LINE_ENDS = re.compile(r"\r\n?")


def encoding_of(head: bytes) -> tuple[str, int]:
    """Tell the encoding of a text by its first bytes, and how many of them mark it.

    Without a mark: UTF-16 by its zero bytes, UTF-8 where all is valid, else Windows-1252, as older programs write.
    """
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name, len(mark)
    for start, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head and head[start::2].count(0) > 2 * _ZEROS * len(head[start::2]):
            return name, 0
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)  # a character that is cut off at the end is no error
    except UnicodeDecodeError:
        return "cp1252", 0
    return "utf-8", 0


def decode_head(head: bytes) -> str:
    """Decode the first bytes of a text, with "\\n" at the end of its lines; what is no character becomes U+FFFD."""
    encoding, mark = encoding_of(head)
    return _LINE_ENDS.sub("\n", codecs.getincrementaldecoder(encoding)("replace").decode(head[mark:]))


def pieces(path: Path, encoding: str, mark: int) -> Iterator[str]:
    """Yield a file's text in pieces of whole lines, which end with "\\n"; only the last line may not.

    A line of more than PIECE bytes is a piece of its own, however long it is.
    """
    decoder, left = codecs.getincrementaldecoder(encoding)("replace"), ""
    with path.open("rb") as stream:
        stream.seek(mark)
        while data := stream.read(PIECE):
            text = left + decoder.decode(data)
            held = text.endswith("\r")  # perhaps half of an end of line
            text = _LINE_ENDS.sub("\n", text[:-1] if held else text) if "\r" in text else text
            end = text.rfind("\n") + 1
            left = text[end:] + ("\r" if held else "")
            if end:
                yield text[:end]
    left = _LINE_ENDS.sub("\n", left + decoder.decode(b"", final=True))
    if left:
        yield left
