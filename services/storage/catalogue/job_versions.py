"""The versions that a job has published: which of them a bundle would only repeat, and under which fence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import Entry


class StaleFence(Exception):  # noqa: N818 - not a fault: the job has moved to another worker
    """The job was leased again since this worker began: its fencing token is outdated, its result is discarded."""


def existing_version(
    present: Entry | None, bundle: Bundle, job: str, fence: int, manifest: str = ""
) -> dict[str, Any] | None:
    """Return the published version that this bundle would only repeat, or None. Raises StaleFence."""
    versions = present.versions if present else []
    if not job:
        return next((each for each in versions[-1:] if each["manifest"] == manifest), None)
    job_versions = [each for each in versions if each["job"] == job]
    _check_fence(job_versions, job, fence)
    # A first preview that arrives after the job's last version must not replace it: return the last version instead.
    last = [] if ends_job(bundle) else [each for each in job_versions if is_last(each)]
    same = [each for each in job_versions if (each["state"], is_last(each)) == (bundle.state, ends_job(bundle))]
    return next(iter([*last, *same]), None)


def _check_fence(job_versions: Sequence[Mapping[str, Any]], job: str, fence: int) -> None:
    """Raises StaleFence where a job has published a version with a higher fence."""
    newest = max((int(each["fence"]) for each in job_versions), default=fence)
    if newest > fence:
        raise StaleFence(f"job {job} was leased again: it has published with fence {newest}, this is fence {fence}")


def ends_job(bundle: Bundle) -> bool:
    """Whether a job publishes nothing after this bundle; a refined one is always the last."""
    return bundle.last or bundle.state == "refined"


def is_last(record: Mapping[str, Any]) -> bool:
    """Whether a published version is its job's last. Entries of older workers do not say so."""
    return bool(record.get("last", record["state"] == "refined"))


def raise_fence(versions: list[dict[str, Any]], record: dict[str, Any], fence: int) -> list[dict[str, Any]]:
    """Return the versions with `record`'s fence raised, so that the job's earlier worker is refused from now on."""
    return [{**each, "fence": fence} if each["version"] == record["version"] else each for each in versions]
