"""Tell the encoding of a text: by its mark, its zero bytes, or what is valid in it."""

from __future__ import annotations

import codecs

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # before UTF-16's, with which it begins
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_ZEROS = 0.3  # share of zero bytes in which a text is UTF-16 without a mark: Latin letters and digits have one in two


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


def decode_text(data: bytes) -> str:
    """Decode a text; what is no character in its encoding becomes U+FFFD."""
    encoding, mark = encoding_of(data)
    return data[mark:].decode(encoding, "replace")
