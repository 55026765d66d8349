"""The worker's real work: archive → capture → points, and on to the store: here, or at the central worker."""

from __future__ import annotations

import logging
import time
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from services.edge.api import edge_pb2 as pb
from services.edge.arrays import Tick, no_tick
from services.edge.capture import Capture, read_capture
from services.edge.central import Central, CentralAway
from services.edge.errors import CaptureError, EdgeError
from services.edge.field.device import Device
from services.edge.fitter import Fitter, told
from services.edge.guess.cutout import cut_out
from services.edge.kept_points import keep, kept
from services.edge.memory import Memory
from services.edge.mesh.ktx2 import Encode
from services.edge.offer import Offer
from services.edge.prepare import prepare
from services.edge.prepared import Prepared, read_prepared
from services.edge.preset import Preset
from services.edge.progress import Bar, Progress
from services.edge.relay import hand_over, take_up
from services.edge.requests import JobRequest
from services.edge.run import Say
from services.edge.stock import offer_of
from services.storage.archives import ArchiveError, unpack
from services.storage.catalogue import DEFAULT_COLLECTION
from services.storage.publish import Publish, publish
from services.storage.store import Store

T = TypeVar("T")

_log = logging.getLogger(__name__)


class RealWork:
    """Reconstructs with the pipeline and publishes to `store`. presets: by name, the default first.

    With a `central` it makes the points and has that one fit the field, or fits it by itself where it must.
    What nobody named a collection for enters `collection`, wherever it is fitted. Targets that ask for KTX2 are refused
    without `ktx2`.
    """

    def __init__(
        self,
        store: Store,
        presets: Mapping[str, Preset],
        device: Device,
        memory: Memory,
        central: Central | None = None,
        publish: Publish = publish,
        collection: str = DEFAULT_COLLECTION,
        ktx2: Encode | None = None,
    ) -> None:
        self._fitter = Fitter(store, presets, device, memory, publish, ktx2)
        self._device = device
        self._own_offer = replace(offer_of(presets, device, memory.total_bytes), ktx2=ktx2)
        self._central = central
        self._collection = collection

    @property
    def offer(self) -> Offer:
        """Its own presets, and those of its central."""
        if (central := self._central) is None:
            return self._own_offer
        return self._own_offer.joined(central.address, central.presets, takes_jobs=central.takes_jobs)

    def reconstruct(self, archive: Path, request: JobRequest, scratch: Path, checkpoint: Path, say: Say) -> pb.Finished:
        """The whole job. Raises EdgeError, and Cancelled when `say` does."""
        request = replace(request, collection=request.collection or self._collection)
        if self._central and not request.prepared:  # those are fitted where they arrive: no job is handed on twice
            return self._shared(self._central, archive, request, scratch, checkpoint, say)
        bar = Bar(lambda progress: say(told(progress)))
        prepared, seconds = self._prepared(archive, request, scratch, bar, say)
        return _with_validating(self._fitter.fit(prepared, bar, request, checkpoint, say), seconds)

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

    def _shared(
        self, central: Central, archive: Path, request: JobRequest, scratch: Path, checkpoint: Path, say: Say
    ) -> pb.Finished:
        """The points here, unless they are there already, and the rest at central; all of it here where it must."""
        if (finished := take_up(central, request, say)) is not None:
            return finished
        bar = Bar(lambda progress: say(told(progress)))
        seconds = 0.0
        if (prepared := kept(checkpoint, scratch / "kept")) is None:
            prepared, seconds = self._prepared(archive, request, scratch, bar, say)
        try:
            finished = hand_over(central, keep(prepared, checkpoint), request, bar.reached, say)
        except CentralAway as away:
            _log.warning("job %s: %s", request.job, away)
            if not self._own_offer.has(request.preset):
                raise _unavailable(away, request.preset) from None
            finished = self._fitter.fit(_warned(prepared, f"{away}: fitted here"), bar, request, checkpoint, say)
        return _with_validating(finished, seconds)

    def _prepared(
        self, archive: Path, request: JobRequest, scratch: Path, bar: Bar, say: Say
    ) -> tuple[Prepared, float]:
        """The points of an archive, and the seconds that reading it took."""
        reading = pb.Progress(stage=pb.VALIDATING, message=f"reading the {'points' if request.prepared else 'capture'}")
        say(reading)
        began = time.perf_counter()
        if request.prepared:
            return read_prepared(archive, scratch / "prepared"), time.perf_counter() - began
        capture = _capture_of(archive, scratch, lambda fraction: say(reading))
        seconds = time.perf_counter() - began
        refines = self.offer.trains(request.preset)
        steps = prepare(
            capture,
            bar,
            refines=refines,
            device=self._device.name,
            isolate=request.isolate,
            longest_m=request.longest_m,
        )
        return _to_the_end(steps, say), seconds


def _to_the_end(steps: Generator[Progress, None, T], say: Say) -> T:
    """Say what is yielded; what is returned in the end."""
    with closing(steps):
        while True:
            try:
                say(told(next(steps)))
            except StopIteration as ended:
                result: T = ended.value
                return result


def _capture_of(archive: Path, scratch: Path, tick: Tick = no_tick) -> Capture:
    folder = scratch / "capture"
    try:
        unpack(archive, folder)
    except ArchiveError as error:
        raise CaptureError(error.code, error.message, file=error.file, hints=error.hints) from None
    return read_capture(folder, tick=tick)


def _warned(prepared: Prepared, warning: str) -> Prepared:
    points = prepared.points
    return replace(prepared, points=replace(points, warnings=(*points.warnings, warning)))


def _with_validating(finished: pb.Finished, seconds: float) -> pb.Finished:
    finished.seconds["VALIDATING"] += seconds
    return finished


def _unavailable(away: CentralAway, preset: str) -> EdgeError:
    message = f"{away}, and this worker does not offer preset {preset}"
    return EdgeError("CENTRAL_UNAVAILABLE", message, hints=("try again later",), retryable=True)
