"""Quick work for a real edge server, with none of the gateway's imports: a worker that is killed often starts often."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.coded_messages import coded_published
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.visibility import parse_visibility
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant


class Making:
    """Work whose capture says how it goes: {"steps": 3, "pause_s": 0.1, "fail": "CODE", "retryable": true, "wait": 1,
    "checkpoint": 1}

    Publishes a preview and a refined version behind it, really, to `store`; "fail_refining" is a code for in between,
    "grade" the level of both.
    """

    def __init__(self, store: Store, *presets: str) -> None:
        """presets: on offer, "draft" and "fine" where none is named."""
        names = presets or ("draft", "fine")
        self.offer = Capabilities("cpu", tuple(pb.Preset(name=name, summary="quick", memory_bytes=7) for name in names))
        self._store = store
        self.release = threading.Event()
        self.runs: list[str] = []

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        self.runs.append(request.job)
        script = json.loads(archive.read_bytes())
        steps = script.get("steps", 3)
        for step in range(steps):
            report(pb.Progress(stage=pb.FITTING, fraction=step / steps, losses={"distance": 1.0 / (step + 1)}))
            threading.Event().wait(script.get("pause_s", 0.0))
        if script.get("checkpoint"):
            checkpoint.touch()
        while script.get("wait") and not self.release.wait(0.02):
            report(pb.Progress(stage=pb.FITTING, fraction=0.9))
        if "fail" in script:
            raise EdgeError(script["fail"], "as it was told", file="a.ply", retryable=script.get("retryable", False))
        for state in ("preview", "refined"):
            manifest = {"lods": [], "quality": {"grade": _grade(script)}}
            bundle = Bundle(state=state, files={"mesh.ply": f"{request.job} {state}".encode()}, manifest=manifest)
            collection = request.options.collection or DEFAULT_COLLECTION
            made = publish(
                bundle,
                store_of_tenant(self._store, request.tenant),
                key=request.asset_key,
                job=request.job,
                fence=request.fence,
                collection=collection,
                visibility=parse_visibility(request.options.visibility),
                policy=PublishPolicy(anyway=request.options.publish_anyway),
            )
            report(coded_published(made, manifest, collection))
            if "fail_refining" in script:
                raise EdgeError(script["fail_refining"], "as it was told", hints=("use a coarser preset",))
        return pb.Finished(warnings=["looks odd"], seconds={"FITTING": 0.5})

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        script = json.loads(archive.read_bytes())
        if "fail" in script:
            raise EdgeError(script["fail"], "as it was told", file="a.ply", hints=("hold still",))
        return pb.Inspection(kind="points", format="ply", points=script.get("points", 7), warnings=["sparse"])


def _grade(script: Mapping[str, Any]) -> dict[str, str] | None:
    because, advice = say("surface_is_ragged", border=30.0), say("again_matt")
    return {"level": script["grade"], "because": because, "advice": advice} if "grade" in script else None


class ZipMaking(Making):
    """The same for captures that were really uploaded, which are zips: the script is the caller's."""

    def __init__(self, store: Store, script: Mapping[str, Any]) -> None:
        super().__init__(store)
        self._script = script

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        return super().reconstruct(self._scripted(archive), request, scratch, checkpoint, report)

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        return super().inspect(self._scripted(archive), scratch, box, tick)

    def _scripted(self, archive: Path) -> Path:
        script = archive.with_suffix(".json")
        script.write_text(json.dumps(dict(self._script)))
        return script
