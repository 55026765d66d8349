"""The notes of an asset's next version: carried into its frame where both versions are of one capture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from capture2vr.storage.bundle import Bundle, Json
from capture2vr.storage.catalogue.asset_notes import carry
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.store import Store


def notes_of_next_version(
    store: Store, present: Entry, document: Mapping[str, Json], bundle: Bundle
) -> list[dict[str, Any]]:
    """Return an asset's notes for its next version: carried into its frame where both are of one capture's."""
    before, after = present.document.get("capture_to_asset"), document.get("capture_to_asset")
    record = document["versions"][-1]
    same = record["job"] and record["job"] == present.record.get("job")
    if not before or not after or not (same or _capture_of(bundle.manifest) == _capture_in(store, present) != ""):
        return [each.as_json for each in present.notes]
    version = int(document["version"])
    return [
        (carry(each, before, after, version) if each.frame == present.version else each).as_json
        for each in present.notes
    ]


def _capture_in(store: Store, present: Entry) -> str:
    """Return the capture that the current version's recipe names; "" where none does, or its manifest is lost."""
    try:
        return _capture_of(json.loads(store.get(present.manifest)))
    except (FileNotFoundError, ValueError):
        return ""


def _capture_of(manifest: Mapping[str, Any]) -> str:
    return str((manifest.get("edits") or {}).get("capture") or "")
