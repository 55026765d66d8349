"""POST /v1/captures: what is whole is stored as one archive; what is not is named, and nothing of it stays."""

from __future__ import annotations

import asyncio
import io
import json
import struct
import zipfile
import zlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest
from fastapi import FastAPI
from PIL import Image

import capture2vr
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc
from capture2vr.gateway.app import create_app
from capture2vr.gateway.gateway import gateway_in
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.workers import worker_client
from capture2vr.process.archives import unpack
from capture2vr.storage.bundle import sha256_hex
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Head
from tests.support.in_process_gateway import answering
from tests.support.patience import HANG_S
from tests.support.photos import private_pictures
from tests.support.workers.inspecting_worker import inspecting_worker

BOUNDARY = "boundary"
CLOUD = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"


@dataclass(frozen=True, slots=True)
class Gateway:
    """A started app on a store in memory."""

    data_dir: Path
    store: MemoryStore
    app: FastAPI
    client: httpx.AsyncClient

    async def send(self, *files: tuple[str, bytes], name: str = "") -> httpx.Response:
        parts = [("files", (file, content, "application/octet-stream")) for file, content in files]
        return await self.client.post("/v1/captures", files=parts, data={"name": name} if name else None)

    async def send_raw(self, body: bytes | AsyncIterator[bytes], **headers: str) -> httpx.Response:
        return await self.client.post(
            "/v1/captures", content=body, headers={"Content-Type": "application/zip"} | headers
        )

    def stored(self, capture: str, folder: Path) -> dict[str, bytes]:
        """The files of a stored capture."""
        self.store.fetch(f"captures/{capture}.zip", folder / "stored.zip")
        files = unpack(folder / "stored.zip", folder / "stored")
        return {file.relative_to(folder / "stored").as_posix(): file.read_bytes() for file in files}

    def assert_empty(self) -> None:
        assert self.store.list("") == []
        assert list((self.data_dir / "uploads").rglob("*")) == []


@asynccontextmanager
async def started(folder: Path, store: MemoryStore | None = None, **settings: Any) -> AsyncIterator[Gateway]:
    """A gateway with a worker that inspects, unless given others."""
    data_dir, store = folder / "data", store or MemoryStore()
    app = create_app(
        GatewaySettings(data_dir=data_dir, open=True, **{"workers": (inspecting_worker(),), **settings}), store
    )
    async with answering(app) as client:
        yield Gateway(data_dir, store, app, client)


@pytest.fixture
async def gateway(tmp_path: Path) -> AsyncIterator[Gateway]:
    async with started(tmp_path) as gateway:
        yield gateway


def zipped(**entries: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name.replace("__", "/"), content)
    return buffer.getvalue()


def assert_problem(answer: httpx.Response, status: int, code: str, file: str = "") -> dict[str, Any]:
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    document: dict[str, Any] = answer.json()
    assert (answer.status_code, document["code"], document.get("file", "")) == (status, code, file), document
    assert document["detail"]
    return document


async def test_photos_become_one_archive_without_places(gateway: Gateway, tmp_path: Path) -> None:
    photo, depth = private_pictures.jpeg(), private_pictures.png(private_pictures.picture(mode="I;16"))
    answer = await gateway.send(("rgb/1.jpg", photo), ("depth/1.png", depth), ("poses.csv", b"0,0,0\n"), name="Dress")
    receipt = answer.json()
    assert answer.status_code == 201, receipt
    assert receipt["capture"].startswith("cap_")
    assert (receipt["name"], receipt["inspected"]) == ("Dress", True)
    assert [file["file"] for file in receipt["files"]] == ["depth/1.png", "poses.csv", "rgb/1.jpg"]
    assert {"GPSInfo", "BodySerialNumber"} <= set(receipt["files"][2]["stripped"])
    assert receipt["files"][1]["stripped"] == []

    stored = gateway.stored(receipt["capture"], tmp_path)
    assert {file["file"]: (file["sha256"], file["bytes"]) for file in receipt["files"]} == {
        name: (sha256_hex(content), len(content)) for name, content in stored.items()
    }
    assert private_pictures.PLACE not in b"".join(stored.values())
    assert Image.open(io.BytesIO(stored["rgb/1.jpg"])).tobytes() == Image.open(io.BytesIO(photo)).tobytes()
    archive = gateway.store.get(f"captures/{receipt['capture']}.zip")
    assert (receipt["bytes"], receipt["sha256"]) == (len(archive), sha256_hex(archive))


@pytest.mark.parametrize("name", ["walk.mp4", "walk.MOV", "walk.m4v", "walk.webm", "walk.dat"])
@pytest.mark.parametrize("make", [private_pictures.film, private_pictures.webm])
async def test_a_film_is_told_by_its_content(
    gateway: Gateway, tmp_path: Path, name: str, make: Callable[[], bytes]
) -> None:
    receipt = (await gateway.send((name, make()))).json()
    (file,) = receipt["files"]
    assert (file["verdict"], file["bytes"]) == ("ok", len(make()))
    assert {"©xyz", "track meta"} <= set(file["stripped"]) or {"Tags", "track type 17"} <= set(file["stripped"])
    assert private_pictures.PLACE not in gateway.stored(receipt["capture"], tmp_path)[name]


async def test_the_receipt_is_on_the_store_beside_the_archive(gateway: Gateway) -> None:
    receipt = (await gateway.send(("a.ply", CLOUD))).json()
    assert json.loads(gateway.store.get(f"captures/{receipt['capture']}.json")) | {"questions": []} == receipt
    assert "private" in gateway.store.head(f"captures/{receipt['capture']}.zip").cache_control


async def test_staging_is_empty_afterwards(gateway: Gateway) -> None:
    assert (await gateway.send(("a.ply", CLOUD))).status_code == 201
    assert list((gateway.data_dir / "uploads").iterdir()) == []


@pytest.mark.parametrize("way", ["raw", "field", "r3d"])
async def test_a_zip_is_unpacked_and_cleaned(gateway: Gateway, tmp_path: Path, way: str) -> None:
    data = zipped(scan__metadata=b"{}", scan__rgbd__0=private_pictures.jpeg(), scan__rgbd__1=b"bvx2")
    answer = await (gateway.send_raw(data) if way == "raw" else gateway.send((f"scan.{way}", data)))
    assert answer.status_code == 201, answer.text
    stored = gateway.stored(answer.json()["capture"], tmp_path)
    assert private_pictures.PLACE not in b"".join(stored.values())
    assert {"metadata", "rgbd/0"} <= stored.keys()


async def test_equal_names_of_a_phones_camera_are_numbered(gateway: Gateway) -> None:
    photos = [("image.jpg", private_pictures.jpeg(private_pictures.picture(32, 32 + n))) for n in range(3)]
    answer = await gateway.send(*photos)
    assert [file["file"] for file in answer.json()["files"]] == ["image-2.jpg", "image-3.jpg", "image.jpg"]


@pytest.mark.parametrize(
    ("given", "safe"),
    [
        ("../../etc/passwd.txt", "etc/passwd.txt"),
        ("/abs/a.txt", "abs/a.txt"),
        ("..\\..\\a.txt", "a.txt"),
        ("C:\\scan\\a.txt", "a.txt"),
        ("depth/0001.txt", "depth/0001.txt"),
        ("a\x01b?*.txt", "a_b__.txt"),
        ("Äpfel (1).txt", "Äpfel (1).txt"),
        ("x" * 300 + ".txt", "x" * 146 + ".txt"),
    ],
)
async def test_names_cannot_lead_anywhere(gateway: Gateway, given: str, safe: str) -> None:
    body = (
        f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="files"; filename="'.encode()
        + given.encode()
        + f'"\r\n\r\n1 2 3\r\n--{BOUNDARY}--\r\n'.encode()
    )
    answer = await gateway.send_raw(body, **{"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"})
    assert answer.status_code == 201, answer.text
    assert [file["file"] for file in answer.json()["files"]] == [safe]


async def test_what_systems_add_is_dropped(gateway: Gateway) -> None:
    answer = await gateway.send(("scan/.DS_Store", b"x"), ("scan/Thumbs.db", b"x"), ("scan/a.ply", CLOUD))
    assert [file["file"] for file in answer.json()["files"]] == ["scan/a.ply"]


async def test_files_that_no_capture_has_are_left_out_and_named(gateway: Gateway, tmp_path: Path) -> None:
    answer = await gateway.send(("a.ply", CLOUD), ("virus.exe", b"MZ\x90\0" + bytes(100)))
    receipt = answer.json()
    assert [file["verdict"] for file in receipt["files"]] == ["ok", "left out: of no known format"]
    assert set(gateway.stored(receipt["capture"], tmp_path)) == {"a.ply"}


async def test_raw_photos_beside_others_are_left_out_and_alone_are_named(gateway: Gateway, tmp_path: Path) -> None:
    """Many begin as a TIFF does, with a small preview, which is no photo of the thing."""
    answer = await gateway.send(("IMG_1.DNG", b"II*\0" + bytes(90)), ("IMG_1.jpg", private_pictures.jpeg()))
    assert [file["verdict"] for file in answer.json()["files"]] == ["left out: raw photos are not read", "ok"]
    assert set(gateway.stored(answer.json()["capture"], tmp_path)) == {"IMG_1.jpg"}
    alone = await gateway.send(("DSC_1.NEF", private_pictures.tiff()))
    assert_problem(alone, 422, "CAPTURE_UNKNOWN_FORMAT", "DSC_1.NEF")
    assert alone.json()["detail"] == "raw photos are not read"


@pytest.mark.parametrize(
    "name", ["film.SRT", "way.gpx", "a.xmp", "a.jpg.json", "IMG 1.HEIC.supplemental-metadata.json", "a.aae"]
)
async def test_what_tells_the_places_of_other_files_is_left_out(gateway: Gateway, name: str, tmp_path: Path) -> None:
    place = b'{"latitude": ' + private_pictures.PLACE + b"}"
    answer = await gateway.send((name, place), ("transforms.json", b"{}"), ("a.1.jpg", private_pictures.jpeg()))
    verdicts = {file["file"]: file["verdict"] for file in answer.json()["files"]}
    assert verdicts.pop(name) == "left out: it only says where, when and by whom other files were made"
    assert verdicts == {"transforms.json": "ok", "a.1.jpg": "ok"}
    stored = gateway.stored(answer.json()["capture"], tmp_path)
    assert set(stored) == {"transforms.json", "a.1.jpg"}
    assert not any(private_pictures.PLACE in content for content in stored.values())


@pytest.mark.parametrize(
    ("file", "content", "code"),
    [
        ("a.jpg", private_pictures.jpeg()[:1500], "IMAGE_UNREADABLE"),
        ("a.jpg", b"MZ\x90\0" + bytes(100), "IMAGE_UNREADABLE"),
        ("a.jpg", b"", "IMAGE_UNREADABLE"),
        ("a.png", private_pictures.png()[:600], "IMAGE_UNREADABLE"),
        ("a.png", b"GIF89a" + bytes(50), "IMAGE_UNREADABLE"),
        ("a.heic", private_pictures.heic()[:600], "IMAGE_UNREADABLE"),
        ("a.webp", private_pictures.webp()[:600], "IMAGE_UNREADABLE"),
        ("a.tiff", private_pictures.tiff()[:600], "IMAGE_UNREADABLE"),
        ("a.exr", private_pictures.exr()[:40], "IMAGE_UNREADABLE"),
        ("a.png", private_pictures.huge_png(60_000, 60_000), "IMAGE_TOO_LARGE"),
        ("a.png", private_pictures.huge_png(100_001, 1000), "IMAGE_TOO_LARGE"),
        ("a.png", private_pictures.huge_png(100, 100), "IMAGE_UNREADABLE"),
        ("a.exr", private_pictures.exr(20_000, 20_000), "IMAGE_TOO_LARGE"),
        ("a.mp4", private_pictures.film()[:150], "CAPTURE_UNREADABLE"),
        ("a.e57", private_pictures.e57()[:3000], "CAPTURE_UNREADABLE"),
        ("a.mov", b"no film at all", "CAPTURE_UNREADABLE"),
        ("a.webm", private_pictures.webm()[:150], "CAPTURE_UNREADABLE"),
        ("a.mkv", b"no film at all", "CAPTURE_UNREADABLE"),
        ("b.zip", zipped(a=b"1"), "ARCHIVE_NESTED"),
    ],
)
async def test_a_bad_file_is_refused_by_name(gateway: Gateway, file: str, content: bytes, code: str) -> None:
    answer = await gateway.send(("0.ply", CLOUD), (file, content))
    assert assert_problem(answer, 422, code, file)["hints"]
    gateway.assert_empty()


async def test_a_large_photo_is_refused_before_it_is_decoded(gateway: Gateway) -> None:
    """A JPEG of a few hundred bytes that would be 4,000 megapixels."""
    data = bytearray(private_pictures.jpeg())
    frame = data.index(b"\xff\xc0")
    data[frame + 5 : frame + 9] = b"\xfd\xe8\xfd\xe8"
    assert_problem(await gateway.send(("a.jpg", bytes(data))), 422, "IMAGE_TOO_LARGE", "a.jpg")


@pytest.mark.parametrize(
    ("entries", "code", "file"),
    [
        ({"..__evil": b"1"}, "ARCHIVE_TRAVERSAL", "../evil"),
        ({"a": b"1", "bomb": bytes(4 << 20)}, "ARCHIVE_BOMB", "bomb"),
        ({"a": b"1", "b": zipped(c=b"1")}, "ARCHIVE_NESTED", "b"),
    ],
)
async def test_a_hostile_zip_leaves_nothing(gateway: Gateway, entries: dict[str, bytes], code: str, file: str) -> None:
    assert_problem(await gateway.send_raw(zipped(**entries)), 422, code, file)
    gateway.assert_empty()


async def test_a_cut_zip_is_broken(gateway: Gateway) -> None:
    assert_problem(await gateway.send_raw(zipped(a=CLOUD)[:-30]), 422, "ARCHIVE_BROKEN")
    assert_problem(await gateway.send_raw(b"no zip"), 422, "ARCHIVE_BROKEN")
    gateway.assert_empty()


async def test_an_upload_of_nothing_is_empty(gateway: Gateway) -> None:
    assert_problem(await gateway.send_raw(b""), 422, "CAPTURE_EMPTY")
    assert_problem(await gateway.send(("", b"")), 422, "CAPTURE_EMPTY")
    assert_problem(await gateway.send(("a.ply", b"")), 422, "CAPTURE_EMPTY", "a.ply")
    assert_problem(await gateway.send(("a.exe", b"MZ\0\1")), 422, "CAPTURE_UNKNOWN_FORMAT", "a.exe")
    gateway.assert_empty()


async def test_another_media_type_is_refused(gateway: Gateway) -> None:
    for kind in ("application/json", "image/jpeg", "multipart/form-data"):
        assert_problem(await gateway.send_raw(b"{}", **{"Content-Type": kind}), 415, "UPLOAD_MEDIA_TYPE")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"nothing of the kind",
        b"--boundary\r\n",
        b'--boundary\r\nContent-Disposition: form-data; name="files"; filename="a.ply"\r\n\r\nply',
        b"--boundary\r\n\r\nno headers\r\n--boundary",
    ],
)
async def test_a_malformed_form_is_refused(gateway: Gateway, body: bytes) -> None:
    headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
    assert_problem(await gateway.send_raw(body, **headers), 400, "UPLOAD_MALFORMED")
    gateway.assert_empty()


async def test_a_boundary_in_many_pieces_is_still_one(gateway: Gateway, tmp_path: Path) -> None:
    """Content that looks like a boundary, in chunks of a few bytes."""
    content = b"ply\n\r\n--boundar\r\n--boundary-not\r\n" * 20
    request = gateway.client.build_request("POST", "/v1/captures", files=[("files", ("a.ply", content))])
    body = request.read()

    async def dripping() -> AsyncIterator[bytes]:
        for start in range(0, len(body), 7):
            yield body[start : start + 7]

    answer = await gateway.send_raw(dripping(), **{"Content-Type": request.headers["content-type"]})
    assert answer.status_code == 201, answer.text
    assert gateway.stored(answer.json()["capture"], tmp_path)["a.ply"] == content


async def test_too_many_bytes_are_refused_declared_or_not(tmp_path: Path) -> None:
    async def undeclared() -> AsyncIterator[bytes]:
        for _ in range(100):
            yield bytes(1000)

    async with started(tmp_path, max_upload_bytes=10_000) as gateway:
        assert (await gateway.send_raw(undeclared())).status_code == 413
        assert (await gateway.send(("a.ply", bytes(10_001)))).status_code == 413
        gateway.assert_empty()


async def test_too_many_files_are_refused(tmp_path: Path) -> None:
    files = [(f"{n}.txt", b"1") for n in range(4)]
    many = zipped(**dict(files))
    async with started(tmp_path, max_files=3) as gateway:
        assert_problem(await gateway.send(*files), 413, "UPLOAD_TOO_MANY_FILES")
        assert (await gateway.send(*files[:3])).status_code == 201
        assert_problem(await gateway.send_raw(many), 413, "UPLOAD_TOO_MANY_FILES")


async def test_a_client_that_leaves_leaves_nothing(gateway: Gateway) -> None:
    messages = iter(
        [
            {"type": "http.request", "body": b"PK\x03\x04" + bytes(1 << 20), "more_body": True},
            {"type": "http.disconnect"},
        ]
    )
    sent: list[Any] = []

    async def receive() -> Any:
        return next(messages)

    async def send(message: Any) -> None:
        sent.append(message)

    headers = [(b"content-type", b"application/zip"), (b"content-length", b"9000000")]
    scope = {"type": "http", "method": "POST", "path": "/v1/captures", "query_string": b"", "headers": headers}
    await gateway.app(scope | {"root_path": "", "scheme": "http", "http_version": "1.1"}, receive, send)
    assert sent == []
    gateway.assert_empty()


class _FullStore(MemoryStore):
    """A store that takes the archive and fails at the receipt."""

    def put(self, name: str, *arguments: Any, **options: Any) -> Head:
        if name.endswith(".json"):
            raise OSError("the backend is gone")
        return super().put(name, *arguments, **options)


async def test_a_store_that_fails_keeps_nothing(tmp_path: Path) -> None:
    async with started(tmp_path, _FullStore()) as gateway:
        assert assert_problem(await gateway.send(("a.ply", CLOUD)), 503, "STORE_UNAVAILABLE")["retryable"]
        gateway.assert_empty()


class _Worker(edge_pb2_grpc.EdgeReconstructionServicer):
    """A worker that answers every inspection with the same verdict, having read all of it."""

    def __init__(self, verdict: pb.Inspection) -> None:
        self.verdict = verdict
        self.received = b""
        self.headers: list[pb.Header] = []

    async def GetWorker(self, request: Any, context: Any) -> pb.Worker:  # noqa: N802 - the wire's name
        return pb.Worker(version=capture2vr.__version__, slots=1, free_slots=1)

    async def Inspect(self, chunks: AsyncIterator[pb.Chunk], context: Any) -> pb.Inspection:  # noqa: N802
        await context.send_initial_metadata(())  # admits the upload, as edge.proto has it
        parts = [chunk async for chunk in chunks]
        self.headers.append(parts[0].header)
        self.received = b"".join([part.data.data for part in parts])
        return self.verdict


@pytest.fixture
def verdict() -> pb.Inspection:
    return pb.Inspection(kind="points", format="ply", points=1000, warnings=["3 points dropped"])


@pytest.fixture
async def worker(verdict: pb.Inspection) -> AsyncIterator[tuple[_Worker, str]]:
    servicer, server = _Worker(verdict), grpc.aio.server()
    edge_pb2_grpc.add_EdgeReconstructionServicer_to_server(servicer, server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    yield servicer, f"127.0.0.1:{port}"
    await server.stop(None)


@pytest.fixture
async def attended(tmp_path: Path, worker: tuple[_Worker, str]) -> AsyncIterator[Gateway]:
    async with started(tmp_path, workers=(worker[1],)) as gateway:
        yield gateway


async def test_a_workers_verdict_is_in_the_receipt(attended: Gateway, worker: tuple[_Worker, str]) -> None:
    receipt = (await attended.send(("a.ply", CLOUD))).json()
    assert receipt["inspected"]
    assert (receipt["kind"], receipt["format"], receipt["points"]) == ("points", "ply", 1000)
    assert receipt["warnings"] == ["3 points dropped"]
    assert worker[0].received == attended.store.get(f"captures/{receipt['capture']}.zip")


def jpeg() -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (64, 48), (200, 60, 30)).save(buffer, "JPEG")
    return buffer.getvalue()


class TestOfOnePhoto:
    @pytest.fixture
    def verdict(self) -> pb.Inspection:
        line = pb.Polygon(xy=[0.25, 0.25, 0.75, 0.25, 0.5, 0.75])
        return pb.Inspection(kind="image", format="photo", frames=1, warnings=["a guess"], outline=[line])

    async def test_the_outline_is_told_and_nothing_is_stored(
        self, attended: Gateway, worker: tuple[_Worker, str]
    ) -> None:
        files = [("files", ("a.jpg", jpeg(), "image/jpeg"))]
        for box in (None, [0.25, 0.125, 0.75, 1.0]):
            params = {"box": ",".join(map(str, box))} if box else {}
            answer = await attended.client.post("/v1/outlines", params=params, files=files)
            assert answer.status_code == 200, answer.text
            outline = [[[0.25, 0.25], [0.75, 0.25], [0.5, 0.75]]]
            assert answer.json() == {"kind": "image", "outline": outline, "warnings": ["a guess"]}
        attended.assert_empty()
        none, some = worker[0].headers
        assert not none.HasField("box")
        assert some.box == pb.Box(left=0.25, top=0.125, right=0.75, bottom=1.0)

    async def test_an_upload_is_inspected_with_its_rectangle(
        self, attended: Gateway, worker: tuple[_Worker, str]
    ) -> None:
        content = zipped(**{"a.jpg": jpeg()})
        headers = {"Content-Type": "application/zip"}
        answer = await attended.client.post("/v1/captures?box=0.25,0.125,0.75,1", content=content, headers=headers)
        assert answer.status_code == 201, answer.text
        assert worker[0].headers[0].box == pb.Box(left=0.25, top=0.125, right=0.75, bottom=1.0)


@pytest.mark.parametrize("path", ["/v1/outlines", "/v1/captures"])
@pytest.mark.parametrize(
    "box", ["0.5,0.2,0.1,0.6", "120,80,900,700", "0.1,0.2,0.3", "a,b,c,d", "nan,0,1,1", "0,0,1,1,photo=a\tb"]
)
async def test_a_rectangle_that_is_none_is_refused(gateway: Gateway, path: str, box: str) -> None:
    answer = await gateway.client.post(path, params={"box": box}, files=[("files", ("a.jpg", jpeg()))])
    document = assert_problem(answer, 422, "BOX_INVALID")
    assert document["detail"].startswith("box: ")
    assert "left,top,right,bottom" in document["hints"][0]
    gateway.assert_empty()


@pytest.mark.parametrize("path", ["/v1/outlines", "/v1/captures"])
async def test_what_no_worker_can_inspect_is_not_taken(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_client, "_INSPECTOR_S", 0.0)
    async with started(tmp_path, workers=("127.0.0.1:9",)) as gateway:
        answer = await gateway.client.post(path, files=[("files", ("a.jpg", jpeg()))])
        assert assert_problem(answer, 503, "INSPECTION_UNAVAILABLE")["retryable"]
        assert answer.headers["Retry-After"]
        gateway.assert_empty()


async def test_a_photo_to_outline_may_be_larger_than_a_job_request(attended: Gateway) -> None:
    large = io.BytesIO()
    Image.frombytes("RGB", (300, 300), bytes(range(256)) * 1054 + bytes(176)).save(large, "BMP")
    assert large.tell() > 200_000
    answer = await attended.client.post("/v1/outlines", files=[("files", ("a.bmp", large.getvalue()))])
    assert answer.status_code != 413


class TestRefused:
    @pytest.fixture
    def verdict(self) -> pb.Inspection:
        failure = pb.Failure(code="CAPTURE_TOO_FEW_POINTS", message="only 3", file="a.ply", hints=["scan longer"])
        return pb.Inspection(failure=failure)

    async def test_a_capture_that_a_worker_refuses_is_not_kept(self, attended: Gateway) -> None:
        document = assert_problem(await attended.send(("a.ply", CLOUD)), 422, "CAPTURE_TOO_FEW_POINTS", "a.ply")
        assert document["hints"] == ["scan longer"]
        attended.assert_empty()


@pytest.mark.data
@pytest.mark.parametrize("name", ["phone_tof", "photos_fruit", "rgbd_livingroom", "dress", "cloud_room"])
async def test_real_captures_are_taken(gateway: Gateway, data_dir: Path, name: str) -> None:
    folder = data_dir / name
    files = [
        (path.relative_to(folder).as_posix(), path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.stat().st_size < 8_000_000
    ]
    answer = await gateway.send(*files)
    assert answer.status_code == 201, answer.text
    assert {file["verdict"] for file in answer.json()["files"]} == {"ok"}


async def test_a_client_that_leaves_ends_the_inspection_of_its_capture(
    gateway: Gateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    started, ended = asyncio.Event(), asyncio.Event()

    async def inspect(*_: Any) -> None:
        started.set()
        try:
            await asyncio.sleep(HANG_S)
        finally:
            ended.set()

    messages = iter([{"type": "http.request", "body": zipped(**{"a.ply": CLOUD}), "more_body": False}])

    async def receive() -> dict[str, Any]:
        if (message := next(messages, None)) is not None:
            return message
        await started.wait()
        return {"type": "http.disconnect"}

    async def send(_: Any) -> None:
        raise AssertionError("nobody is there to be answered")

    monkeypatch.setattr(gateway_in(gateway.app).workers, "inspect", inspect)
    headers = [(b"host", b"gateway"), (b"content-type", b"application/zip")]
    path = {"path": "/v1/captures", "raw_path": b"/v1/captures", "query_string": b"", "root_path": ""}
    ends = {"client": ("127.0.0.1", 1), "server": ("gateway", 80), "scheme": "http", "http_version": "1.1"}
    await gateway.app({"type": "http", "method": "POST", "headers": headers, **path, **ends}, receive, send)
    assert ended.is_set()
    gateway.assert_empty()


async def test_a_jpeg_of_hundreds_of_scans_is_refused_before_it_is_decoded(gateway: Gateway) -> None:
    buffer = io.BytesIO()
    Image.effect_noise((64, 64), 40).save(buffer, "JPEG", progressive=True)
    whole = buffer.getvalue()
    last = whole.rindex(b"\xff\xda")
    assert (await gateway.send(("good.jpg", whole))).status_code == 201
    answer = await gateway.send(("slow.jpg", whole[:last] + whole[last:-2] * 300 + whole[-2:]))
    assert "scans" in assert_problem(answer, 422, "IMAGE_UNREADABLE", "slow.jpg")["detail"]


async def test_a_png_of_many_bits_is_refused_before_it_is_inflated(gateway: Gateway) -> None:
    whole = bytearray(private_pictures.png())
    whole[16:26] = struct.pack(">IIBB", 10_000, 9_990, 16, 6)
    whole[29:33] = struct.pack(">I", zlib.crc32(whole[12:29]))
    answer = await gateway.send(("deep.png", bytes(whole)))
    assert "799 MB" in assert_problem(answer, 422, "IMAGE_TOO_LARGE", "deep.png")["detail"]
