"""What people call an asset: a label, a description and tags, with the same limits in every service."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from capture2vr.order.one_line import one_line

LABEL_CHARS = 200
"""Most characters of a label: it is a caption in a headset, and nobody would read more."""
DESCRIPTION_CHARS = 2_000
MOST_LABELS = 20
WORD_CHARS = 50
"""Most characters of a tag."""


@dataclass(frozen=True, slots=True)
class AssetNames:
    """Names of an asset; what is empty is not named.

    label        one line, the caption
    description  some lines of text
    labels       tags, such as a season or a room; none twice, whatever its case
    """

    label: str = ""
    description: str = ""
    labels: tuple[str, ...] = ()

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> AssetNames:
        """Parse the names in a catalogue entry or a manifest; older ones have only a label."""
        labels = document.get("labels") or ()
        return cls(document.get("label") or "", document.get("description") or "", tuple(labels))

    @property
    def as_json(self) -> dict[str, Any]:
        """Serialise the names as JSON, for catalogue entries and manifests."""
        return {**asdict(self), "labels": list(self.labels)}

    def checked(self) -> AssetNames:
        """Return the names without spaces around them. Raises ValueError, which names what is wrong."""
        return AssetNames(check_label(self.label), check_description(self.description), check_labels(self.labels))


UNNAMED = AssetNames()
"""Of an asset that nobody has named."""


def check_label(text: str) -> str:
    """Return a label without spaces around it. Raises ValueError."""
    return _line("a label", text, LABEL_CHARS)


def check_description(text: str) -> str:
    """Return a description without spaces around it. Raises ValueError."""
    _require_length("a description", text, DESCRIPTION_CHARS)
    lines = text.replace("\r\n", "\n").strip().split("\n")
    return "\n".join(one_line(line.replace("\t", " ")).rstrip() for line in lines)


def check_labels(words: Iterable[str]) -> tuple[str, ...]:
    """Return tags without spaces around them, each once, in their order. Raises ValueError."""
    found: dict[str, str] = {}
    for word in words:
        line = _line("a tag", word, WORD_CHARS)
        found.setdefault(line.casefold(), line)
    if "" in found:
        raise ValueError("a tag is empty")
    if len(found) > MOST_LABELS:
        raise ValueError(f"an asset has at most {MOST_LABELS} tags, and these are {len(found)}")
    return tuple(found.values())


def _line(what: str, text: str, most: int) -> str:
    _require_length(what, text, most)
    return one_line(text).strip()


def _require_length(what: str, text: str, most: int) -> None:
    if len(text) > most:
        raise ValueError(f"{what} has at most {most:,} characters, and this one has {len(text):,}")
