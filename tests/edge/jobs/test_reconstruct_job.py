"""The real work behind the real wire: an archive goes in, versions of an asset come out of the store."""

from __future__ import annotations

import asyncio
import json
import threading
import time
import zipfile
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import grpc
import numpy as np
import psutil
import pytest
from scipy.spatial import cKDTree

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.asset.target import measure_cost
from capture2vr.edge.field.device import find_device
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.jobs.available_presets import known_presets
from capture2vr.edge.jobs.fit_job import FieldFitter
from capture2vr.edge.jobs.job_process import JobProcesses
from capture2vr.edge.jobs.job_task import Machine
from capture2vr.edge.jobs.reconstruct_job import Reconstructor
from capture2vr.edge.preset import load_preset, memory_bytes
from capture2vr.edge.worker.memory_budget import MemoryBudget
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import DEFAULT_POLICY, PublishPolicy, publish
from capture2vr.storage.catalogue.root import index_name
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.captures import write_nerfstudio
from tests.support.patience import CANCEL_S, PATIENCE_S
from tests.support.photos.generators import boxes, boxes_glb, generator, glb, photo_of
from tests.support.workers.edge_client import Client, leftovers, until, upload, worker

pytestmark = [pytest.mark.usefixtures("small_pictures"), pytest.mark.slow]


@pytest.fixture
def scratch(tmp_path: Path) -> Path:
    return tmp_path / "scratch"


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


@pytest.fixture
async def client(store: MemoryStore, scratch: Path) -> AsyncIterator[Client]:
    async with worker(real_work(store), scratch, slots=1) as client:
        yield client


def fitter(store: MemoryStore, policy: PublishPolicy = DEFAULT_POLICY) -> FieldFitter:
    """A fitter with the product's presets and memory for all of them, on the CPU."""
    return FieldFitter(store, known_presets(None), find_device("cpu"), MemoryBudget(1 << 40), policy)


def real_work(store: MemoryStore, presets: Path | None = None, memory_bytes: int = 1 << 40) -> Reconstructor:
    """Work on the CPU, with the product's presets and those of a folder."""
    return Reconstructor(FieldFitter(store, known_presets(presets), find_device("cpu"), MemoryBudget(memory_bytes)))


def archive(folder: Path, **files: bytes) -> bytes:
    path = folder / "capture.zip"
    with zipfile.ZipFile(path, "w") as packed:
        for name, content in files.items():
            packed.writestr(name.replace("__", "/").replace("_ply", ".ply"), content)
    return path.read_bytes()


def hemisphere_ply(count: int = 1000) -> bytes:
    """Points of the upper half of a unit sphere: an open surface with a known size, 2 x 1 x 2."""
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(count, 3))
    xyz /= np.linalg.norm(xyz, axis=1, keepdims=True)
    xyz[:, 1] = np.abs(xyz[:, 1])
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return head.encode() + xyz.astype("<f4").tobytes()


async def test_points_become_an_asset(client: Client, store: MemoryStore, scratch: Path, tmp_path: Path) -> None:
    sent = archive(tmp_path, dome_ply=hemisphere_ply())
    events = await client.ended(sent, job="job_dome", asset_key="dome", label="Dome", preset="draft")
    assert events[-1].HasField("finished"), events[-1]
    assert {"VALIDATING", "FITTING", "EXTRACTING", "PUBLISHING"} <= events[-1].finished.seconds.keys()

    fractions = [event.progress.fraction for event in events if event.HasField("progress")]
    assert fractions == sorted(fractions)
    published = [event.published for event in events if event.HasField("published")]
    assert [(each.asset_key, each.version) for each in published] == [
        ("dome", 1 + place) for place in range(len(published))
    ]

    asset = read_entry(store, "dome")
    assert asset.manifest == published[-1].manifest
    assert asset.document["label"] == "Dome"
    assert asset.document["size_m"] == pytest.approx([2, 1, 2], rel=0.1)
    assert json.loads(store.get(asset.manifest))["preset"] == "draft"
    assert store.get(asset.document["lods"][0]["name"]).startswith(b"glTF")
    assert leftovers(scratch) == []


async def test_one_photo_becomes_what_a_generator_makes_of_it_or_a_sentence(
    store: MemoryStore, scratch: Path, tmp_path: Path
) -> None:
    rgb, mask = photo_of(boxes(), 200)
    png = cv2.imencode(".png", np.dstack([rgb[..., ::-1], np.where(mask, 255, 0)]).astype(np.uint8))[1].tobytes()
    path = tmp_path / "capture.zip"
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("boxes.png", png)
    with generator(glb(boxes_glb(turn=120))) as stub:
        server = GeneratorServer(stub.url)
        presets = {"generate": replace(load_preset("generate"), resolution=40, most_points=3_000)}
        machine = Machine("cpu", 1 << 40, generator=server)
        work = FieldFitter(store, presets, find_device("cpu"), MemoryBudget(1 << 40), machine=machine)
        async with worker(Reconstructor(work), scratch, slots=1) as client:
            made = await client.ended(path.read_bytes(), job="job_made", asset_key="boxes", preset="generate")
            stub.health = 503
            refused = await client.ended(path.read_bytes(), job="job_refused", asset_key="none", preset="generate")
    assert made[-1].HasField("finished"), made[-1]
    entry = read_entry(store, "boxes")
    assert (entry.document["origin"], entry.tags, entry.grade) == ("generated", ("generated",), "")
    assert (refused[-1].failure.code, refused[-1].failure.retryable) == ("GENERATOR_UNAVAILABLE", True)
    assert "the capture is kept" in refused[-1].failure.hints[0]
    with pytest.raises(FileNotFoundError):
        read_entry(store, "none")


async def test_edits_make_another_version_and_those_that_leave_nothing_none(
    client: Client, store: MemoryStore, scratch: Path, tmp_path: Path
) -> None:
    sent = archive(tmp_path, dome_ply=hemisphere_ply())
    whole = {"asset_key": "cut", "preset": "draft"}
    await client.ended(sent, job="job_whole", **whole)
    upper = '{"planes": [{"point": [0, 0.5, 0], "normal": [0, 1, 0]}], "up": [0, 1, 0]}'
    await client.ended(sent, job="job_cut", edits=upper, **whole)
    asset = read_entry(store, "cut")
    assert asset.document["size_m"][1] == pytest.approx(0.5, abs=0.1)
    assert json.loads(store.get(asset.manifest))["edits"] == {"schema": 1, **json.loads(upper)}

    nothing = '{"crop": {"centre": [9, 9, 9], "size": [1, 1, 1]}}'
    failure = (await client.ended(sent, job="job_nothing", edits=nothing, **whole))[-1].failure
    assert (failure.code, failure.retryable) == ("EDITS_NOTHING_LEFT", False)
    assert "0 of" in failure.message
    assert failure.hints
    assert read_entry(store, "cut").document == asset.document, "what was there stays"
    assert leftovers(scratch) == []


async def test_an_asset_is_its_tenants(client: Client, store: MemoryStore, tmp_path: Path) -> None:
    sent = archive(tmp_path, dome_ply=hemisphere_ply(200))
    for number, tenant in enumerate(("ada", "bob")):
        job = f"job_{number}"
        events = await client.ended(sent, job, asset_key="dome", label=tenant, preset="draft", tenant=tenant)
        assert events[-1].HasField("finished"), events[-1]
        assert read_entry(store_of_tenant(store, tenant), "dome").document["label"] == tenant
    with pytest.raises(FileNotFoundError):
        read_entry(store, "dome")
    for tenant in ("../ada", "Ada", "a" * 33):
        with pytest.raises(grpc.aio.AioRpcError, match="TENANT_INVALID"):
            await client.ended(sent, "job_9", asset_key="dome", tenant=tenant)


async def test_a_few_points_are_told_before_there_is_a_mesh(client: Client, store: MemoryStore, tmp_path: Path) -> None:
    events = await client.ended(archive(tmp_path, dome_ply=hemisphere_ply(20_000)), asset_key="dome", preset="draft")
    (place,) = (place for place, event in enumerate(events) if event.HasField("anchors"))
    stages = [event.progress.stage for event in events[:place] if event.HasField("progress")]
    assert stages[-1] == pb.POINT_CLOUD
    assert not any(event.HasField("published") for event in events[:place])
    told = np.array(events[place].anchors.xyz_m).reshape(-1, 3)
    assert 100 <= len(told) <= 1000
    assert len(events[place].anchors.rgb) == 3 * len(told)
    manifest = json.loads(store.get(read_entry(store, "dome").manifest))
    later = np.array(manifest["anchors"]["xyz_m"]).reshape(-1, 3)
    apart, _ = cKDTree(later).query(told)  # the mesh's floor is not quite that of the points
    assert np.median(apart) < 0.05


async def test_an_asset_enters_the_collection_of_its_job_or_of_its_worker(
    store: MemoryStore, scratch: Path, tmp_path: Path
) -> None:
    sent = archive(tmp_path, dome_ply=hemisphere_ply(200))
    work = Reconstructor(fitter(store), collection="house")
    async with worker(work, scratch) as client:
        named = await client.ended(sent, "job_1", asset_key="hers", preset="draft", collection="ada")
        plain = await client.ended(sent, "job_2", asset_key="ours", preset="draft")
    for events, key, collection in ((named, "hers", "ada"), (plain, "ours", "house")):
        published = [event.published for event in events if event.HasField("published")]
        assert {each.collection for each in published} == {collection}
        assert read_entry(store, key).collections == [collection]
        assert store.head(index_name(collection))


async def test_a_key_of_another_collection_is_refused_by_name(
    store: MemoryStore, scratch: Path, tmp_path: Path
) -> None:
    """The gateway sees it first, but for two first jobs at once."""
    sent = archive(tmp_path, dome_ply=hemisphere_ply(200))
    publish(Bundle("preview", {"mesh.ply": b"hers"}, {"lods": []}), store, key="shoe", collection="ada")
    work = Reconstructor(fitter(store, PublishPolicy(allow_other_collections=False)))
    async with worker(work, scratch) as client:
        failed = (await client.ended(sent, asset_key="shoe", preset="draft", collection="bob"))[-1].failure
    assert (failed.code, failed.retryable) == ("KEY_ELSEWHERE", False)
    assert "in collection ada, not in bob" in failed.message
    assert (read_entry(store, "shoe").version, read_entry(store, "shoe").collections) == (1, ["ada"])


async def test_a_killed_process_ends_its_own_job_alone(store: MemoryStore, scratch: Path, tmp_path: Path) -> None:
    """It can be sent again, and neither the worker nor the job beside it notices."""
    processes = JobProcesses()
    before = set(psutil.Process().children())
    processes.start()
    (server,) = set(psutil.Process().children()) - before
    killed = asyncio.Event()

    async def kill_the_first() -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not (jobs := server.children()):
                await asyncio.sleep(0.01)
        jobs[0].kill()
        killed.set()

    async def second(client: Client) -> list[pb.Event]:
        await killed.wait()
        return await client.ended(sent, "job_2", asset_key="hers", preset="draft")

    sent = archive(tmp_path, dome_ply=hemisphere_ply(200))
    async with worker(Reconstructor(fitter(store), processes=processes), scratch, slots=2) as client:
        first = client.ended(sent, "job_1", asset_key="his", preset="draft")
        lost, other, _ = await asyncio.gather(first, second(client), kill_the_first())
        assert (lost[-1].failure.code, lost[-1].failure.retryable) == ("JOB_PROCESS_LOST", True)
        assert other[-1].HasField("finished"), other[-1]
        again = await client.ended(sent, "job_1", fence=2, asset_key="his", preset="draft")
        assert again[-1].HasField("finished"), again[-1]
    assert leftovers(scratch) == []


@pytest.mark.parametrize(
    ("files", "code"),
    [
        ({"dome_ply": hemisphere_ply(20)}, "CAPTURE_TOO_FEW_POINTS"),
        ({"..__escaped_ply": hemisphere_ply()}, "ARCHIVE_TRAVERSAL"),
        ({"inner.zip": b"PK\x05\x06" + bytes(18)}, "ARCHIVE_NESTED"),
        ({"dome_ply": hemisphere_ply()[:-100]}, "CAPTURE_TRUNCATED"),
        ({}, "CAPTURE_EMPTY"),
    ],
)
async def test_a_capture_at_fault_is_told_by_name(
    client: Client, scratch: Path, tmp_path: Path, files: dict[str, bytes], code: str
) -> None:
    sent = archive(tmp_path, **files)
    inspected = (await client.stub.Inspect(upload(sent))).failure
    failed = (await client.ended(sent))[-1].failure
    assert inspected.code == failed.code == code
    assert not failed.retryable
    assert str(tmp_path) not in f"{failed}{inspected}"
    assert leftovers(scratch) == []


async def test_what_is_no_archive_is_told_by_name(client: Client) -> None:
    assert (await client.ended(b"no zip at all"))[-1].failure.code == "ARCHIVE_BROKEN"


async def test_a_good_capture_is_described(client: Client, tmp_path: Path) -> None:
    verdict = await client.stub.Inspect(upload(archive(tmp_path, dome_ply=hemisphere_ply())))
    assert not verdict.HasField("failure")
    assert (verdict.kind, verdict.format, verdict.points) == ("points", "ply", 1000)


def two_discs_png() -> bytes:
    """A red disc on the left and a blue one on the right, before a light wall, 400 x 300 pixels."""
    rgb = np.full((300, 400, 3), 215, np.uint8)
    for middle, colour in ((110, (180, 40, 30)), (290, (30, 60, 170))):
        cv2.circle(rgb, (middle, 150), 60, colour, cv2.FILLED)
    return cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()


async def test_the_thing_in_a_photo_is_outlined_also_in_a_rectangle(client: Client, tmp_path: Path) -> None:
    sent = archive(tmp_path, **{"discs.png": two_discs_png()})
    both = await client.stub.Inspect(upload(sent))
    assert (both.kind, both.frames, len(both.outline)) == ("image", 1, 2)
    one = await client.stub.Inspect(upload(sent, box=pb.Box(left=0.55, top=0.2, right=0.95, bottom=0.8)))
    (line,) = one.outline
    assert min(line.xy[::2]) == pytest.approx(230 / 400, abs=0.01)
    assert max(line.xy[1::2]) == pytest.approx(210 / 300, abs=0.01)


async def test_a_rectangle_with_another_capture_is_an_error_that_says_why(client: Client, tmp_path: Path) -> None:
    sent, box = archive(tmp_path, dome_ply=hemisphere_ply()), pb.Box(left=0.1, top=0.1, right=0.9, bottom=0.9)
    inspected = (await client.stub.Inspect(upload(sent, box=box))).failure
    failed = (await client.ended(sent, box=box))[-1].failure
    assert inspected.code == failed.code == "BOX_NOT_APPLICABLE"
    assert "the capture has no photo (ply)" in failed.message
    assert failed.hints


async def test_the_rectangle_says_which_thing_becomes_the_asset(
    client: Client, store: MemoryStore, tmp_path: Path
) -> None:
    sent = archive(tmp_path, **{"discs.png": two_discs_png()})
    box = pb.Box(left=0.55, top=0.2, right=0.95, bottom=0.8)
    events = await client.ended(sent, asset_key="disc", preset="draft", box=box)
    assert events[-1].HasField("finished"), events[-1]
    published = [event.published.manifest for event in events if event.HasField("published")]
    manifest = json.loads(store.get(published[-1]))
    red, _, blue = np.array(manifest["anchors"]["rgb"]).reshape(-1, 3).mean(axis=0)
    assert blue > red + 50


class SlowStore(MemoryStore):
    """A store on whose first file somebody waits, until `release`."""

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.release = threading.Event(), threading.Event()

    def put(self, *given: Any, **options: Any) -> Any:
        self.begun.set()
        self.release.wait(PATIENCE_S)
        return super().put(*given, **options)


async def test_a_job_that_is_cancelled_while_its_files_are_stored_adds_no_version(
    scratch: Path, tmp_path: Path
) -> None:
    """Its slot is free before the store has answered, and the job has ended: nothing may come after that."""
    store = SlowStore()
    async with worker(real_work(store), scratch, slots=1) as client:
        call = client.reconstruct(archive(tmp_path, dome_ply=hemisphere_ply(400)), asset_key="dome", preset="draft")
        await until(store.begun.is_set)
        assert await client.cancel()
        assert [event async for event in call][-1].failure.code == "CANCELLED"
        store.release.set()
        await until(lambda: leftovers(scratch) == [])  # its thread has ended
    with pytest.raises(FileNotFoundError):
        read_entry(store, "dome")


async def test_a_cancelled_job_publishes_nothing(client: Client, store: MemoryStore, tmp_path: Path) -> None:
    call = client.reconstruct(archive(tmp_path, dome_ply=hemisphere_ply(40_000)), asset_key="dome")
    events = aiter(call)
    while (await anext(events)).progress.stage < pb.POINT_CLOUD:
        pass
    assert await client.cancel()
    ending = [event async for event in call][-1]
    assert ending.failure.code == "CANCELLED"
    with pytest.raises(FileNotFoundError):
        read_entry(store, "dome")


async def test_an_outdated_lease_publishes_nothing(client: Client, store: MemoryStore, tmp_path: Path) -> None:
    newer = Bundle(state="preview", files={"preview.png": b"newer"}, manifest={})
    publish(newer, store, key="dome", job="job_1", fence=2)
    ending = (await client.ended(archive(tmp_path, dome_ply=hemisphere_ply()), asset_key="dome", fence=1))[-1].failure
    assert (ending.code, ending.retryable, ending.stage) == ("FENCE_STALE", False, pb.PUBLISHING)
    assert read_entry(store, "dome").version == 1


# Steps beyond number, each light: a training that is under way for as long as a test looks at it.
ENDLESS = """
resolution = 32
lod_faces = [2000]

[fit]
steps = 1_000_000
batch = 100
pool = 5_000
"""
BRIEF = ENDLESS.replace("1_000_000", "20")


@pytest.fixture
def presets(tmp_path: Path) -> Path:
    folder = tmp_path / "presets"
    folder.mkdir()
    (folder / "endless.toml").write_text(ENDLESS)
    (folder / "brief.toml").write_text(BRIEF)
    return folder


async def training(call: grpc.aio.StreamStreamCall) -> list[pb.Event]:
    """What a job said up to its first words about losses."""
    told = []
    async for event in call:
        told.append(event)
        assert not event.HasField("failure"), event
        if event.progress.losses:
            break
    return told


async def test_a_training_is_told_of_and_refines_the_preview(
    store: MemoryStore, scratch: Path, presets: Path, tmp_path: Path
) -> None:
    async with worker(real_work(store, presets), scratch, slots=1) as client:
        events = await client.ended(archive(tmp_path, dome_ply=hemisphere_ply()), asset_key="dome", preset="brief")
    assert events[-1].HasField("finished"), events[-1]
    assert events[-1].finished.seconds["FITTING"] > 0
    losses = [event.progress.losses for event in events if event.progress.losses]
    assert all(told["total"] > 0 for told in losses)
    states = [event.published.state for event in events if event.HasField("published")]
    kept = [warning for warning in events[-1].finished.warnings if "preview was kept" in warning]
    assert states == ["preview", "preview" if kept else "refined"]
    fractions = [event.progress.fraction for event in events if event.HasField("progress")]
    assert fractions == sorted(fractions)


async def test_the_last_version_of_a_capture_with_photos_has_textures(
    client: Client, store: MemoryStore, tmp_path: Path
) -> None:
    folder = write_nerfstudio(tmp_path / "capture")
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    events = await client.ended(archive(tmp_path, **files), job="job_1", asset_key="walk", preset="draft")
    assert events[-1].HasField("finished"), events[-1]
    assert [event.published.version for event in events if event.HasField("published")] == [1, 2]
    present = read_entry(store, "walk")
    assert present.version == 2
    finest = store.get(present.document["lods"][0]["name"])
    assert measure_cost(finest).texture_bytes > 0
    assert "asset.usdz" in {file["file"] for file in present.document["files"]}


async def test_a_training_is_cancelled_at_once(
    store: MemoryStore, scratch: Path, presets: Path, tmp_path: Path
) -> None:
    async with worker(real_work(store, presets), scratch, slots=1) as client:
        call = client.reconstruct(
            archive(tmp_path, dome_ply=hemisphere_ply()), "job_1", asset_key="dome", preset="endless"
        )
        told = await training(call)
        began = time.monotonic()
        assert await client.cancel()
        ending = [event async for event in call][-1]
        assert (await client.worker()).free_slots == 1
        assert time.monotonic() - began < CANCEL_S
        assert (ending.failure.code, ending.failure.stage) == ("CANCELLED", pb.FITTING)
        await until(lambda: not list(scratch.glob("checkpoints/*")))
    assert [event.published.state for event in told if event.HasField("published")] == ["preview"]
    assert read_entry(store, "dome").state == "preview"


async def test_a_job_waits_for_the_memory_of_another(
    store: MemoryStore, scratch: Path, presets: Path, tmp_path: Path
) -> None:
    brief = known_presets(presets)["brief"]
    enough = int(1.5 * memory_bytes(brief, 1000))
    async with worker(real_work(store, presets, enough), scratch, slots=2) as client:
        sent = archive(tmp_path, dome_ply=hemisphere_ply())
        first = client.reconstruct(sent, "job_1", asset_key="one", preset="endless")
        await training(first)
        second = client.reconstruct(sent, "job_2", asset_key="two", preset="brief")
        async for event in second:
            if "waiting for memory" in event.progress.message:
                break
            assert not event.progress.losses
        assert await client.cancel("job_1")
        assert [event async for event in second][-1].HasField("finished")


async def test_what_never_fits_is_named_and_its_preview_stays(
    store: MemoryStore, scratch: Path, presets: Path, tmp_path: Path
) -> None:
    brief = known_presets(presets)["brief"]
    enough = memory_bytes(brief, 500)
    async with worker(real_work(store, presets, enough), scratch, slots=1) as client:
        sent = archive(tmp_path, dome_ply=hemisphere_ply())
        failed = (await client.ended(sent, asset_key="dome", preset="brief"))[-1].failure
        assert failed.code == "MEMORY_EXCEEDED"
        assert "draft" in failed.hints[0]
        assert read_entry(store, "dome").state == "preview"
        chosen = (await client.ended(sent, job="job_2", asset_key="dome2", preset="auto"))[-1]
        assert "the preview was kept" in chosen.finished.warnings[-1]
        files = json.loads(store.get(read_entry(store, "dome2").manifest))["files"]
        assert "turning.webp" in {each["file"] for each in files}  # a whole last bundle, though nothing was trained
        with pytest.raises(grpc.aio.AioRpcError, match="MEMORY_EXCEEDED: preset cap-udf is not offered"):
            await client.ended(sent, job="job_3", preset="cap-udf")
