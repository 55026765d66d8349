"""Hold back versions whose grade says to shoot again: made and stored, but in no list until somebody keeps them.

A version that is held back does not take the place of one that is served. Where there is none it is the asset's current
version, which its owner can open by the key. Restoring it, as any earlier version, keeps it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture2vr.storage.bundle import Json

HELD_LEVEL = "shoot again"


def grade_in(manifest: Mapping[str, Json]) -> Mapping[str, Any] | None:
    """Return the grade in a manifest: level, because, advice; None where it has none, as of point clouds."""
    grade = (manifest.get("quality") or {}).get("grade")
    return grade if isinstance(grade, Mapping) and "level" in grade else None


def level_of(manifest: Mapping[str, Json]) -> str | None:
    """Return the level of the grade in a manifest; None where it has none."""
    grade = grade_in(manifest)
    return None if grade is None else str(grade["level"])


def is_held(record: Mapping[str, Any]) -> bool:
    """Return whether a version's record says that it is held back."""
    return bool(record.get("held"))
