"""Names for people: one line of text, without characters that control a terminal, a log or the order of the letters."""

from __future__ import annotations

import unicodedata

_REFUSED = frozenset(
    {"Cc", "Cs", "Zl", "Zp"}
)  # control characters, halves of a pair, separators of lines and paragraphs
# These turn the order in which the letters of a text are shown, so that a name can look like another one.
_TURNING = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def one_line(text: str) -> str:
    """Return the text unchanged. Raises ValueError for a text with a character that people cannot see as one."""
    for letter in text:
        if letter in _TURNING or unicodedata.category(letter) in _REFUSED:
            raise ValueError(f"a name has no control characters, and this one has U+{ord(letter):04X}")
    return text
