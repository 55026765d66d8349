"""Pin notes to an asset, change and remove them: a new catalogue entry, and no new version."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.asset_notes import MOST_NOTES, Note, NoteRefused, Place, check_place, check_text, unit
from capture2vr.storage.catalogue.change_entry import change_entry
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.store import Store


class UnknownNote(LookupError):  # noqa: N818 - a mistake of who asks
    """An asset has no note of this id."""


def add_note(
    store: Store, key: str, *, text: str, at: Place, normal: Place | None, author: str, keys: Keys = NO_KEYS
) -> Note:
    """Pin a note to an asset's newest version and return it. Two at once are both kept.

    Raises NoteRefused, FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails: then
    the note may be there, so read the notes before another try.
    """
    made = f"note_{secrets.token_hex(8)}"

    def changes(present: Entry, now: str) -> dict[str, Any]:
        if len(present.notes) >= MOST_NOTES:
            raise NoteRefused(say("asset_has_most_notes_remove", most=MOST_NOTES))
        place = check_place(at, present.document)
        number = present.version
        note = Note(made, check_text(text), place, unit(normal), author, now, "", number, number)
        return _stored([*present.notes, note])

    return _note(change_entry(store, key, keys, changes), made)


def change_note(
    store: Store, key: str, note: str, *, text: str | None, at: Place | None, normal: Place | None, keys: Keys = NO_KEYS
) -> Note:
    """Change a note's text, or its place and normal, and return it; None stays as it is.

    A place that is given is one of the newest version. Idempotent but for the time. Raises as `add_note`, UnknownNote.
    """

    def changed(before: Note, present: Entry, now: str) -> Note:
        after = before if text is None else replace(before, text=check_text(text))
        if at is not None:
            place, number = check_place(at, present.document), present.version
            after = replace(after, at=place, normal=unit(normal), version=number, frame=number)
        return before if after == before else replace(after, edited=now)

    return _note(_change_one(store, key, note, keys, lambda *facts: [changed(*facts)]), note)


def remove_note(store: Store, key: str, note: str, keys: Keys = NO_KEYS) -> None:
    """Remove a note. Raises UnknownNote, FileNotFoundError, OSError (CatalogueFault too) where the store fails."""
    _change_one(store, key, note, keys, lambda *_: [])


def _change_one(
    store: Store, key: str, note: str, keys: Keys, change: Callable[[Note, Entry, str], list[Note]]
) -> Entry:
    """Put what `change` makes of a note in its place."""

    def changes(present: Entry, now: str) -> dict[str, Any]:
        _note(present, note)
        notes = [new for each in present.notes for new in (change(each, present, now) if each.id == note else [each])]
        return {} if notes == list(present.notes) else _stored(notes)

    return change_entry(store, key, keys, changes)


def _note(present: Entry, note: str) -> Note:
    for each in present.notes:
        if each.id == note:
            return each
    raise UnknownNote(say("asset_has_no_note", key=present.key, note=note))


def _stored(notes: list[Note]) -> dict[str, Any]:
    return {"notes": [each.as_json for each in notes]}
