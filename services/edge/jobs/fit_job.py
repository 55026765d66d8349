"""The worker's part of a fit that a job's process does: publish its bundles to the store, and give it memory."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import replace

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.device import Device
from capture2vr.edge.jobs.available_presets import capabilities_of
from capture2vr.edge.jobs.job_process import Done, JobProcess, Kept, MadeBundle
from capture2vr.edge.jobs.job_task import Machine, fit_bytes, too_large
from capture2vr.edge.preset import AUTOMATIC, Preset
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.coded_messages import coded_progress, coded_published
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.sentences.documents import codes_as_json
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, Json
from capture2vr.storage.bundle import publishing as publishing_message
from capture2vr.storage.catalogue.job_versions import StaleFence
from capture2vr.storage.catalogue.publish import DEFAULT_POLICY, KeyElsewhere, PublishedAsset, PublishPolicy, publish
from capture2vr.storage.catalogue.visibility import parse_visibility
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

_log = logging.getLogger(__name__)


class FieldFitter:
    """Lets jobs' processes fit fields on `device`, within the memory budget, and publishes to `store`.

    presets  by name, the default first
    policy   by which it publishes
    machine  what its jobs may use; None: the device and the memory alone
    """

    def __init__(
        self,
        store: Store,
        presets: Mapping[str, Preset],
        device: Device,
        memory: MemoryBudget,
        policy: PublishPolicy = DEFAULT_POLICY,
        machine: Machine | None = None,
    ) -> None:
        self.store = store
        self.machine = machine or Machine(device.name, memory.total_bytes)
        self._policy = policy
        self.presets = presets
        self.device = device
        self._memory = memory

    @property
    def offer(self) -> Capabilities:
        """The presets that fit in the memory budget, the device and the options that it has. What asks a generator is
        offered where there is one."""
        has_generator = self.machine.generator is not None
        presets = {name: each for name, each in self.presets.items() if has_generator or not each.generates}
        offer = capabilities_of(presets, self.device, self._memory.total_bytes)
        return replace(offer, ktx2=self.machine.encode is not None)

    def publish_all(self, process: JobProcess, request: ReconstructionRequest, report: Report) -> pb.Finished:
        """Publish what a job's process makes, and reserve the memory of its fit, until it ends.

        Raises EdgeError, and Cancelled as `report` does; MEMORY_EXCEEDED after the preview where the fit needs more
        than this worker's whole budget; with the automatic preset the preview is the result then.
        """
        publishing = 0.0
        warnings: Sequence[str] = ()
        seconds: Mapping[str, float] = {}
        has_room = False
        # In this order: a training that is stopped frees its memory before the budget gives it to another job.
        with ExitStack() as reserved, closing(process.steps()) as steps:
            for step in steps:
                match step:
                    case MadeBundle(bundle, reached):
                        began = time.perf_counter()
                        asset = self._publish_bundle(bundle, request, reached, report)
                        report(coded_published(asset, bundle.manifest, request.options.collection))
                        publishing += time.perf_counter() - began
                        warnings, seconds = bundle.manifest["warnings"], bundle.manifest["seconds"]
                        # Only the preview tells how much memory the fit takes. A preview may come again after the fit.
                        if bundle.state == "preview" and not has_room:
                            reserved.enter_context(self._make_room(bundle.manifest, request, report))
                            has_room = True
                        process.drop_bundle()
                        process.go_on()
                    case Kept():
                        warnings, seconds = (*warnings, step.warning), step.seconds
                    case Done():
                        seconds = {**seconds, **step.seconds}
        return pb.Finished(
            warnings=warnings, seconds={"PUBLISHING": publishing, **seconds}, i18n=codes_as_json(warnings=warnings)
        )

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

    def _too_large(self, manifest: Mapping[str, Json]) -> EdgeError | None:
        """The error MEMORY_EXCEEDED, where the fit after a preview needs more than the whole budget; else None."""
        points, total = int(manifest["points"]), self._memory.total_bytes
        refusal = too_large(self.presets[manifest["preset"]], points, self.machine)
        if not refusal:
            return None
        small = [
            name
            for name, each in self.presets.items()
            if name != AUTOMATIC and fit_bytes(each, points, self.machine) <= total
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
        wanted = fit_bytes(self.presets[manifest["preset"]], int(manifest["points"]), self.machine)
        return self._memory.reserve(wanted, lambda: report(waiting))
