"""`capture2vr notes`: list what is pinned to an asset, pin a note, remove one."""

from __future__ import annotations

import math
import re
from typing import Any

import httpx
from rich.text import Text

from capture2vr.cli.printable import printable
from capture2vr.cli.progress import print_listing
from capture2vr.client.answers import parse_answer
from capture2vr.client.http import open_gateway
from capture2vr.client.names import check_key
from capture2vr.errors import BadInput
from capture2vr.storage.catalogue.asset_notes import Note, Place

_NOTE_ID = re.compile(r"note_[0-9a-f]{16}", re.ASCII)


def change_notes(key: str, gateway: str, *, add: str, at: Place | None, remove: str) -> None:
    """Pin or remove a note where one is given, and print all that the asset then has. Raises BadInput."""
    check_key(key)
    if bool(add) != (at is not None):
        raise BadInput("a note needs its text and its place: give both --add TEXT and --at X Y Z")
    if at is not None and not all(map(math.isfinite, at)):
        raise BadInput("--at: give three numbers that are finite")
    # Dots and slashes in it would lead to another address, and the asset itself would be deleted.
    if remove and not _NOTE_ID.fullmatch(remove):
        raise BadInput(f"'{printable(remove)}' is not the id of a note: `capture2vr notes {key}` lists them")
    path = f"/v1/assets/{key}/notes"
    with open_gateway(gateway) as client:
        if add:
            parse_answer(client.post(path, json={"text": add, "at": at}))
        if remove:
            answer = client.delete(f"{path}/{remove}")
            if answer.status_code != httpx.codes.NO_CONTENT:
                parse_answer(answer)
        found: dict[str, Any] = parse_answer(client.get(path))
        lines = [_line(note, found["version"]) for note in map(Note.of, found["notes"])]
    for line in lines:
        print_listing(Text(printable(line)))


def _line(note: Note, version: int) -> str:
    place = " ".join(f"{value:.3f}" for value in note.at)
    displaced = "" if note.frame == version else f" (of version {note.version}, may be displaced)"
    return f"{note.id}  {place}{displaced}  {' / '.join(note.text.splitlines())}"
