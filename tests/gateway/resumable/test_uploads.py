"""Uploads that go on: whatever is cut, sent twice or sent wrongly, the capture is made of the bytes that were sent."""

from __future__ import annotations

import asyncio
import errno
import io
import time
import zipfile
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from hypothesis import example, given, settings
from hypothesis import strategies as st

from capture2vr.gateway.app import create_app
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.gateway import gateway_in
from capture2vr.gateway.jobs.capture_objects import new_capture
from capture2vr.gateway.resumable.expiry import KEEP_S, Expiry
from capture2vr.gateway.resumable.store import UploadStore
from capture2vr.gateway.routes import uploads as uploads_routes
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Head, Store, list_all
from capture2vr.storage.tenant_store import store_of_tenant
from tests.referees.s3.server import S3Server
from tests.storage.conftest import s3_store
from tests.support.in_process_gateway import listening, until
from tests.support.network.away_store import AwayStore
from tests.support.patience import PATIENCE_S
from tests.support.photos import private_pictures
from tests.support.tenants import make_key, two_tenants
from tests.support.tus import PART, TUS, checksum, cloud, create, created, cut, finish, metadata, offset_of, patch
from tests.support.workers.inspecting_worker import inspecting_worker

_CHUNK_BYTES = 300_000  # a batch of the network has at least 256 KB


@dataclass(frozen=True, slots=True)
class Site:
    """Gateways on one database and one store."""

    store: Store
    apps: list[FastAPI]
    clients: list[httpx.AsyncClient]

    @property
    def client(self) -> httpx.AsyncClient:
        return self.clients[0]

    @property
    def expiry(self) -> Expiry:
        gateway = gateway_in(self.apps[0])
        return Expiry(gateway.captures.resumable, self.store, gateway.access.usage.add)

    @property
    def uploads(self) -> UploadStore:
        """The rows of all uploads."""
        return gateway_in(self.apps[0]).captures.resumable.database

    def chunks(self) -> list[str]:
        """Names of the objects of uploads."""
        return [head.name for head in list_all(self.store, "uploads/")]

    def files(self, receipt: dict[str, Any]) -> dict[str, bytes]:
        """The files of a stored capture."""
        with zipfile.ZipFile(io.BytesIO(self.store.get(f"captures/{receipt['capture']}.zip"))) as archive:
            return {name: archive.read(name) for name in archive.namelist()}


@asynccontextmanager
async def site(folder: Path, store: Store, gateways: int = 1, **options: Any) -> AsyncIterator[Site]:
    """Start gateways that share a database and a store."""
    folder.mkdir(parents=True, exist_ok=True)
    shared = {
        "database_url": f"sqlite:///{folder / 'gateway.db'}",
        "open": True,
        "workers": (inspecting_worker(),),
        **options,
    }
    async with AsyncExitStack() as stack:
        found = Site(store, [], [])
        for number in range(gateways):
            settings = GatewaySettings(data_dir=folder / f"gateway{number}", **shared)
            app = create_app(settings, store)
            url = await stack.enter_async_context(listening(app, settings))
            gateway_in(app).captures.resumable.chunk_bytes = _CHUNK_BYTES
            found.apps.append(app)
            client = httpx.AsyncClient(base_url=url, timeout=PATIENCE_S)
            found.clients.append(await stack.enter_async_context(client))
        yield found


def code(answer: httpx.Response) -> tuple[int, str]:
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    return answer.status_code, answer.json()["code"]


class Cut:
    """Ways of sending a part, each of which a phone or somebody who means ill may choose."""

    KINDS = ("whole", "cut", "cut with checksum", "checksum", "wrong checksum", "too long", "wrong offset", "twice")


_STEPS = st.lists(
    st.tuples(st.sampled_from(Cut.KINDS), st.floats(0, 1), st.integers(0, 1), st.sampled_from(["sha1", "sha256"])),
    max_size=8,
)


@pytest.mark.slow
@settings(max_examples=25)
@example(size=60, steps=[("whole", 1.0, 0, "sha1"), ("too long", 0.0, 1, "sha1")], kind="memory")
@given(size=st.integers(60, 2_500_000), steps=_STEPS, kind=st.sampled_from(["memory", "local"]))
def test_whatever_is_cut_the_bytes_are_those_that_were_sent(
    size: int, steps: list[tuple[str, float, int, str]], kind: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("site")
    store = MemoryStore() if kind == "memory" else LocalStore(folder / "objects")
    asyncio.run(_send_in_steps(folder, store, size, steps))


async def _send_in_steps(folder: Path, store: Store, size: int, steps: list[tuple[str, float, int, str]]) -> None:
    data = cloud(size)
    async with site(folder, store, gateways=2) as found:
        upload = await created(found.client, size, filename="scan.ply", name="Scan")
        quiet = True  # a gateway may still be storing a part that was cut, whatever is sent after it
        for kind, share, gateway, algorithm in steps:
            client = found.clients[gateway]
            before = await offset_of(client, upload)
            part = data[before : before + int(share * (size - before)) + 1]
            await _send_part(client, upload, before, part, (kind, algorithm))
            after = await offset_of(found.clients[1 - gateway], upload)
            assert before <= after <= size, "what was acknowledged stays"
            quiet = quiet and not kind.startswith("cut")
            if quiet and kind in ("wrong checksum", "wrong offset"):
                assert after == before
            if quiet and kind == "checksum":
                assert after == before + len(part)
        receipt = await _complete(found, upload, data)
        assert found.files(receipt) == {"scan.ply": data}
        await until(lambda: _is_empty(found))


async def _send_part(client: httpx.AsyncClient, upload: str, offset: int, part: bytes, how: tuple[str, str]) -> None:
    kind, algorithm = how
    proof = {"Upload-Checksum": checksum(algorithm, part)}
    if kind == "whole":
        answer = await patch(client, upload, offset, part)
        moved = await offset_of(client, upload) != offset  # by a part that was cut, and stored since
        assert answer.status_code in ((204, 409, 423) if moved else (204, 423)), answer.text
    elif kind == "cut":
        await cut(client, upload, offset, part, len(part) // 2)
    elif kind == "cut with checksum":
        await cut(client, upload, offset, part, len(part) // 2, proof)
    elif kind == "checksum":
        while (answer := await patch(client, upload, offset, part, proof)).status_code != 204:
            assert answer.status_code in (409, 423), answer.text
            if await offset_of(client, upload) != offset:
                break
    elif kind == "wrong checksum":
        answer = await patch(client, upload, offset, part, {"Upload-Checksum": checksum(algorithm, part + b"x")})
        assert not part or code(answer) in ((460, "UPLOAD_CHECKSUM"), (423, "UPLOAD_LOCKED"), (409, "UPLOAD_OFFSET"))
    elif kind == "too long":
        answer = await patch(client, upload, offset, part + bytes(3_000_000))
        assert code(answer) in ((413, "UPLOAD_TOO_LONG"), (423, "UPLOAD_LOCKED"), (409, "UPLOAD_OFFSET"))
    elif kind == "wrong offset":
        assert code(await patch(client, upload, offset + 1, part)) == (409, "UPLOAD_OFFSET")
    else:
        answers = await asyncio.gather(*(patch(client, upload, offset, part) for _ in range(2)))
        assert {answer.status_code for answer in answers} <= {204, 409, 423}


async def _complete(found: Site, upload: str, data: bytes) -> dict[str, Any]:
    """Send the rest, at the gateways by turns, and make the capture."""
    for turn in range(100):
        client = found.clients[turn % len(found.clients)]
        offset = await offset_of(client, upload)
        if offset == len(data):
            break
        answer = await patch(client, upload, offset, data[offset:])
        assert answer.status_code in (204, 409, 423), answer.text  # the part that was cut last may still be stored
    answer = await finish(found.clients[-1], upload)
    assert answer.status_code == 201, answer.text
    head = await found.client.head(upload, headers=TUS)
    assert head.headers["Upload-Capture"] == answer.json()["capture"]
    receipt: dict[str, Any] = answer.json()
    return receipt


async def _is_empty(found: Site) -> bool:
    return not found.chunks()


async def test_on_s3(tmp_path: Path, s3_server: S3Server) -> None:
    data = cloud(1_000_000)
    async with site(tmp_path, s3_store(s3_server), gateways=2) as found:
        upload = await created(found.client, len(data), filename="scan.ply")
        await cut(found.clients[1], upload, 0, data, 700_000)
        await until(lambda: _reached(found, upload, 300_000))
        receipt = await _complete(found, upload, data)
        assert found.files(receipt) == {"scan.ply": data}
        await until(lambda: _is_empty(found))


async def _reached(found: Site, upload: str, offset: int) -> bool:
    return await offset_of(found.client, upload) >= offset


@pytest.fixture
async def one(tmp_path: Path) -> AsyncIterator[Site]:
    async with site(tmp_path, MemoryStore()) as found:
        yield found


class TestCaptures:
    async def test_a_form_is_a_capture_of_many_files(self, one: Site) -> None:
        form = httpx.Request(
            "POST",
            "http://gateway/",
            files=[("files", (f"{number}.jpg", private_pictures.jpeg())) for number in range(3)],
            data={"name": "Dress", "collection": "shelf"},
        )
        data = form.read()
        upload = await created(one.client, len(data), filetype=form.headers["content-type"])
        await patch(one.client, upload, 0, data)
        receipt = (await finish(one.client, upload)).json()
        plain = await one.client.post(
            "/v1/captures", content=data, headers={"Content-Type": form.headers["content-type"]}
        )
        same = {name: value for name, value in receipt.items() if name not in ("capture", "created")}
        assert same.items() <= plain.json().items()
        assert (receipt["name"], receipt["collection"], len(receipt["files"])) == ("Dress", "shelf", 3)

    async def test_a_zip_and_a_name_beside_it(self, one: Site) -> None:
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:
            archive.writestr("a.ply", cloud(100))
        data = buffer.getvalue()
        for told in ({"filetype": "application/zip"}, {"filename": "scan.zip", "filetype": "application/zip"}):
            answer = await create(one.client, len(data), body=data, name="Dress", collection="shelf", **told)
            assert answer.headers["Upload-Offset"] == str(len(data))
            receipt = (await finish(one.client, answer.headers["Location"])).json()
            assert (receipt["name"], receipt["collection"]) == ("Dress", "shelf")
            assert one.files(receipt) == {"a.ply": cloud(100)}

    async def test_the_receipt_is_that_of_a_listed_capture(self, one: Site) -> None:
        upload = (await create(one.client, 100, body=cloud(100), filename="a.ply")).headers["Location"]
        receipt = (await finish(one.client, upload)).json()
        assert (await one.client.get(f"/v1/captures/{receipt['capture']}")).json() == receipt
        assert [each["capture"] for each in (await one.client.get("/v1/captures")).json()["captures"]] == [
            receipt["capture"]
        ]

    async def test_asked_again_it_is_the_same_capture(self, tmp_path: Path) -> None:
        async with site(tmp_path, MemoryStore(), gateways=2) as found:
            upload = (await create(found.client, 100, body=cloud(100), filename="a.ply")).headers["Location"]
            answers = await asyncio.gather(*(finish(client, upload) for client in found.clients * 3))
            assert {answer.status_code for answer in answers} <= {201, 423}
            again = await finish(found.clients[1], upload)
            made = {answer.text for answer in (*answers, again) if answer.status_code == 201}
            assert len(made) == 1
            assert len((await found.client.get("/v1/captures")).json()["captures"]) == 1
            capture = again.json()["capture"]
            assert (await found.client.delete(f"/v1/captures/{capture}")).status_code == 200
            assert code(await finish(found.client, upload)) == (404, "CAPTURE_UNKNOWN")

    async def test_a_gateway_that_died_behind_the_store_made_it_already(self, one: Site) -> None:
        upload = (await create(one.client, 100, body=cloud(100), filename="a.ply")).headers["Location"]
        database = one.uploads
        found = database.get("default", upload.rpartition("/")[2], time.time())
        assert found is not None
        planned = new_capture()
        database.lease(found, "dead", planned, time.time())
        assert code(await finish(one.client, upload)) == (423, "UPLOAD_LOCKED")
        assert code(await one.client.delete(upload, headers=TUS)) == (423, "UPLOAD_LOCKED")
        database.renew(found.id, "dead", 0.0)
        receipt = (await one.client.post("/v1/captures", files={"files": ("a.ply", cloud(100))})).json()
        for suffix in ("zip", "json"):
            stored = one.store.get(f"captures/{receipt['capture']}.{suffix}")
            stored = stored.replace(receipt["capture"].encode(), planned.encode())
            one.store.put(f"captures/{planned}.{suffix}", stored, content_type="application/octet-stream")
        assert (await finish(one.client, upload)).json() == {**receipt, "capture": planned}

    @pytest.mark.parametrize(
        ("told", "data", "answer"),
        [
            ({"filename": "a.jpg"}, private_pictures.jpeg()[:1500], (422, "IMAGE_UNREADABLE")),
            ({"filename": "a.exe"}, b"MZ\x90\0" + bytes(100), (422, "CAPTURE_UNKNOWN_FORMAT")),
            ({"filename": "a.ply"}, b"", (422, "CAPTURE_EMPTY")),
            ({"filename": "a.ply", "collection": "../x"}, cloud(100), (422, "COLLECTION_INVALID")),
            ({"filetype": "multipart/form-data; boundary=x"}, b"--y\r\n", (400, "UPLOAD_MALFORMED")),
            ({"filetype": "application/zip"}, b"PK\x03\x04" + bytes(100), (422, "ARCHIVE_BROKEN")),
        ],
    )
    async def test_what_is_refused_stays_until_it_is_deleted(
        self, one: Site, told: dict[str, str], data: bytes, answer: tuple[int, str]
    ) -> None:
        upload = (await create(one.client, len(data), body=data, **told)).headers["Location"]
        for _ in range(2):
            assert code(await finish(one.client, upload)) == answer
        assert (await one.client.get("/v1/captures")).json()["captures"] == []
        assert (await one.client.delete(upload, headers=TUS)).status_code == 204
        assert one.chunks() == []
        assert code(await finish(one.client, upload)) == (404, "UPLOAD_UNKNOWN")

    async def test_too_early_and_with_a_wrong_box(self, one: Site) -> None:
        upload = await created(one.client, 100, filename="a.ply")
        assert code(await finish(one.client, upload)) == (409, "UPLOAD_INCOMPLETE")
        await patch(one.client, upload, 0, cloud(100))
        assert code(await finish(one.client, upload, box="1,2")) == (422, "BOX_INVALID")
        assert (await finish(one.client, upload, box="0,0,1,1")).status_code == 201

    async def test_a_chunk_that_the_store_has_lost_is_named(self, one: Site) -> None:
        upload = (await create(one.client, 100, body=cloud(100), filename="a.ply")).headers["Location"]
        one.store.delete(one.chunks()[0])
        assert code(await finish(one.client, upload)) == (409, "UPLOAD_DAMAGED")


class TestProtocol:
    async def test_what_there_is(self, one: Site) -> None:
        answer = await one.client.options("/v1/uploads")
        assert answer.status_code == 204
        told = {
            name: answer.headers[name] for name in ("Tus-Resumable", "Tus-Version", "Tus-Extension", "Tus-Max-Size")
        }
        assert told == {
            "Tus-Resumable": "1.0.0",
            "Tus-Version": "1.0.0",
            "Tus-Extension": "creation,creation-with-upload,termination,checksum,expiration",
            "Tus-Max-Size": str(2 << 30),
        }
        assert answer.headers["Tus-Checksum-Algorithm"] == "sha1,sha256"

    async def test_a_head_tells_all_that_was_told(self, one: Site) -> None:
        upload = await created(one.client, 100, filename="Über.ply", name="")
        answer = await one.client.head(upload, headers=TUS)
        assert answer.headers["Upload-Metadata"] == metadata({"filename": "Über.ply", "name": ""})
        assert (answer.headers["Upload-Length"], answer.headers["Upload-Offset"]) == ("100", "0")
        assert (answer.headers["Cache-Control"], answer.headers["Tus-Resumable"]) == ("no-store", "1.0.0")
        assert answer.headers["Upload-Expires"].endswith("GMT")

    async def test_the_method_may_stand_in_a_header(self, one: Site) -> None:
        upload = await created(one.client, 100, filename="a.ply")
        told = {**TUS, "Content-Type": PART, "Upload-Offset": "0", "X-HTTP-Method-Override": "PATCH"}
        assert (await one.client.post(upload, headers=told, content=cloud(100))).status_code == 204
        assert code(await one.client.post(upload, headers=TUS)) == (405, "METHOD_NOT_ALLOWED")
        answer = await one.client.post(upload, headers={**TUS, "X-HTTP-Method-Override": "DELETE"})
        assert answer.status_code == 204
        assert (await one.client.head(upload, headers=TUS)).status_code == 404

    @pytest.mark.parametrize(
        ("headers", "answer"),
        [
            ({"Tus-Resumable": "0.2.2"}, (412, "TUS_VERSION")),
            ({"Upload-Length": "-1"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Length": "many"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Length": "9" * 19}, (400, "UPLOAD_HEADER")),
            ({"Upload-Length": "9" * 18}, (413, "UPLOAD_TOO_LARGE")),
            ({"Upload-Metadata": "filename !!"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Metadata": "filename AA=="}, (400, "UPLOAD_HEADER")),
            ({"Upload-Metadata": "a YQ==,a YQ=="}, (400, "UPLOAD_HEADER")),
            ({"Upload-Metadata": "a /w=="}, (400, "UPLOAD_HEADER")),
            ({"Upload-Metadata": "a " + "YWFh" * 2_000}, (400, "UPLOAD_HEADER")),
            ({"Content-Type": "text/plain"}, (415, "UPLOAD_MEDIA_TYPE")),
            ({"Upload-Metadata": metadata({"filetype": "text/html"})}, (415, "UPLOAD_MEDIA_TYPE")),
            ({"Upload-Metadata": metadata({"filetype": "multipart/form-data"})}, (415, "UPLOAD_MEDIA_TYPE")),
        ],
    )
    async def test_headers_of_a_creation(self, one: Site, headers: dict[str, str], answer: tuple[int, str]) -> None:
        sent = {**TUS, "Upload-Length": "100", **headers}
        refused = await one.client.post("/v1/uploads", headers=sent)
        assert code(refused) == answer
        assert refused.headers["Tus-Resumable"] == "1.0.0"

    @pytest.mark.parametrize(
        ("headers", "answer"),
        [
            ({"Content-Type": "text/plain"}, (415, "UPLOAD_MEDIA_TYPE")),
            ({"Upload-Checksum": "md5 AAAA"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Length": "20"}, (413, "UPLOAD_TOO_LONG")),
            ({"Upload-Checksum": checksum("sha1", b"other")}, (460, "UPLOAD_CHECKSUM")),
        ],
    )
    async def test_a_creation_that_is_refused_with_its_first_bytes_leaves_no_upload(
        self, one: Site, monkeypatch: pytest.MonkeyPatch, headers: dict[str, str], answer: tuple[int, str]
    ) -> None:
        monkeypatch.setattr(uploads_routes, "_MOST_UNFINISHED", 1)
        sent = {**TUS, "Upload-Length": "100", "Content-Type": PART, **headers}
        for _ in range(2):
            assert code(await one.client.post("/v1/uploads", headers=sent, content=cloud(50))) == answer
        assert one.chunks() == []
        assert (await create(one.client, 100, body=cloud(50))).status_code == 201
        assert code(await create(one.client, 100)) == (429, "UPLOADS_LIMITED")

    async def test_a_store_that_does_not_answer_is_named_and_the_upload_goes_on_later(self, tmp_path: Path) -> None:
        store = AwayStore()
        async with site(tmp_path, store) as found:
            upload = await created(found.client, 100, filename="a.ply")
            store.is_away = True
            assert code(await patch(found.client, upload, 0, cloud(100))) == (503, "STORE_UNAVAILABLE")
            store.is_away = False
            assert await offset_of(found.client, upload) == 0
            assert (await patch(found.client, upload, 0, cloud(100))).status_code == 204
            assert (await finish(found.client, upload)).status_code == 201

    @pytest.mark.parametrize(
        ("headers", "answer"),
        [
            ({"Tus-Resumable": ""}, (412, "TUS_VERSION")),
            ({"Upload-Offset": "x"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Offset": "7"}, (409, "UPLOAD_OFFSET")),
            ({"Content-Type": "application/zip"}, (415, "UPLOAD_MEDIA_TYPE")),
            ({"Upload-Checksum": "md5 AAAA"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Checksum": "sha1 AAAA"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Checksum": "sha1 ?"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Checksum": "sha1"}, (400, "UPLOAD_HEADER")),
            ({"Upload-Checksum": checksum("sha1", b"other")}, (460, "UPLOAD_CHECKSUM")),
        ],
    )
    async def test_headers_of_a_part(self, one: Site, headers: dict[str, str], answer: tuple[int, str]) -> None:
        upload = await created(one.client, 100, filename="a.ply")
        assert code(await patch(one.client, upload, 0, cloud(50), headers)) == answer
        assert await offset_of(one.client, upload) == 0
        assert one.chunks() == []

    async def test_pages_of_other_origins(self, tmp_path: Path) -> None:
        async with site(tmp_path, MemoryStore(), cors_origins=("https://vr.example",)) as found:
            asked = {"Origin": "https://vr.example", "Access-Control-Request-Method": "PATCH"}
            asked["Access-Control-Request-Headers"] = "tus-resumable,upload-offset,upload-metadata,upload-length"
            answer = await found.client.options("/v1/uploads", headers=asked)
            assert answer.status_code == 200
            assert "PATCH" in answer.headers["Access-Control-Allow-Methods"]
            answer = await found.client.post(
                "/v1/uploads", headers={**TUS, "Upload-Length": "3", "Origin": "https://vr.example"}
            )
            exposed = answer.headers["Access-Control-Expose-Headers"]
            assert {"Location", "Upload-Offset", "Upload-Expires", "Tus-Resumable"} <= set(exposed.split(", "))


class _Killed(MemoryStore):
    """A store whose gateways are killed: nobody hears of what was written, or comes to delete anything."""

    is_written_unheard = False
    is_kept = False

    def put(self, name: str, data: bytes | Path, **options: Any) -> Head:
        head = super().put(name, data, **options)
        if self.is_written_unheard:
            raise OSError(errno.EIO, "killed")
        return head

    def delete(self, name: str) -> None:
        if self.is_kept:
            raise OSError(errno.EIO, "killed")
        super().delete(name)


class TestSmallParts:
    async def test_parts_of_a_byte_make_few_objects(self, one: Site) -> None:
        """There was one for each."""
        data = cloud(63)
        upload = await created(one.client, len(data), filename="scan.ply")
        for offset in range(len(data)):
            assert (await patch(one.client, upload, offset, data[offset : offset + 1])).status_code == 204
            assert len(one.chunks()) <= (offset + 1).bit_length()
        receipt = (await finish(one.client, upload)).json()
        assert one.files(receipt) == {"scan.ply": data}

    @pytest.mark.parametrize("unheard", [True, False])
    async def test_who_is_killed_while_parts_are_joined_loses_nothing(self, unheard: bool, tmp_path: Path) -> None:
        """Before the database knows the joined object, and before those that it has replaced are deleted."""
        data, store = cloud(60), _Killed()
        async with site(tmp_path, store, gateways=2) as found:
            upload = await created(found.client, len(data), filename="scan.ply")
            for offset in range(0, 60, 4):
                part = data[offset : offset + 4]
                store.is_written_unheard, store.is_kept = unheard, True
                answer = await patch(found.clients[0], upload, offset, part)
                assert answer.status_code == (503 if unheard else 204), answer.text
                store.is_written_unheard = store.is_kept = False
                assert await offset_of(found.clients[1], upload) == (offset if unheard else offset + 4)
                if unheard:
                    assert (await patch(found.clients[1], upload, offset, part)).status_code == 204
            receipt = (await finish(found.client, upload)).json()
            assert found.files(receipt) == {"scan.ply": data}
            await until(lambda: _is_empty(found))


class TestExpiry:
    async def test_expired_uploads_are_gone(self, tmp_path: Path) -> None:
        async with site(tmp_path, LocalStore(tmp_path / "objects"), gateways=2, upload_expires_s=3600) as found:
            old = (await create(found.client, 200, body=cloud(100), filename="a.ply")).headers["Location"]
            done = (await create(found.client, 100, body=cloud(100), filename="a.ply")).headers["Location"]
            receipt = (await finish(found.client, done)).json()
            now = time.time()
            await found.expiry.remove_due(now)
            assert await offset_of(found.client, old) == 100
            await found.expiry.remove_due(now + 7200)
            assert (await found.clients[1].head(old, headers=TUS)).status_code == 404
            assert code(await patch(found.clients[1], old, 100, cloud(100))) == (404, "UPLOAD_UNKNOWN")
            assert (await finish(found.client, done)).json() == receipt, "whoever lost the answer still gets it"
            await until(lambda: _is_empty(found))
            await found.expiry.remove_due(now + 7200 + 2 * KEEP_S)
            assert (await found.client.head(done, headers=TUS)).status_code == 404
            assert (await found.client.get(f"/v1/captures/{receipt['capture']}")).status_code == 200
            folders = (tmp_path / "objects").rglob("*upl_*")
            assert list(folders) == []
            for number in range(2):
                assert list((tmp_path / f"gateway{number}" / "uploads").iterdir()) == []

    async def test_what_a_crash_left_behind_goes_with_its_upload(self, one: Site) -> None:
        upload = (await create(one.client, 200, body=cloud(100), filename="a.ply")).headers["Location"]
        identity = upload.rpartition("/")[2]
        one.store.put(f"uploads/{identity}.000000000000100.dead", b"x", content_type=PART)
        database = one.uploads
        assert (await one.client.delete(upload, headers=TUS)).status_code == 204
        assert one.chunks() == []
        late = f"uploads/{identity}.000000000000100.late"
        one.store.put(late, b"x", content_type=PART)  # by another gateway, which had not heard of it
        await one.expiry.remove_due(time.time() + 2 * KEEP_S)
        assert one.chunks() == []
        assert database.to_sweep(time.time() + 9 * KEEP_S) == []

    async def test_an_archive_without_a_receipt_goes_too(self, one: Site) -> None:
        upload = (await create(one.client, 100, body=cloud(100), filename="a.ply")).headers["Location"]
        database = one.uploads
        found = database.get("default", upload.rpartition("/")[2], time.time())
        assert found is not None
        database.lease(found, "dead", "cap_dead", time.time())
        one.store.put("captures/cap_dead.zip", b"x", content_type="application/zip")
        await one.expiry.remove_due(time.time() + 2 * KEEP_S)
        assert one.store.list("") == []


class TestTenants:
    async def test_a_capture_is_made_for_its_own_tenant(self, tmp_path: Path) -> None:
        store = MemoryStore()
        async with two_tenants(tmp_path, store) as found:
            upload = (await create(found.ada, 100, body=cloud(100), filename="a.ply")).headers["Location"]
            for answer in (
                await patch(found.bob, upload, 0, b"x"),
                await finish(found.bob, upload),
                await found.bob.delete(upload, headers=TUS),
            ):
                assert code(answer) == (404, "UPLOAD_UNKNOWN")
            receipt = (await finish(found.ada, upload)).json()
            assert store_of_tenant(store, "ada").head(f"captures/{receipt['capture']}.zip")
            assert (await found.bob.get(f"/v1/captures/{receipt['capture']}")).status_code == 404

    async def test_limits_are_told_before_the_upload(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, MemoryStore()) as found:
            await _limit(found.operator, capture_bytes=1_000)
            answer = await found.ada.options("/v1/uploads")
            assert answer.headers["Tus-Max-Size"] == "1000"
            assert code(await create(found.ada, 1_001)) == (413, "CAPTURE_BYTES_LIMITED")
            await _limit(found.operator, stored_bytes=2_000)
            assert code(await create(found.ada, 2_001)) == (413, "STORED_BYTES_LIMITED")
            assert (await create(found.ada, 2_000)).status_code == 201

    async def test_uploads_at_once(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, MemoryStore()) as found:
            await _limit(found.operator, uploads_at_once=1)
            first, second = [await created(found.ada, 200, filename="a.ply") for _ in range(2)]
            begun, go_on = asyncio.Event(), asyncio.Event()

            async def slow() -> AsyncIterator[bytes]:
                yield cloud(100)
                begun.set()
                await go_on.wait()

            told = {**TUS, "Content-Type": PART, "Upload-Offset": "0"}
            sending = asyncio.create_task(found.ada.patch(first, headers=told, content=slow()))
            await begun.wait()
            await asyncio.sleep(0.2)  # else the second one may be heard of first, and the first one be refused
            while (answer := await patch(found.ada, second, 0, b"")).status_code == 204:
                assert not sending.done(), sending.result().text
                await asyncio.sleep(0.02)
            assert code(answer) == (429, "UPLOADS_LIMITED")
            assert answer.headers["Retry-After"]
            go_on.set()
            assert (await sending).headers["Upload-Offset"] == "100"

    async def test_a_quota_that_is_reached_in_the_middle(self, tmp_path: Path) -> None:
        store = MemoryStore()
        async with two_tenants(tmp_path, store) as found:
            await _limit(found.operator, stored_bytes=1_500_000)
            data = cloud(1_000_000)
            one, two = [await created(found.ada, len(data), filename="a.ply") for _ in range(2)]
            assert (await patch(found.ada, one, 0, data)).status_code == 204
            assert code(await patch(found.ada, two, 0, data[:600_000])) == (413, "STORED_BYTES_LIMITED")
            offset = await offset_of(found.ada, two)
            assert offset == 0, "nothing half done"
            receipt = (await finish(found.ada, one)).json()
            used = (await found.ada.get("/v1/usage")).json()
            assert used["stored_bytes"] == receipt["bytes"], used
            assert (await found.ada.delete(f"/v1/captures/{receipt['capture']}")).status_code == 200
            assert (await patch(found.ada, two, 0, data)).status_code == 204
            assert (await finish(found.ada, two)).status_code == 201
            assert await _used(found.ada) > 0

    async def test_what_is_deleted_is_no_longer_counted(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, MemoryStore()) as found:
            await _limit(found.operator, stored_bytes=1_000)
            upload = (await create(found.ada, 200, body=cloud(100), filename="a.ply")).headers["Location"]
            assert await _used(found.ada) == 100
            await found.ada.delete(upload, headers=TUS)
            assert await _used(found.ada) == 0

    async def test_all_go_with_the_data_of_their_tenant(self, tmp_path: Path) -> None:
        store = MemoryStore()
        async with two_tenants(tmp_path, store) as found:
            open_one = (await create(found.ada, 200, body=cloud(100), filename="a.ply")).headers["Location"]
            other = (await create(found.bob, 200, body=cloud(100), filename="a.ply")).headers["Location"]
            deletion = await found.ada.post("/v1/deletions", json={"tenant": "ada"})
            assert deletion.status_code == 201, deletion.text
            assert (await found.ada.head(open_one, headers=TUS)).status_code == 404
            assert list(list_all(store_of_tenant(store, "ada"), "uploads/")) == []
            assert await offset_of(found.bob, other) == 100

    async def test_not_without_end(self, tmp_path: Path) -> None:
        secret = make_key(tmp_path, "ada")
        assert secret
        engine = open_engine(f"sqlite:///{tmp_path / 'gateway.db'}")
        database = UploadStore(engine)
        assert [database.create("ada", 1, {}, 0.0, most=2) is None for _ in range(3)] == [False, False, True]
        engine.dispose()


async def _limit(operator: httpx.AsyncClient, **limits: int) -> None:
    assert (await operator.put("/v1/tenants/ada/limits", json=limits)).status_code == 200


async def _used(client: httpx.AsyncClient) -> int:
    return int((await client.get("/v1/usage")).json()["stored_bytes"])
