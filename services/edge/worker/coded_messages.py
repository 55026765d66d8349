"""Wire messages with sentences for people: each carries the sentences' codes and values beside their English."""

from __future__ import annotations

from collections.abc import Mapping

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.sentences.documents import codes_as_json
from capture2vr.storage.bundle import Json
from capture2vr.storage.catalogue.next_entry import grade_in
from capture2vr.storage.catalogue.publish import PublishedAsset


def coded_progress(
    message: str,
    *,
    stage: pb.Stage | str = pb.STAGE_UNSPECIFIED,
    fraction: float = 0.0,
    losses: Mapping[str, float] | None = None,
) -> pb.Progress:
    """Return a progress report with its sentence's code."""
    i18n = codes_as_json(message=message)
    return pb.Progress(message=message, i18n=i18n, stage=stage, fraction=fraction, losses=losses)


def coded_failure(
    code: str, message: str, *, file: str = "", hints: tuple[str, ...] = (), retryable: bool = False
) -> pb.Failure:
    """Return a failure with its sentences' codes."""
    i18n = codes_as_json(message=message, hints=hints)
    return pb.Failure(code=code, message=message, file=file, hints=hints, retryable=retryable, i18n=i18n)


def coded_published(asset: PublishedAsset, manifest: Mapping[str, Json], collection: str) -> pb.Published:
    """Return the report of a published version, with its grade's sentences' codes. collection: that lists the asset"""
    grade = None
    if found := grade_in(manifest):
        because, advice = found["because"], found["advice"]
        i18n = codes_as_json(because=because, advice=advice)
        grade = pb.Grade(level=found["level"], because=because, advice=advice, i18n=i18n)
    return pb.Published(
        asset_key=asset.key,
        version=asset.version,
        state=asset.state,
        manifest=asset.manifest,
        collection=collection,
        grade=grade,
        held=asset.held,
    )
