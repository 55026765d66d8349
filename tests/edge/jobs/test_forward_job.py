"""Two workers on one job: the one near the phone makes the points, its central fits the field and publishes."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import grpc
import numpy as np
import pytest

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api.grpc_client import GrpcClient
from capture2vr.edge.capture_to_points import STARTS
from capture2vr.edge.field.device import find_device
from capture2vr.edge.jobs import central_client
from capture2vr.edge.jobs.available_presets import known_presets
from capture2vr.edge.jobs.central_client import Central, CentralUnavailable, Timeouts
from capture2vr.edge.jobs.fit_job import FieldFitter
from capture2vr.edge.jobs.points_archive import write_prepared
from capture2vr.edge.jobs.reconstruct_job import Reconstructor
from capture2vr.edge.worker.capabilities import POINTS_VERSION, Capabilities
from capture2vr.edge.worker.job_run import Work
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.server import EdgeServer
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store
from tests.edge.jobs.test_points_archive import prepared_points
from tests.edge.jobs.test_reconstruct_job import BRIEF, ENDLESS, archive, hemisphere_ply
from tests.support.captures import write_open3d
from tests.support.patience import CANCEL_S, PATIENCE_S
from tests.support.repository import ROOT
from tests.support.workers.edge_client import Client, Scripted, leftovers, until, worker

pytestmark = [pytest.mark.usefixtures("small_pictures"), pytest.mark.slow]

# Generous where a busy machine could be taken for a lost one; short where the tests wait for the end of it.
QUICK = Timeouts(answer_s=3.0, admit_s=10.0, silence_s=15.0, lost_s=2.0, cancel_s=10.0, refresh_s=0.1)
PLENTY = 1 << 40


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


@pytest.fixture
def dome(tmp_path: Path) -> bytes:
    return archive(tmp_path, dome_ply=hemisphere_ply(400))


# A quick one without training, for tests that look at what happens around it.
QUICK_PRESET = """
resolution = 32
lod_faces = [2000]
"""


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    """The presets of a worker near the phone."""
    folder = tmp_path / "quick"
    folder.mkdir()
    (folder / "quick.toml").write_text(QUICK_PRESET)
    return folder


@pytest.fixture
def all_presets(tmp_path: Path) -> Path:
    """Those of its central, of which it does not have all."""
    folder = tmp_path / "all"
    folder.mkdir()
    for name, text in {"quick": QUICK_PRESET, "endless": ENDLESS, "brief": BRIEF}.items():
        (folder / f"{name}.toml").write_text(text)
    return folder


def real_work(store: Store, presets: Path | None = None, central: Central | None = None) -> Reconstructor:
    return Reconstructor(FieldFitter(store, known_presets(presets), find_device("cpu"), MemoryBudget(PLENTY)), central)


@asynccontextmanager
async def listening(work: Work, scratch: Path, **settings: object) -> AsyncIterator[tuple[Client, str]]:
    """A worker in this process and its address."""
    hurry = asyncio.Event()
    hurry.set()
    place = Scratch(scratch)
    with place.claim():
        server = EdgeServer(EdgeSettings(port=0, scratch=scratch, **settings), work, place)
        address = f"127.0.0.1:{await server.start()}"
        try:
            async with grpc.aio.insecure_channel(address) as channel:
                yield Client(channel), address
        finally:
            await server.drain(hurry)


@contextmanager
def reaching(address: str, patience: Timeouts = QUICK) -> Iterator[Central]:
    central = Central(address, patience)
    try:
        yield central
    finally:
        central.close()


@asynccontextmanager
async def pair(store: Store, folder: Path, presets: Path, quick: Path) -> AsyncIterator[tuple[Client, Client]]:
    """(edge, central): two real workers with scratches of their own and one store."""
    async with listening(real_work(store, presets), folder / "central") as (theirs, address):
        with reaching(address) as central:
            async with worker(real_work(store, quick, central), folder / "edge", slots=2) as ours:
                await until(lambda: central.takes_jobs)
                yield ours, theirs


def timeless(manifest: dict[str, Any]) -> dict[str, Any]:
    """A manifest without the seconds that anything took, and so without its own name."""
    quality = {name: value for name, value in manifest["quality"].items() if name not in ("seconds", "preview")}
    return {**manifest, "seconds": sorted(manifest["seconds"]), "quality": quality}


def kinds(events: list[pb.Event]) -> list[str]:
    return [str(event.WhichOneof("what")) for event in events]


async def test_the_bundle_is_that_of_a_lone_worker(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    edits = '{"planes": [{"point": [0, 0.2, 0], "normal": [0, 1, 0]}], "up": [0, 1, 0.1]}'  # applied once
    asked = {"asset_key": "dome", "label": "Dome", "preset": "quick", "longest_m": 0.5, "collection": "ada"}
    asked |= {"edits": edits}
    alone = MemoryStore()
    async with worker(real_work(alone, quick), tmp_path / "alone") as client:
        assert (await client.ended(dome, **asked))[-1].HasField("finished")
    async with pair(store, tmp_path, quick, quick) as (edge, central):
        events = await edge.ended(dome, **asked)
        theirs = await central.attached()
        assert (await edge.worker()).central
        assert leftovers(tmp_path / "edge") == leftovers(tmp_path / "central") == []

    finished = events[-1].finished
    expected, made = (json.loads(each.get(read_entry(each, "dome").manifest)) for each in (alone, store))
    assert timeless(made) == timeless(expected)
    assert made["edits"] == {"schema": 1, **json.loads(edits)}
    assert read_entry(alone, "dome").collections == read_entry(store, "dome").collections == ["ada"]
    assert {event.published.collection for event in events if event.HasField("published")} == {"ada"}
    assert made["seconds"]["POINT_CLOUD"] == finished.seconds["POINT_CLOUD"] > 0
    assert {"VALIDATING", "FITTING", "EXTRACTING", "PUBLISHING"} <= finished.seconds.keys()
    assert list(finished.warnings) == made["warnings"]
    assert [event.seq for event in events] == list(range(1, 1 + len(events)))
    assert [event.published for event in events if event.HasField("published")] == [
        event.published for event in theirs if event.HasField("published")
    ]
    assert kinds(events).count("anchors") == 1
    assert kinds(theirs).count("anchors") == 0, "whoever makes the points tells them, before it sends them on"
    fractions = [event.progress.fraction for event in events if event.HasField("progress")]
    assert fractions == sorted(fractions)
    stages = [event.progress.stage for event in events if event.HasField("progress")]
    assert stages == sorted(stages)
    assert {pb.VALIDATING, pb.POINT_CLOUD, pb.FITTING, pb.PUBLISHING} <= set(stages)
    assert list(tmp_path.glob("*/checkpoints/*")) == []


def finest_texture(store: MemoryStore, key: str) -> np.ndarray:
    """The base colour of the finest level, (S,S,3) sRGB."""
    manifest = json.loads(store.get(read_entry(store, key).manifest))
    glb = store.get(next(file["name"] for file in manifest["files"] if file["file"] == "lod0.glb"))
    length = int.from_bytes(glb[12:16], "little")
    document, chunk = json.loads(glb[20 : 20 + length]), glb[28 + length :]
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    start = view.get("byteOffset", 0)
    pixels = cv2.imdecode(np.frombuffer(chunk[start : start + view["byteLength"]], np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(pixels, int)


async def test_central_textures_the_mesh_from_the_captures_pictures(
    store: MemoryStore, tmp_path: Path, quick: Path
) -> None:
    folder = write_open3d(tmp_path / "frames")
    scan = {path.relative_to(folder).as_posix().replace("/", "__"): path.read_bytes() for path in folder.rglob("*.*")}
    capture = archive(tmp_path, **scan)
    alone = MemoryStore()
    async with worker(real_work(alone, quick), tmp_path / "alone") as client:
        assert (await client.ended(capture, asset_key="ball", preset="quick"))[-1].HasField("finished")
    async with pair(store, tmp_path, quick, quick) as (edge, _):
        events = await edge.ended(capture, asset_key="ball", preset="quick")
    assert events[-1].HasField("finished"), events[-1]
    # The first mesh is there before its textures, as with a lone worker.
    assert [event.published.state for event in events if event.HasField("published")] == ["preview", "preview"]
    expected, made = (finest_texture(each, "ball") for each in (alone, store))
    assert expected.shape == made.shape
    assert expected.std() > 10, "it shows a picture"
    assert np.abs(expected - made).mean() <= 2


async def test_a_preset_that_only_central_has_trains_there(
    store: MemoryStore, tmp_path: Path, quick: Path, all_presets: Path, dome: bytes
) -> None:
    async with pair(store, tmp_path, all_presets, quick) as (edge, _):
        assert {"brief", "auto"} <= {preset.name for preset in (await edge.worker()).presets}
        events = await edge.ended(dome, asset_key="dome", preset="brief")
    assert events[-1].HasField("finished"), events[-1]
    states = [event.published.state for event in events if event.HasField("published")]
    kept = [warning for warning in events[-1].finished.warnings if "preview was kept" in warning]
    assert states == ["preview", "preview" if kept else "refined"]
    assert json.loads(store.get(read_entry(store, "dome").manifest))["preset"] == "brief"
    fractions = [event.progress.fraction for event in events if event.HasField("progress")]
    assert fractions == sorted(fractions)


async def started(call: grpc.aio.StreamStreamCall) -> list[pb.Event]:
    """What a job said up to its first words about losses: central trains."""
    told = []
    async for event in call:
        told.append(event)
        assert not event.HasField("failure"), event
        if event.progress.losses:
            return told
    raise AssertionError(told)


async def live(client: Client, *jobs: str) -> None:
    """Wait until exactly these jobs run on a worker."""
    async with asyncio.timeout(PATIENCE_S):
        while list((await client.worker()).jobs) != list(jobs):
            await asyncio.sleep(0.02)


async def test_a_cancellation_reaches_central(
    store: MemoryStore, tmp_path: Path, quick: Path, all_presets: Path, dome: bytes
) -> None:
    async with pair(store, tmp_path, all_presets, quick) as (edge, central):
        call = edge.reconstruct(dome, asset_key="dome", preset="endless")
        await started(call)
        await live(central, "job_1")
        began = time.monotonic()
        assert await edge.cancel()
        ending = [event async for event in call][-1].failure
        await live(central)
        assert time.monotonic() - began < CANCEL_S
        assert (ending.code, ending.stage) == ("CANCELLED", pb.FITTING)
        assert (await edge.worker()).free_slots == 2
        assert (await central.attached())[-1].failure.code == "CANCELLED"
        await until(lambda: not list(tmp_path.glob("*/checkpoints/*")))


async def test_a_run_that_central_still_has_is_taken_up_by_the_next_lease(
    store: MemoryStore, tmp_path: Path, quick: Path, all_presets: Path, dome: bytes
) -> None:
    """The first worker drains, which hands its jobs back; the second need not make the points, nor wait for a fence."""
    async with listening(real_work(store, all_presets), tmp_path / "central") as (theirs, address):
        with reaching(address) as central:
            async with worker(real_work(store, quick, central), tmp_path / "first") as edge:
                await until(lambda: central.takes_jobs)
                await started(edge.reconstruct(dome, asset_key="dome", preset="endless", fence=1))
            await live(theirs, "job_1")
            async with worker(real_work(store, quick, central), tmp_path / "second") as edge:
                call = edge.reconstruct(dome, asset_key="dome", preset="endless", fence=2)
                events = await started(call)
                assert pb.VALIDATING not in {event.progress.stage for event in events}
                assert await edge.cancel()
                await live(theirs)


async def test_a_run_that_ended_meanwhile_is_not_run_again(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    async with pair(store, tmp_path, quick, quick) as (edge, central):
        assert (await edge.ended(dome, asset_key="dome", preset="quick", fence=1))[-1].HasField("finished")
        said = len(await central.attached())
        address = (await edge.worker()).central
        with reaching(address) as again:
            async with worker(real_work(store, quick, again), tmp_path / "second") as second:
                events = await second.ended(dome, asset_key="dome", preset="quick", fence=2)
        assert events[-1].HasField("finished")
        assert len(await central.attached()) == said
    assert read_entry(store, "dome").version == 1


AWAY = "could not be reached: the field was fitted on this worker"


async def test_without_central_it_fits_by_itself_and_says_so(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    with reaching(f"127.0.0.1:{free_port()}", replace(QUICK, answer_s=0.2)) as central:
        async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
            events = await edge.ended(dome, asset_key="dome", preset="quick")
    assert events[-1].HasField("finished"), events[-1]
    said = f"central at {central.address} {AWAY}"
    assert said in events[-1].finished.warnings
    assert said in json.loads(store.get(read_entry(store, "dome").manifest))["warnings"]
    fractions = [event.progress.fraction for event in events if event.HasField("progress")]
    assert fractions == sorted(fractions)


class Standing(Scripted):
    """A central worker that takes points and does what a test wants."""

    offer = replace(
        Scripted.offer,
        points_version=POINTS_VERSION,
        presets=(pb.Preset(name="quick"), pb.Preset(name="theirs", trained=True)),
    )

    def __init__(self, then: str = "wait", offer: Capabilities | None = None) -> None:
        super().__init__()
        self.offer = offer or self.offer
        self._then = then
        self.sizes: list[int] = []

    def reconstruct(self, archive: Path, request: Any, scratch: Path, checkpoint: Path, report: Any) -> pb.Finished:
        self.sizes.append(archive.stat().st_size)
        report(pb.Published(asset_key=request.asset_key, version=1, state="preview", manifest="m"))
        archive.write_bytes(self._then.encode())
        return super().reconstruct(archive, request, scratch, checkpoint, report)


@pytest.mark.parametrize(
    ("offer", "said"),
    [
        (replace(Standing.offer, points_version=0), f"takes points of version 0, not {POINTS_VERSION}"),
        (replace(Standing.offer, central="127.0.0.1:1"), "has a central itself, 127.0.0.1:1"),
        (replace(Standing.offer, presets=(pb.Preset(name="theirs"),)), "does not offer preset quick"),
    ],
)
async def test_a_worker_that_cannot_be_a_central_is_none(tmp_path: Path, offer: Capabilities, said: str) -> None:
    async with listening(Standing(offer=offer), tmp_path / "central") as (_, address):
        with reaching(address) as central, pytest.raises(CentralUnavailable, match=said):
            await asyncio.to_thread(central.require, "quick")


async def test_a_worker_that_is_its_own_central_fits_here(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    port = free_port()
    with reaching(f"127.0.0.1:{port}") as central:
        scratch = Scratch(tmp_path / "edge")
        with scratch.claim():
            settings = EdgeSettings(port=port, scratch=tmp_path / "edge")
            server = EdgeServer(settings, real_work(store, quick, central), scratch)
            await server.start()
            await until(lambda: central.presets != ())
            async with grpc.aio.insecure_channel(central.address) as channel:
                finished = (await Client(channel).ended(dome, preset="quick"))[-1].finished
            hurry = asyncio.Event()
            hurry.set()
            await server.drain(hurry)
    assert "has a central itself" in finished.warnings[0]


async def test_a_full_central_does_not_take_the_points(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    standing = Standing()
    async with listening(standing, tmp_path / "central", queue=0) as (theirs, address):
        held = theirs.reconstruct(b"wait", "other")
        await anext(aiter(held))
        with reaching(address) as central:
            async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
                await until(lambda: central.takes_jobs)
                failed = (await edge.ended(dome, preset="theirs"))[-1].failure
        standing.release.set()
    assert (failed.code, failed.retryable) == ("CENTRAL_UNAVAILABLE", True)
    assert "did not take the points (QUEUE_FULL" in failed.message


async def test_what_only_an_absent_central_has_is_refused_for_now(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    """The job that comes before the refresh fails as retryable, those behind it are not taken."""
    patience = replace(QUICK, answer_s=PATIENCE_S, refresh_s=3600.0)
    async with listening(Standing("ticks 1"), tmp_path / "central") as (_, address), relaying(address) as wire:
        with reaching(wire.address, patience) as central:
            async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
                await until(lambda: central.takes_jobs)
                assert (await edge.ended(dome, "job_1", preset="theirs"))[-1].HasField("finished")
                wire.refuses = True
                wire.cut()
                central.timeouts = replace(patience, answer_s=0.2)
                failed = (await edge.ended(dome, "job_2", preset="theirs"))[-1].failure
                assert (failed.code, failed.retryable) == ("CENTRAL_UNAVAILABLE", True)
                await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(central._refresh(), central._loop))
                assert not central.takes_jobs
                assert "theirs" not in {preset.name for preset in (await edge.worker()).presets}
                with pytest.raises(grpc.aio.AioRpcError, match="CENTRAL_UNAVAILABLE: ") as refused:
                    await edge.ended(dome, "job_3", preset="theirs")
                assert refused.value.code() == grpc.StatusCode.UNAVAILABLE


def fail() -> None:
    from capture2vr.edge.errors import EdgeError

    raise EdgeError("GPU_LOST", "the GPU fell off the bus", file="a.ply", hints=("turn it on",), retryable=True)


async def test_a_failure_there_is_told_in_its_own_words(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    standing = Standing("fail")
    standing._acts["fail"] = fail
    async with listening(standing, tmp_path / "central") as (_, address):
        with reaching(address) as central:
            async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
                events = await edge.ended(dome, preset="quick")
    told = events[-1].failure
    assert (told.code, told.message, told.file) == ("GPU_LOST", "the GPU fell off the bus", "a.ply")
    assert (list(told.hints), told.retryable) == (["turn it on"], True)
    assert kinds(events)[-1] == "failure"
    assert list((tmp_path / "edge").glob("checkpoints/job_1/*.points")), "its next lease sends them again"


async def test_the_job_goes_up_as_it_was_asked_for(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    standing = Standing("ticks 3")
    async with listening(standing, tmp_path / "central") as (_, address):
        with reaching(address) as central:
            async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
                asked = {
                    "asset_key": "k",
                    "preset": "quick",
                    "target": "quest3",
                    "collection": "ada",
                    "fence": 7,
                }
                level = '{"up": [0, 0, 1]}'
                named = {"label": "L", "description": "D", "labels": ["a", "b"]}
                events = await edge.ended(dome, "job_x", cut="scene", longest_m=2.0, edits=level, **named, **asked)
                await edge.ended(dome, "job_y", preset="quick")
    assert standing.seen["job_y"].options.collection == "default", (
        "what nobody named is named by the worker near the phone"
    )
    seen = standing.seen["job_x"]
    wanted = JobOptions(preset="quick", target="quest3", collection="ada", names=AssetNames("L", "D", ("a", "b")))
    assert seen.options == wanted, "cut, size and edits are in the points that were sent"
    assert (seen.asset_key, seen.prepared, seen.fence) == ("k", True, 7)
    assert events[-1].finished.warnings == ["one"]
    begun, ended = STARTS["FITTING"], [event.progress.fraction for event in events if event.HasField("progress")][-1]
    assert ended == pytest.approx(begun + (1 - begun) * 2 / 3), "central's bar is the rest of this one"
    assert events[-1].finished.seconds["FITTING"] == 1.5


async def test_points_need_the_workers_flag(store: MemoryStore, tmp_path: Path, quick: Path) -> None:
    """A phone's archive is a capture whatever it holds: it cannot claim to be metric."""
    write_prepared(prepared_points(120, pictured=False), tmp_path / "points.zip")
    sent = (tmp_path / "points.zip").read_bytes()
    async with worker(real_work(store, quick), tmp_path / "central", slots=1) as client:
        await client.ended(sent, "job_1", asset_key="claimed", preset="quick")
        await client.ended(sent, "job_2", asset_key="made", preset="quick", prepared=True)
        broken = (await client.ended(b"no zip", "job_3", preset="quick", prepared=True))[-1].failure
    assert read_entry(store, "claimed").document["scale_confidence"] == "unknown"
    assert read_entry(store, "made").document["scale_confidence"] == "metric"
    assert json.loads(store.get(read_entry(store, "made").manifest))["capture"]["kind"] == "photos"
    assert (broken.code, broken.retryable) == ("POINTS_INVALID", False)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Process:
    """A worker of its own with small pictures, which can be killed; configured by EDGE_* and STORAGE_*."""

    def __init__(self, folder: Path, **variables: object) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        self._log = folder / "central.log"
        self._environment = {
            **os.environ,
            "EDGE_PORT": self.address.rpartition(":")[2],
            "EDGE_SCRATCH": str(folder / "central"),
            "STORAGE_KIND": "local",
            "STORAGE_ROOT": str(folder / "objects"),
            **{name: str(value) for name, value in variables.items()},
        }
        self.start()

    def start(self) -> None:
        with self._log.open("ab") as log:
            command = [sys.executable, "-m", "tests.support.workers.hasty_worker", "edge"]
            self._running = subprocess.Popen(command, cwd=ROOT, env=self._environment, stdout=log, stderr=log)

    def kill(self) -> None:
        self._running.send_signal(signal.SIGKILL)
        self._running.wait()


@contextmanager
def process(folder: Path, **variables: object) -> Iterator[Process]:
    started = Process(folder, **variables)
    try:
        yield started
    finally:
        started.kill()


async def test_a_killed_central_loses_no_job(tmp_path: Path, quick: Path, all_presets: Path, dome: bytes) -> None:
    """It is killed while it trains; the next lease sends the points that were kept, and the training goes on."""
    store = LocalStore(tmp_path / "objects")
    with (
        process(tmp_path, EDGE_PRESETS=all_presets, OMP_NUM_THREADS=1) as there,
        reaching(there.address) as central,
    ):
        async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
            await until(lambda: central.takes_jobs)
            call = edge.reconstruct(dome, asset_key="dome", preset="endless", collection="ada", fence=1)
            await started(call)
            there.kill()
            ending = [event async for event in call][-1].failure
            assert (ending.code, ending.retryable) == ("CENTRAL_LOST", True)
            assert "could not be reached for" in ending.message
            await until(lambda: not central.takes_jobs)  # or what it said before it was killed would do
            there.start()
            await until(lambda: central.takes_jobs)
            call = edge.reconstruct(dome, asset_key="dome", preset="endless", collection="ada", fence=2)
            events = await started(call)
            assert pb.VALIDATING not in {event.progress.stage for event in events}, "the points were made again"
            assert await edge.cancel()
            assert [event async for event in call][-1].failure.code == "CANCELLED"
    assert (read_entry(store, "dome").version, read_entry(store, "dome").collections) == (1, ["ada"])


async def test_a_connection_that_breaks_is_found_again(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes
) -> None:
    standing = Standing()
    async with (
        listening(standing, tmp_path / "central") as (_, address),
        relaying(address) as wire,
    ):
        with reaching(wire.address, replace(QUICK, lost_s=PATIENCE_S)) as central:
            async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
                call = edge.reconstruct(dome, preset="quick")
                told = [await anext(aiter(call))]
                while told[-1].progress.stage < pb.FITTING:
                    told.append(await anext(aiter(call)))
                wire.cut()
                await asyncio.sleep(1.2)
                standing.release.set()
                told += [event async for event in call]
    assert kinds(told)[-2:] == ["published", "finished"], told[-1]
    assert kinds(told).count("published") == 2, "what was heard before the cut is not said again"
    assert len(standing.sizes) == 1, "the points were sent once"
    said = [(event.progress.fraction, event.progress.message) for event in told if event.HasField("progress")]
    assert all(one != other for one, other in pairwise(said)), "what waits repeats nothing"


async def test_a_run_that_outlasts_a_call_to_central_goes_on_there(
    store: MemoryStore, tmp_path: Path, quick: Path, dome: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(central_client, "GrpcClient", partial(GrpcClient, run_s=3.0))
    standing = Standing()
    async with listening(standing, tmp_path / "central") as (_, address):
        with reaching(address, replace(QUICK, lost_s=PATIENCE_S)) as central:
            async with worker(real_work(store, quick, central), tmp_path / "edge") as edge:
                await until(lambda: central.takes_jobs)
                call = edge.reconstruct(dome, preset="quick")
                await until(lambda: bool(standing.seen))
                await asyncio.sleep(4.0)
                standing.release.set()
                told = [event async for event in call]
    assert kinds(told)[-1] == "finished", told[-1]
    assert list(told[-1].finished.warnings) == ["one"], "central's own"
    with pytest.raises(FileNotFoundError):
        read_entry(store, "dress")  # which only a fit on this worker would have published


class Wire:
    """A wire to a worker that can be cut; with `refuses`, it cannot be plugged in again."""

    def __init__(self, far: str) -> None:
        self.address = ""
        self.refuses = False
        self._far = far.split(":")
        self._ends: set[asyncio.StreamWriter] = set()
        self.pumps: set[asyncio.Task[None]] = set()

    def cut(self) -> None:
        for end in self._ends:
            end.transport.abort()
        self._ends.clear()

    async def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.refuses:
            writer.close()
            return
        far_reader, far_writer = await asyncio.open_connection(*self._far)
        self._ends.update((writer, far_writer))
        for source, sink in ((reader, far_writer), (far_reader, writer)):
            pump = asyncio.create_task(_pump(source, sink))
            self.pumps.add(pump)
            pump.add_done_callback(self.pumps.discard)


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while block := await source.read(1 << 16):
            sink.write(block)
            await sink.drain()
    sink.close()


@asynccontextmanager
async def relaying(address: str) -> AsyncIterator[Wire]:
    """A wire to the worker at `address`."""
    wire = Wire(address)
    server = await asyncio.start_server(wire.connected, "127.0.0.1", 0)
    wire.address = f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    try:
        yield wire
    finally:
        server.close()
        wire.cut()
        if wire.pumps:
            await asyncio.wait(wire.pumps, timeout=5)


def test_a_closed_central_leaves_nothing_behind() -> None:
    with reaching("127.0.0.1:1") as central:
        assert "central 127.0.0.1:1" in {thread.name for thread in threading.enumerate()}
    assert "central 127.0.0.1:1" not in {thread.name for thread in threading.enumerate()}
    central.cancel("0" * 32, "")
    with pytest.raises(CentralUnavailable, match="closed"):
        central.worker()
    gc.collect()  # an event loop that is not closed warns here, and warnings are errors
