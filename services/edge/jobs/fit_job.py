"""Second half of a job: fit a field to the points, publish its bundles to the store, report as wire messages."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import replace
from pathlib import Path

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.asset.assemble import publishing as publishing_message
from capture2vr.edge.capture_to_points import PREVIEW_SHARE, PreparedPoints, preview_share
from capture2vr.edge.engine.nouns import OpenEngine
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.field.device import Device
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.jobs.available_presets import capabilities_of
from capture2vr.edge.pipeline import PreviewKept, bundles
from capture2vr.edge.preset import AUTOMATIC, Preset, memory_bytes
from capture2vr.edge.progress import Bar, Progress
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.coded_messages import coded_progress, coded_published
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.sentences.documents import codes_as_json
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, Json
from capture2vr.storage.catalogue.job_versions import StaleFence
from capture2vr.storage.catalogue.publish import DEFAULT_POLICY, KeyElsewhere, PublishedAsset, PublishPolicy, publish
from capture2vr.storage.catalogue.visibility import parse_visibility
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

_log = logging.getLogger(__name__)


class FieldFitter:
    """Fits fields to points on `device`, within the memory budget, and publishes to `store`.

    presets  by name, the default first
    policy   by which it publishes
    encode   encoder of KTX2 textures; without it, targets that want KTX2 are refused
    engine   works at the tiles of large scenes; None: this process
    """

    def __init__(
        self,
        store: Store,
        presets: Mapping[str, Preset],
        device: Device,
        memory: MemoryBudget,
        policy: PublishPolicy = DEFAULT_POLICY,
        encode: EncodeKtx2 | None = None,
        engine: OpenEngine | None = None,
    ) -> None:
        self.store = store
        self._encode = encode
        self._engine = engine
        self._policy = policy
        self.presets = presets
        self.device = device
        self._memory = memory

    @property
    def offer(self) -> Capabilities:
        """The presets that fit in the memory budget, the device and the options that it has."""
        offer = capabilities_of(self.presets, self.device, self._memory.total_bytes)
        return replace(offer, ktx2=self._encode is not None)

    def fit(
        self, prepared: PreparedPoints, bar: Bar, request: ReconstructionRequest, checkpoint: Path, report: Report
    ) -> pb.Finished:
        """Run a job from its points on: fit, extract, publish. Raises EdgeError, and Cancelled as `report` does.

        Raises MEMORY_EXCEEDED after the preview where the fit needs more than this worker's whole budget; with the
        automatic preset the preview is the result then.
        """
        steps = bundles(
            prepared,
            self.presets[request.options.preset],
            bar,
            request.options,
            JobResources(self.device.name, checkpoint, self._encode, self._engine),
            share=preview_share(prepared.source.kind) if bar.reached else PREVIEW_SHARE,
            # Somebody who named a preset wants to know that it needs more; the automatic one makes the best of it.
            refuse=self._refusal if request.options.preset == AUTOMATIC else lambda preset, points: "",
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
                        report(coded_published(asset, step.manifest, request.options.collection))
                        publishing += time.perf_counter() - began
                        warnings, computing = step.manifest["warnings"], step.manifest["seconds"]
                        # Only the preview tells how much memory the fit takes. A preview may come again after the fit.
                        if step.state == "preview" and not has_room:
                            reserved.enter_context(self._make_room(step.manifest, request, report))
                            has_room = True
                    case PreviewKept():
                        warnings, computing = (*warnings, step.warning), step.seconds
        seconds = {"PUBLISHING": publishing, **computing}
        return pb.Finished(warnings=warnings, seconds=seconds, i18n=codes_as_json(warnings=warnings))

    def _publish_bundle(
        self, bundle: Bundle, request: ReconstructionRequest, reached: float, report: Report
    ) -> PublishedAsset:
        """Write a bundle to the store, unless the job is cancelled meanwhile: a scene's tiles take minutes.

        reached  fraction of the job that is done
        Raises EdgeError FENCE_STALE, KEY_ELSEWHERE, STORE_UNAVAILABLE, and Cancelled when `report` does.
        """
        publishing = coded_progress(publishing_message(bundle.state), stage=pb.PUBLISHING, fraction=reached)
        try:
            return publish(
                bundle,
                store_of_tenant(self.store, request.tenant),
                key=request.asset_key,
                job=request.job,
                fence=request.fence,
                collection=request.options.collection,
                visibility=parse_visibility(request.options.visibility),
                policy=replace(self._policy, anyway=request.options.publish_anyway, proceed=lambda: report(publishing)),
            )
        except StaleFence:
            message = say("another_worker_has_taken_over")
            raise EdgeError("FENCE_STALE", message) from None
        except KeyElsewhere as elsewhere:
            raise EdgeError("KEY_ELSEWHERE", str(elsewhere), hints=(say("choose_another_key"),)) from None
        except OSError as error:
            _log.warning("job %s: the bundle could not be written to the store: %s", request.job, error)
            message = say("result_could_not_be_written")
            raise EdgeError("STORE_UNAVAILABLE", message, hints=(say("try_again_later"),), retryable=True) from error

    def _refusal(self, preset: Preset, points: int) -> str:
        """Why a preset cannot be trained here on that many points: "" where the whole budget suffices."""
        needed, total = self._bytes(preset, points), self._memory.total_bytes
        if needed <= total:
            return ""
        return say("preset_needs_bytes_points_worker", preset=preset.name, needed=needed, points=points, total=total)

    def _too_large(self, manifest: Mapping[str, Json]) -> EdgeError | None:
        """The error MEMORY_EXCEEDED, where the fit after a preview needs more than the whole budget; else None."""
        points, total = int(manifest["points"]), self._memory.total_bytes
        refusal = self._refusal(self.presets[manifest["preset"]], points)
        if not refusal:
            return None
        small = [
            name for name, each in self.presets.items() if name != AUTOMATIC and self._bytes(each, points) <= total
        ]
        return EdgeError(
            "MEMORY_EXCEEDED",
            refusal,
            hints=(say("use_one", names=", ".join(small)), say("worker_with_larger_edge_memory")),
        )

    def _make_room(
        self, manifest: Mapping[str, Json], request: ReconstructionRequest, report: Report
    ) -> AbstractContextManager[None]:
        """Reserve the memory of the fit after a preview; where it needs more than the whole budget, refuse a preset
        that was named. The automatic one makes no fit then.
        """
        if (too_large := self._too_large(manifest)) is None:
            return self._reserve_memory(manifest, report)
        if request.options.preset != AUTOMATIC:
            raise too_large
        return nullcontext()

    def _reserve_memory(self, manifest: Mapping[str, Json], report: Report) -> AbstractContextManager[None]:
        """Reserve the memory of the fit after a preview, and wait until it is free."""
        waiting = coded_progress(say("waiting_memory_other_jobs_use"), stage=pb.FITTING)
        return self._memory.reserve(self._fit_bytes(manifest), lambda: report(waiting))

    def _fit_bytes(self, manifest: Mapping[str, Json]) -> int:
        """Memory that the fit after a preview takes, by the preview's manifest."""
        return self._bytes(self.presets[manifest["preset"]], int(manifest["points"]))

    def _bytes(self, preset: Preset, points: int) -> int:
        """Memory that a preset's fit or tiles take; 0 where neither follows the preview, which is finished by then."""
        return memory_bytes(preset, points, self.device.name) if preset.refines else 0


def to_wire(progress: Progress) -> pb.Progress:
    """Convert the pipeline's progress to the wire's message."""
    return coded_progress(progress.message, stage=progress.stage, fraction=progress.fraction, losses=progress.losses)
