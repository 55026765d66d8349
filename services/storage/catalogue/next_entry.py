"""The catalogue entry of an asset with a new version: its current one, or one that is held back beside it.

Held back is what its grade says to shoot again: made and stored, but in no list until somebody restores that version,
as any earlier one. It does not take the place of one that is served. Where there is none it is the asset's current
version, which its owner can open by the key.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture2vr.storage.bundle import Bundle, Json
from capture2vr.storage.catalogue.compare_and_swap import now_iso
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.catalogue.job_versions import ends_job
from capture2vr.storage.catalogue.stored_file import StoredFile

SCHEMA = 1
HELD_LEVEL = "shoot again"
MANIFEST_FIELDS = ("scale_confidence", "capture_to_asset", "bounds_m", "size_m", "origin")


def grade_in(manifest: Mapping[str, Json]) -> Mapping[str, Any] | None:
    """Return the grade in a manifest: level, because, advice; None where it has none, as of point clouds."""
    grade = (manifest.get("quality") or {}).get("grade")
    return grade if isinstance(grade, Mapping) and "level" in grade else None


def level_of(manifest: Mapping[str, Json]) -> str | None:
    """Return the level of the grade in a manifest; None where it has none."""
    grade = grade_in(manifest)
    return None if grade is None else str(grade["level"])


def new_record(
    present: Entry | None, bundle: Bundle, manifest: str, *, job: str, fence: int, held: bool
) -> dict[str, Any]:
    """Return the record of a bundle's version. manifest: its object name; held: whether it is held back"""
    versions = present.versions if present else []
    record = {
        "version": 1 + max((int(each["version"]) for each in versions), default=0),
        "state": bundle.state,
        "last": ends_job(bundle),
        "job": job,
        "fence": fence,
        "manifest": manifest,
        "created": now_iso(),
    }
    return {**record, "held": True} if held else record


def next_document(
    present: Entry | None,
    key: str,
    bundle: Bundle,
    files: list[StoredFile],
    manifest: StoredFile,
    record: dict[str, Any],
) -> dict[str, Json]:
    """Return the catalogue entry with `record` as its newest version: the current one, unless it is held back and
    another is served, or was removed.
    """
    versions = [*(present.versions if present else ()), record]
    if record.get("held") and present and (present.removed or not present.held):
        return {**present.document, "versions": versions}
    return {
        "schema": SCHEMA,
        "key": key,
        "version": record["version"],
        "state": bundle.state,
        "updated": record["created"],
        "manifest": {"name": manifest.name, "sha256": manifest.sha256, "bytes": manifest.size},
        "lods": lods_of(bundle.manifest, files),
        "preview": next((file.document() for file in files if file.file == "preview.png"), None),
        "files": [file.document() for file in files],
        "grade": level_of(bundle.manifest),
        **{field: bundle.manifest.get(field) for field in MANIFEST_FIELDS},
        "versions": versions,
    }


def lods_of(manifest: Mapping[str, Json], files: list[StoredFile]) -> list[dict[str, Any]]:
    """Return the manifest's levels of detail with each file's object name, hash and size, finest first."""
    documents = {file.file: file.document() for file in files}
    levels = ({**level, **documents[level["file"]]} for level in manifest.get("lods", ()))
    return sorted(levels, key=lambda level: int(level["level"]))
