"""The worker's real work: archive → capture → bundles → store, told in the wire's words."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from services.edge.api import edge_pb2 as pb
from services.edge.capture import Capture, read_capture
from services.edge.errors import CaptureError, EdgeError
from services.edge.pipeline import STAGE_STARTS, Progress, reconstruct
from services.edge.preset import load_preset, preset_names
from services.edge.requests import JobRequest
from services.edge.run import Say
from services.storage.archives import ArchiveError, unpack
from services.storage.bundle import Bundle, Json
from services.storage.publish import Asset, StaleFence, publish
from services.storage.store import Store


class RealWork:
    """Reconstructs with the pipeline and publishes to `store`."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self.presets = preset_names()

    def reconstruct(self, archive: Path, request: JobRequest, scratch: Path, say: Say) -> pb.Finished:
        """The whole job. Raises EdgeError, and Cancelled when `say` does."""
        preset = load_preset(request.preset)
        say(_progress("VALIDATING", STAGE_STARTS["VALIDATING"], "reading the capture"))
        began = time.perf_counter()
        capture = _capture_of(archive, scratch)
        seconds = {"VALIDATING": time.perf_counter() - began, "PUBLISHING": 0.0}
        manifest: Mapping[str, Json] = {}
        for step in reconstruct(
            capture, preset, isolate=request.isolate, label=request.label, watch=lambda progress: say(_told(progress))
        ):
            match step:
                case Progress():
                    say(_told(step))
                case Bundle():
                    # The last word before the store: a job cancelled by now must publish nothing.
                    say(_progress("PUBLISHING", STAGE_STARTS["PUBLISHING"], f"publishing the {step.state}"))
                    began = time.perf_counter()
                    say(_published(_publish(step, self._store, request)))
                    seconds["PUBLISHING"] += time.perf_counter() - began
                    manifest = step.manifest
        return pb.Finished(warnings=manifest["warnings"], seconds={**seconds, **manifest["seconds"]})

    def inspect(self, archive: Path, scratch: Path) -> pb.Inspection:
        """What kind of capture it is. Raises EdgeError when it cannot be used."""
        capture = _capture_of(archive, scratch)
        return pb.Inspection(
            kind=capture.kind,
            format=capture.format,
            frames=len(capture.frames),
            points=len(capture.cloud.xyz) if capture.cloud else 0,
            warnings=capture.warnings,
        )


def _capture_of(archive: Path, scratch: Path) -> Capture:
    folder = scratch / "capture"
    try:
        unpack(archive, folder)
    except ArchiveError as error:
        raise CaptureError(error.code, error.message, file=error.file, hints=error.hints) from None
    return read_capture(folder)


def _publish(bundle: Bundle, store: Store, request: JobRequest) -> Asset:
    try:
        return publish(bundle, store, key=request.asset_key, job=request.job, fence=request.fence)
    except StaleFence:
        message = "another worker has taken the job over; what this one made is void"
        raise EdgeError("FENCE_STALE", message) from None
    except OSError as error:
        message = "the result could not be written to the store"
        raise EdgeError("STORE_UNAVAILABLE", message, hints=("try again later",), retryable=True) from error


def _published(asset: Asset) -> pb.Published:
    return pb.Published(asset_key=asset.key, version=asset.version, state=asset.state, manifest=asset.manifest)


def _told(progress: Progress) -> pb.Progress:
    return _progress(progress.stage, progress.fraction, progress.message, progress.losses)


def _progress(stage: str, fraction: float, message: str, losses: Mapping[str, float] | None = None) -> pb.Progress:
    return pb.Progress(stage=stage, fraction=fraction, message=message, losses=losses)
