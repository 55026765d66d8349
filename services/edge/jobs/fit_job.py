"""The second half of a job: points → bundles → store, told in the wire's words."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing
from pathlib import Path

from services.edge.api import edge_pb2 as pb
from services.edge.errors import EdgeError
from services.edge.field.device import Device
from services.edge.memory import Memory
from services.edge.mesh.ktx2 import Encode
from services.edge.pipeline import PreviewKept, bundles
from services.edge.prepare import PREVIEW_SHARE, preview_share
from services.edge.prepared import Prepared
from services.edge.preset import AUTOMATIC, Preset, memory_bytes
from services.edge.progress import Bar, Progress
from services.edge.requests import JobRequest
from services.edge.run import Say
from services.edge.target import target_of
from services.storage.bundle import Bundle, Json
from services.storage.publish import Asset, KeyElsewhere, Publish, StaleFence, publish
from services.storage.store import Store

_log = logging.getLogger(__name__)


class Fitter:
    """Fits fields to points on `device`, within `memory`, and publishes to `store`.

    presets  by name
    ktx2     packs textures as KTX2 for targets that ask for it
    """

    def __init__(
        self,
        store: Store,
        presets: Mapping[str, Preset],
        device: Device,
        memory: Memory,
        publish: Publish = publish,
        ktx2: Encode | None = None,
    ) -> None:
        self._store = store
        self._ktx2 = ktx2
        self._publish = publish
        self._presets = presets
        self._device = device
        self._memory = memory

    def fit(self, prepared: Prepared, bar: Bar, request: JobRequest, checkpoint: Path, say: Say) -> pb.Finished:
        """From points to the job's end, on what `bar` has left. Raises EdgeError, and Cancelled when `say` does."""
        steps = bundles(
            prepared,
            self._presets[request.preset],
            bar,
            share=preview_share(prepared.source.kind) if bar.reached else PREVIEW_SHARE,
            device=self._device.name,
            checkpoint=checkpoint,
            label=request.label,
            target=target_of(request.target, self._ktx2),
        )
        publishing = 0.0
        warnings: Sequence[str] = ()
        computing: Mapping[str, float] = {}
        has_room = False
        # In this order: a training that is given up lets go of its memory before another job hears that it is free.
        with ExitStack() as held, closing(steps):
            for step in steps:
                match step:
                    case Progress():
                        say(told(step))
                    case Bundle():
                        began = time.perf_counter()
                        say(_published(self._published(step, request), request.collection))
                        publishing += time.perf_counter() - began
                        warnings, computing = step.manifest["warnings"], step.manifest["seconds"]
                        # What the fit behind a preview takes is known only now; behind the fit it comes once more.
                        if step.state == "preview" and not has_room:
                            too_large = self._too_large(step.manifest)
                            if too_large and request.preset == AUTOMATIC:
                                warnings = (*warnings, f"the preview was kept: {too_large.message}")
                                break
                            if too_large:
                                raise too_large
                            held.enter_context(self._room_for(step.manifest, say))
                            has_room = True
                    case PreviewKept():
                        warnings, computing = (*warnings, step.warning), step.seconds
        return pb.Finished(warnings=warnings, seconds={"PUBLISHING": publishing, **computing})

    def _published(self, bundle: Bundle, request: JobRequest) -> Asset:
        """Raises EdgeError FENCE_STALE, KEY_ELSEWHERE, STORE_UNAVAILABLE."""
        try:
            return self._publish(
                bundle,
                self._store,
                key=request.asset_key,
                job=request.job,
                fence=request.fence,
                collection=request.collection,
            )
        except StaleFence:
            message = "another worker has taken the job over; what this one made is void"
            raise EdgeError("FENCE_STALE", message) from None
        except KeyElsewhere as elsewhere:
            raise EdgeError("KEY_ELSEWHERE", str(elsewhere), hints=("choose another key",)) from None
        except OSError as error:
            _log.warning("job %s: %s", request.job, error)
            message = "the result could not be written to the store"
            raise EdgeError("STORE_UNAVAILABLE", message, hints=("try again later",), retryable=True) from error

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


def told(progress: Progress) -> pb.Progress:
    """A pipeline's progress as the wire has it."""
    return pb.Progress(
        stage=progress.stage, fraction=progress.fraction, message=progress.message, losses=progress.losses
    )


def _published(asset: Asset, collection: str) -> pb.Published:
    return pb.Published(
        asset_key=asset.key,
        version=asset.version,
        state=asset.state,
        manifest=asset.manifest,
        collection=collection,
    )
