"""The worker's real work: archive → capture → bundles → store, told in the wire's words."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from pathlib import Path

from services.edge.api import edge_pb2 as pb
from services.edge.capture import Capture, read_capture
from services.edge.errors import CaptureError, EdgeError
from services.edge.field.device import Device
from services.edge.guess.cutout import cut_out
from services.edge.memory import Memory
from services.edge.pipeline import PreviewKept, reconstruct
from services.edge.preset import AUTOMATIC, Preset, memory_bytes
from services.edge.progress import Progress
from services.edge.requests import JobRequest
from services.edge.run import Say
from services.edge.stock import offer_of
from services.storage.archives import ArchiveError, unpack
from services.storage.bundle import Bundle, Json
from services.storage.publish import Asset, StaleFence, publish
from services.storage.store import Store


class RealWork:
    """Reconstructs with the pipeline and publishes to `store`. presets: by name, the default first."""

    def __init__(self, store: Store, presets: Mapping[str, Preset], device: Device, memory: Memory) -> None:
        self._store = store
        self._presets = presets
        self._device = device
        self._memory = memory
        self.offer = offer_of(presets, device, memory.total_bytes)

    def reconstruct(self, archive: Path, request: JobRequest, scratch: Path, checkpoint: Path, say: Say) -> pb.Finished:
        """The whole job. Raises EdgeError, and Cancelled when `say` does."""
        say(pb.Progress(stage=pb.VALIDATING, message="reading the capture"))
        began = time.perf_counter()
        capture = _capture_of(archive, scratch)
        seconds = {"VALIDATING": time.perf_counter() - began, "PUBLISHING": 0.0}
        warnings: Sequence[str] = ()
        computing: Mapping[str, float] = {}
        # In this order: a training that is given up lets go of its memory before another job hears that it is free.
        with ExitStack() as held, closing(self._steps(capture, request, checkpoint, say)) as steps:
            for step in steps:
                match step:
                    case Progress():
                        say(_told(step))
                    case Bundle():
                        began = time.perf_counter()
                        say(_published(_publish(step, self._store, request)))
                        seconds["PUBLISHING"] += time.perf_counter() - began
                        warnings, computing = step.manifest["warnings"], step.manifest["seconds"]
                        if step.state == "preview":  # what the fit behind it takes is known only now
                            too_large = self._too_large(step.manifest)
                            if too_large and request.preset == AUTOMATIC:
                                warnings = (*warnings, f"the preview was kept: {too_large.message}")
                                break
                            if too_large:
                                raise too_large
                            held.enter_context(self._room_for(step.manifest, say))
                    case PreviewKept():
                        warnings, computing = (*warnings, step.warning), step.seconds
        return pb.Finished(warnings=warnings, seconds={**seconds, **computing})

    def inspect(self, archive: Path, scratch: Path) -> pb.Inspection:
        """What kind of capture it is. Raises EdgeError when it cannot be used."""
        capture = _capture_of(archive, scratch)
        if capture.kind == "image":
            cut_out(capture.photos[0])  # a photo of nothing is told from its pixels alone
        return pb.Inspection(
            kind=capture.kind,
            format=capture.format,
            frames=len(capture.frames) or len(capture.photos),
            points=len(capture.cloud.xyz) if capture.cloud else 0,
            warnings=capture.warnings,
        )

    def _steps(
        self, capture: Capture, request: JobRequest, checkpoint: Path, say: Say
    ) -> Generator[Progress | Bundle | PreviewKept, None, None]:
        yield from reconstruct(
            capture,
            self._presets[request.preset],
            device=self._device.name,
            checkpoint=checkpoint,
            isolate=request.isolate,
            longest_m=request.longest_m,
            label=request.label,
            watch=lambda progress: say(_told(progress)),
        )

    def _too_large(self, manifest: Mapping[str, Json]) -> EdgeError | None:
        """MEMORY_EXCEEDED, where the fit behind a preview never finds the memory that it takes."""
        wanted, total = self._wanted(manifest), self._memory.total_bytes
        if wanted <= total:
            return None
        points = int(manifest["points"])
        small = [
            name for name, each in self._presets.items() if name != AUTOMATIC and self._bytes(each, points) <= total
        ]
        return EdgeError(
            "MEMORY_EXCEEDED",
            f"preset {manifest['preset']} takes {wanted:,} bytes for {points:,} points; this worker has {total:,}",
            hints=(f"use one of: {', '.join(small)}", "or a worker with a larger EDGE_MEMORY"),
        )

    def _room_for(self, manifest: Mapping[str, Json], say: Say) -> AbstractContextManager[None]:
        """The memory of the fit behind a preview, waited for."""
        waiting = pb.Progress(stage=pb.FITTING, message="waiting for memory that other jobs hold")
        return self._memory.held(self._wanted(manifest), lambda: say(waiting))

    def _wanted(self, manifest: Mapping[str, Json]) -> int:
        return self._bytes(self._presets[manifest["preset"]], int(manifest["points"]))

    def _bytes(self, preset: Preset, points: int) -> int:
        """0 where nothing is trained: the preview stands before it is counted."""
        return memory_bytes(preset, points, self._device.name) if preset.fit else 0


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
    return pb.Progress(
        stage=progress.stage, fraction=progress.fraction, message=progress.message, losses=progress.losses
    )
