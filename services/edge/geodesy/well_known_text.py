"""Parse well-known text of coordinate reference systems, of version 1 (OGC 01-009) or 2 (ISO 19162), into a tree."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

MOST_CHARACTERS = 8_192
"""Of a text that is kept: those of maps have one to four thousand."""
_DEEPEST = 32  # brackets inside each other; real ones have eight
CODE = re.compile(r"EPSG:(\d{4,6})(?:\+(\d{4,6}))?")
_MOST_WITH_BLANKS = 2**16  # of a text of many lines
_SYSTEM = re.compile(
    r"(?:PROJCS|PROJCRS|PROJECTEDCRS|GEOGCS|GEOGCRS|GEOGRAPHICCRS|GEODCRS|GEODETICCRS|GEOCCS|COMPD_CS|COMPOUNDCRS|"
    r"LOCAL_CS|ENGCRS|ENGINEERINGCRS|BOUNDCRS|DERIVEDPROJCRS)\s*[\[(].*[\])]",
    re.IGNORECASE,
)
_REMARK = re.compile(r',\s*REMARK\s*[\[(]\s*"(?:[^"]|"")*+"\s*[\])]', re.IGNORECASE)  # anything of anybody
_TOKEN = re.compile(r'"((?:[^"]|"")*)"|([\[\](),])|([^\s\[\](),"]+)')


@dataclass(frozen=True, slots=True)
class WktNode:
    """KEYWORD["value", 1, OTHER[…]]: its keyword in capitals, its texts and numbers, and the nodes inside, in order."""

    keyword: str
    values: list[str] = field(default_factory=list)
    nodes: list[WktNode] = field(default_factory=list)

    def all_of(self, *keywords: str) -> Iterator[WktNode]:
        """Yield this node and those inside it, however deep, that have one of the keywords, in their order."""
        if self.keyword in keywords:
            yield self
        for node in self.nodes:
            yield from node.all_of(*keywords)

    def first(self, *keywords: str) -> WktNode | None:
        """Return the first of `all_of`, or None."""
        return next(self.all_of(*keywords), None)

    def own(self, *keywords: str) -> WktNode | None:
        """Return the last node right inside this one that has one of the keywords, or None."""
        return next((node for node in reversed(self.nodes) if node.keyword in keywords), None)

    def number(self, at: int = 1) -> float | None:
        """Return the value of that position as a number, None where it is none."""
        try:
            return float(self.values[at])
        except (IndexError, ValueError):
            return None


def tidy(text: str) -> str:
    """Return the text of a reference system in one line, without its remarks; "" where it is none's, is longer than
    MOST_CHARACTERS, or has what cannot be printed. The asset's manifest shows it: other texts are nobody's business."""
    whole = text.split("\0", 1)[0]
    line = "" if len(whole) > _MOST_WITH_BLANKS else _REMARK.sub("", " ".join(whole.split()))
    if CODE.fullmatch(line):
        return line
    is_system = line.isprintable() and _SYSTEM.fullmatch(line) is not None and parse_wkt(line) is not None
    return line if is_system else ""


def parse_wkt(text: str) -> WktNode | None:
    """Parse a text; None where it is none or more than one, is longer than MOST_CHARACTERS or nested too deeply."""
    if len(text) > MOST_CHARACTERS:
        return None
    root = WktNode("")
    open_nodes, word = [root], ""
    for match in _TOKEN.finditer(text):
        quoted, mark, bare = match.groups()
        if mark in ("[", "("):
            node = WktNode(word.upper())
            open_nodes[-1].nodes.append(node)
            open_nodes.append(node)
            word = ""
        elif mark is None:
            word = bare or ""
            if quoted is not None:
                open_nodes[-1].values.append(quoted)
        else:
            if word:
                open_nodes[-1].values.append(word)
            word = ""
            if mark != ",":
                open_nodes.pop()
        if not 0 < len(open_nodes) <= _DEEPEST:
            return None
    return root.nodes[0] if len(open_nodes) == len(root.nodes) == 1 and not root.values else None
