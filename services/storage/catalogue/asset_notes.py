"""Notes that people pin to places of an asset, with the same limits in every service."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from capture2vr.order.one_line import one_line

NOTE_CHARS = 500
"""Most characters of a note: more would not fit on a panel in a headset."""
MOST_NOTES = 100
_NEAR = 0.5  # of the longest side: a note stands inside the asset's box or so near to it
_MOST_M = 1e5  # of a coordinate where an entry says no bounds

Place = tuple[float, float, float]


class NoteRefused(ValueError):  # noqa: N818 - a mistake of who pins it
    """A note that cannot be pinned: too long, too far away, or one too many."""


@dataclass(frozen=True, slots=True)
class Note:
    """A text pinned to a place of an asset.

    at       metres, asset frame of `frame`
    normal   of the surface there, a unit vector, or None
    author   label of the access key that pinned it; "" where there was none
    created, edited  ISO 8601; edited is "" until it is
    version  of the asset on which it was pinned
    frame    version in whose frame `at` is: later than `version` where it was carried over
    """

    id: str
    text: str
    at: Place
    normal: Place | None
    author: str
    created: str
    edited: str
    version: int
    frame: int

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Note:
        """Parse a note from the JSON of a catalogue entry."""
        at, normal = stored["at"], stored["normal"]
        return cls(**{**stored, "at": triple(at), "normal": None if normal is None else triple(normal)})

    @property
    def as_json(self) -> dict[str, Any]:
        """Serialise the note as JSON, for a catalogue entry."""
        return {**asdict(self), "at": list(self.at), "normal": None if self.normal is None else list(self.normal)}


def notes_of(document: Mapping[str, Any]) -> tuple[Note, ...]:
    """Parse the notes of a catalogue entry, in the order in which they were pinned; older entries have none."""
    return tuple(map(Note.of, document.get("notes") or ()))


def check_text(text: str) -> str:
    """Return a note's text without spaces around it. Raises NoteRefused."""
    if len(text) > NOTE_CHARS:
        raise NoteRefused(f"a note has at most {NOTE_CHARS} characters, and this one has {len(text):,}")
    lines = text.replace("\r\n", "\n").strip().split("\n")
    try:
        checked = "\n".join(one_line(line.replace("\t", " ")).rstrip() for line in lines)
    except ValueError as error:
        raise NoteRefused(f"a note is plain text: {error}") from None
    if not checked:
        raise NoteRefused("a note needs a text")
    return checked


def check_place(at: Place, document: Mapping[str, Any]) -> Place:
    """Return a place that is inside the box of an entry's asset, or near it. Raises NoteRefused."""
    low, high = document.get("bounds_m") or ((-_MOST_M,) * 3, (_MOST_M,) * 3)
    near = _NEAR * max(end - begin for begin, end in zip(low, high, strict=True))
    inside = all(begin - near <= value <= end + near for value, begin, end in zip(at, low, high, strict=True))
    if not inside or not all(map(math.isfinite, at)):
        box = " × ".join(f"{begin:.3g} to {end:.3g}" for begin, end in zip(low, high, strict=True))
        raise NoteRefused(f"a note is pinned in the asset's box ({box} m) or near it, and this place is far away")
    return at


def unit(normal: Place | None) -> Place | None:
    """Return a direction of length 1, and None for None. Raises NoteRefused for one without a length."""
    if normal is None:
        return None
    length = math.hypot(*normal)
    if not math.isfinite(length) or length < 1e-9:
        raise NoteRefused("a note's normal needs a length")
    return (normal[0] / length, normal[1] / length, normal[2] / length)


def carry(note: Note, before: Sequence[float], after: Sequence[float], frame: int) -> Note:
    """Return a note in the frame of another version of the same capture.

    before, after  `capture_to_asset` of both versions: similarities (4,4), row by row
    """
    captured = [note.at[row] - before[4 * row + 3] for row in range(3)]
    squared = before[0] ** 2 + before[4] ** 2 + before[8] ** 2  # of the scale, by which a transpose becomes an inverse
    inner = [sum(before[4 * row + column] * captured[row] for row in range(3)) / squared for column in range(3)]
    at = [sum(after[4 * row + column] * inner[column] for column in range(3)) + after[4 * row + 3] for row in range(3)]
    normal = None if note.normal is None else unit(_turned(note.normal, before, after))
    return Note(**{**asdict(note), "at": triple(at), "normal": normal, "frame": frame})


def _turned(normal: Place, before: Sequence[float], after: Sequence[float]) -> Place:
    inner = [sum(before[4 * row + column] * normal[row] for row in range(3)) for column in range(3)]
    return triple([sum(after[4 * row + column] * inner[column] for column in range(3)) for row in range(3)])


def triple(values: Sequence[float]) -> Place:
    """Return three values as a place or a direction."""
    x, y, z = values
    return (float(x), float(y), float(z))
