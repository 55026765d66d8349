"""Read a text line by line, or in pieces of whole lines, whatever its encoding and its ends of lines are."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from capture2vr.edge.capture.files import unreadable
from capture2vr.edge.capture.text_encoding import encoding_of
from capture2vr.sentences.sentence import say

PIECE = 2**24  # bytes that are decoded at once: 50 MB as Python's lines, while a table may have a gigabyte
_LONGEST = 2**24  # characters of a line; joining it piece by piece costs the square of its length
_MAX_LINE = 2**20  # bytes of a line of a mesh: a polygon of a hundred thousand corners
_LINE_ENDS = re.compile(r"\r\n?")


def decode_head(head: bytes) -> str:
    """Decode the first bytes of a text, with "\\n" at the end of its lines; what is no character becomes U+FFFD."""
    encoding, mark = encoding_of(head)
    return _LINE_ENDS.sub("\n", codecs.getincrementaldecoder(encoding)("replace").decode(head[mark:]))


def pieces(path: Path, encoding: str, mark: int) -> Iterator[str]:
    """Yield a file's text in pieces of whole lines, which end with "\\n"; only the last line may not.

    A line of more than _LONGEST characters comes in several pieces: no table has one, and it is not worth joining.
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
            elif len(left) > _LONGEST:
                yield left
                left = ""
    left = _LINE_ENDS.sub("\n", left + decoder.decode(b"", final=True))
    if left:
        yield left


def text_lines(data: bytes, file: str) -> Iterator[bytes]:
    """Yield the lines of a text one by one. Raises CAPTURE_UNREADABLE for a line that is too long."""
    for line in BytesIO(data if b"\n" in data else data.replace(b"\r", b"\n")):  # as on old Macs
        if len(line) > _MAX_LINE:
            raise unreadable(file, say("has_line_bytes_most_read", length=len(line), most=_MAX_LINE))
        yield line
