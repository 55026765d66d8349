"""Second half of a job: fit a field to the points, publish its bundles to the store, report as wire messages."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from pathlib import Path

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.asset.target import target_of
from capture2vr.edge.capture_to_points import PREVIEW_SHARE, PreparedPoints, preview_share
from capture2vr.edge.engine.nouns import OpenEngine
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.field.device import Device
from capture2vr.edge.pipeline import PreviewKept, bundles
from capture2vr.edge.preset import AUTOMATIC, Preset, memory_bytes
from capture2vr.edge.progress import Bar, Progress
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.storage.bundle import Bundle, Json
from capture2vr.storage.catalogue.publish import KeyElsewhere, Publish, PublishedAsset, StaleFence, publish
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

_log = logging.getLogger(__name__)


class FieldFitter:
    """Fits fields to points on `device`, within the memory budget, and publishes to `store`.

    presets  by name
    encode   encoder of KTX2 textures, for targets that want them
    """

    def __init__(
        self,
        store: Store,
        presets: Mapping[str, Preset],
        device: Device,
        memory: MemoryBudget,
        publish: Publish = publish,
        encode: EncodeKtx2 | None = None,
        engine: OpenEngine | None = None,
    ) -> None:
        self._store = store
        self._encode = encode
        self._engine = engine
        self._publish = publish
        self._presets = presets
        self._device = device
        self._memory = memory

    def fit(
        self, prepared: PreparedPoints, bar: Bar, request: ReconstructionRequest, checkpoint: Path, report: Report
    ) -> pb.Finished:
        """Run a job from its points on: fit, extract, publish. Raises EdgeError, and Cancelled as `report` does.

        Raises MEMORY_EXCEEDED after the preview where the fit needs more than this worker's whole budget; with the
        automatic preset the preview is the result then.
        """
        steps = bundles(
            prepared,
            self._presets[request.preset],
            bar,
            share=preview_share(prepared.source.kind) if bar.reached else PREVIEW_SHARE,
            device=self._device.name,
            checkpoint=checkpoint,
            fill=request.fill,
            names=request.names,
            target=target_of(request.target),
            encode=self._encode,
            engine=self._engine,
            # Somebody who named a preset wants to know that it needs more; the automatic one makes the best of it.
            refuse=self._refusal if request.preset == AUTOMATIC else lambda preset, points: "",
        )
        publishing = 0.0
        warnings: Sequence[str] = ()
        computing: Mapping[str, float] = {}
        has_room = False
        # In this order: a training that is stopped frees its memory before the budget gives it to another job.
        with ExitStack() as reserved, closing(steps):
            for step in steps:
                match step:
                    case Progress():
                        report(to_wire(step))
                    case Bundle():
                        began = time.perf_counter()
                        asset = self._publish_bundle(step, request, bar.reached, report)
                        report(_published_message(asset, request.collection))
                        publishing += time.perf_counter() - began
                        warnings, computing = step.manifest["warnings"], step.manifest["seconds"]
                        # Only the preview tells how much memory the fit takes. A preview may come again after the fit.
                        if step.state == "preview" and not has_room:
                            too_large = self._too_large(step.manifest)
                            if too_large and request.preset != AUTOMATIC:
                                raise too_large
                            if not too_large:
                                reserved.enter_context(self._reserve_memory(step.manifest, report))
                            has_room = True
                    case PreviewKept():
                        warnings, computing = (*warnings, step.warning), step.seconds
        return pb.Finished(warnings=warnings, seconds={"PUBLISHING": publishing, **computing})

    def _publish_bundle(
        self, bundle: Bundle, request: ReconstructionRequest, reached: float, report: Report
    ) -> PublishedAsset:
        """Write a bundle to the store, unless the job is cancelled meanwhile: a scene's tiles take minutes.

        reached  fraction of the job that is done
        Raises EdgeError FENCE_STALE, KEY_ELSEWHERE, STORE_UNAVAILABLE, and Cancelled when `report` does.
        """
        publishing = pb.Progress(stage=pb.PUBLISHING, fraction=reached, message=f"publishing the {bundle.state}")
        try:
            return self._publish(
                bundle,
                store_of_tenant(self._store, request.tenant),
                key=request.asset_key,
                job=request.job,
                fence=request.fence,
                collection=request.collection,
                visibility=request.visibility,
                proceed=lambda: report(publishing),
            )
        except StaleFence:
            message = "another worker has taken over the job; the result of this one is discarded"
            raise EdgeError("FENCE_STALE", message) from None
        except KeyElsewhere as elsewhere:
            raise EdgeError("KEY_ELSEWHERE", str(elsewhere), hints=("choose another key",)) from None
        except OSError as error:
            _log.warning("job %s: the bundle could not be written to the store: %s", request.job, error)
            message = "the result could not be written to the store"
            raise EdgeError("STORE_UNAVAILABLE", message, hints=("try again later",), retryable=True) from error

    def _refusal(self, preset: Preset, points: int) -> str:
        """Why a preset cannot be trained here on that many points: "" where the whole budget suffices."""
        needed, total = self._bytes(preset, points), self._memory.total_bytes
        if needed <= total:
            return ""
        return f"preset {preset.name} needs {needed:,} bytes for {points:,} points; this worker has {total:,}"

    def _too_large(self, manifest: Mapping[str, Json]) -> EdgeError | None:
        """The error MEMORY_EXCEEDED, where the fit after a preview needs more than the whole budget; else None."""
        points, total = int(manifest["points"]), self._memory.total_bytes
        refusal = self._refusal(self._presets[manifest["preset"]], points)
        if not refusal:
            return None
        small = [
            name for name, each in self._presets.items() if name != AUTOMATIC and self._bytes(each, points) <= total
        ]
        return EdgeError(
            "MEMORY_EXCEEDED",
            refusal,
            hints=(f"use one of: {', '.join(small)}", "or a worker with a larger EDGE_MEMORY"),
        )

    def _reserve_memory(self, manifest: Mapping[str, Json], report: Report) -> AbstractContextManager[None]:
        """Reserve the memory of the fit after a preview, and wait until it is free."""
        waiting = pb.Progress(stage=pb.FITTING, message="waiting for memory that other jobs use")
        return self._memory.reserve(self._fit_bytes(manifest), lambda: report(waiting))

    def _fit_bytes(self, manifest: Mapping[str, Json]) -> int:
        """Memory that the fit after a preview takes, by the preview's manifest."""
        return self._bytes(self._presets[manifest["preset"]], int(manifest["points"]))

    def _bytes(self, preset: Preset, points: int) -> int:
        """Memory that a preset's fit or tiles take; 0 where neither follows the preview, which is finished by then."""
        return memory_bytes(preset, points, self._device.name) if preset.refines else 0


def to_wire(progress: Progress) -> pb.Progress:
    """Convert the pipeline's progress to the wire's message."""
    return pb.Progress(
        stage=progress.stage, fraction=progress.fraction, message=progress.message, losses=progress.losses
    )


def _published_message(asset: PublishedAsset, collection: str) -> pb.Published:
    return pb.Published(
        asset_key=asset.key,
        version=asset.version,
        state=asset.state,
        manifest=asset.manifest,
        collection=collection,
    )
