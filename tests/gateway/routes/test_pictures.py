"""The photos of a stored capture: listed by their names in it, and sent small and upright."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image

from capture2vr.gateway.jobs.capture_objects import capture_name, receipt_name
from capture2vr.gateway.uploads.image_checks import load_pillow
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store
from tests.support.in_process_gateway import gateway, memory


def photo(colour: tuple[int, int, int], orientation: int = 1, kind: str = "JPEG") -> bytes:
    exif = Image.Exif()
    exif[0x0112] = orientation
    buffer = io.BytesIO()
    load_pillow().new("RGB", (1600, 1200), colour).save(buffer, kind, exif=exif.tobytes())
    return buffer.getvalue()


def stored(store: Store, kind: str, files: dict[str, bytes]) -> str:
    """A capture of which a worker has told the kind."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    store.put(capture_name("cap_1"), buffer.getvalue(), content_type="application/zip")
    receipt = f'{{"capture": "cap_1", "kind": "{kind}"}}'
    store.put(receipt_name("cap_1"), receipt.encode(), content_type="application/json")
    return "cap_1"


def problem_of(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


@pytest.mark.slow
async def test_photos_are_listed_and_sent_small_and_upright(tmp_path: Path) -> None:
    store = memory()
    capture = stored(store, "photos", {"a.heic": photo((30, 30, 200), kind="HEIF"), "b.jpg": photo((200, 30, 30), 6)})
    async with gateway(tmp_path, store) as client:
        pictures = (await client.get(f"/v1/captures/{capture}/pictures")).json()["pictures"]
        assert [each["name"] for each in pictures] == ["a.heic", "b.jpg"]
        for each, size, colour in zip(
            pictures, [(1024, 768), (768, 1024)], [(30, 30, 200), (200, 30, 30)], strict=True
        ):
            answer = await client.get(each["url"])
            assert (answer.status_code, answer.headers["content-type"]) == (200, "image/jpeg"), answer.text
            assert answer.headers["cache-control"] == "private, no-store"
            with Image.open(io.BytesIO(answer.content)) as small:
                assert small.size == size
                found = small.getpixel((9, 9))
            assert max(abs(a - b) for a, b in zip(found, colour, strict=True)) < 12  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "names"),
    [("photos", ["a.jpg", "b.png"]), ("", ["a.jpg", "b.png"]), ("rgbd", ["a.jpg"]), ("points", []), ("image", [])],
)
async def test_only_what_a_lasso_may_be_in_is_listed(tmp_path: Path, kind: str, names: list[str]) -> None:
    store = memory()
    capture = stored(store, kind, {"a.jpg": b"x", "b.png": b"x", "c.txt": b"x", "film.mp4": b"x"})
    async with gateway(tmp_path, store) as client:
        pictures = (await client.get(f"/v1/captures/{capture}/pictures")).json()["pictures"]
        assert [each["name"] for each in pictures] == names


@pytest.mark.slow
async def test_what_there_is_not_is_told(tmp_path: Path) -> None:
    store = memory()
    endless = bytearray(photo((9, 9, 9), kind="HEIF"))
    at = endless.index(b"ispe") + 12
    endless[at : at + 4] = struct.pack(">I", 50_331_712)  # its height: libheif refuses it with a RuntimeError
    files = {"a.jpg": b"no picture at all", "b.jpg": photo((9, 9, 9))[:3_000], "c.heic": bytes(endless)}
    capture = stored(store, "photos", files)
    async with gateway(tmp_path, store) as client:
        for path, problem in {
            "cap_2/pictures": (404, "CAPTURE_UNKNOWN"),
            "cap_2/pictures/0": (404, "CAPTURE_UNKNOWN"),
            f"{capture}/pictures/3": (404, "PICTURE_UNKNOWN"),
            f"{capture}/pictures/-1": (422, "REQUEST_INVALID"),
            f"{capture}/pictures/x": (422, "REQUEST_INVALID"),
            f"{capture}/pictures/0": (422, "PICTURE_UNREADABLE"),
            f"{capture}/pictures/1": (422, "PICTURE_UNREADABLE"),
            f"{capture}/pictures/2": (422, "PICTURE_UNREADABLE"),
        }.items():
            assert problem_of(await client.get(f"/v1/captures/{path}")) == problem, path
        answer: Any = (await client.get(f"/v1/captures/{capture}/pictures/0")).json()
        assert answer["file"] == "a.jpg"
        assert "/" not in answer["detail"], "no path of the server's"
        store.put(capture_name("cap_1"), b"no zip", content_type="application/zip")
        assert problem_of(await client.get(f"/v1/captures/{capture}/pictures")) == (503, "CAPTURE_DAMAGED")


async def test_films_are_read_by_parts(tmp_path: Path) -> None:
    store, film = memory(), bytes(range(256)) * 40
    capture = stored(store, "photos", {"a.jpg": b"x", "walk/b.MOV": film, "c.webm": b"webm", "d.txt": b"x"})
    async with gateway(tmp_path, store) as client:
        films = (await client.get(f"/v1/captures/{capture}/pictures")).json()["films"]
        assert [each["name"] for each in films] == ["walk/b.MOV", "c.webm"]
        whole = await client.get(films[0]["url"])
        assert (whole.status_code, whole.content) == (200, film)
        assert whole.headers["content-type"] == "video/mp4"
        assert whole.headers["accept-ranges"] == "bytes"
        assert whole.headers["cache-control"] == "private, no-store"
        assert (await client.get(films[1]["url"])).headers["content-type"] == "video/webm"
        for asked, told, part in [
            ("bytes=0-", f"bytes 0-{len(film) - 1}/{len(film)}", film),
            ("bytes=100-299", f"bytes 100-299/{len(film)}", film[100:300]),
            ("bytes=-7", f"bytes {len(film) - 7}-{len(film) - 1}/{len(film)}", film[-7:]),
        ]:
            answer = await client.get(films[0]["url"], headers={"Range": asked})
            assert (answer.status_code, answer.headers["content-range"], answer.content) == (206, told, part)
        for etag, status in [(whole.headers["etag"], 206), ('"another"', 200)]:
            answer = await client.get(films[0]["url"], headers={"Range": "bytes=0-9", "If-Range": etag})
            assert answer.status_code == status
        beyond = await client.get(films[0]["url"], headers={"Range": f"bytes={len(film)}-"})
        assert problem_of(beyond) == (416, "RANGE_UNSATISFIABLE")
        assert beyond.headers["content-range"] == f"bytes */{len(film)}"


@pytest.mark.parametrize("kind", ["rgbd", "points", "image"])
async def test_films_whose_key_frames_have_no_cameras_are_not_listed(tmp_path: Path, kind: str) -> None:
    store = memory()
    capture = stored(store, kind, {"rgb.mp4": b"x"})
    async with gateway(tmp_path, store) as client:
        assert (await client.get(f"/v1/captures/{capture}/pictures")).json()["films"] == []
        assert problem_of(await client.get(f"/v1/captures/{capture}/films/0")) == (404, "FILM_UNKNOWN")


async def test_a_damaged_archive_of_a_film_is_told(tmp_path: Path) -> None:
    store = memory()
    capture = stored(store, "photos", {"a.mp4": b"x"})
    data = store.get(capture_name(capture))
    store.put(capture_name(capture), b"PX" + data[2:], content_type="application/zip")
    async with gateway(tmp_path, store) as client:
        assert problem_of(await client.get(f"/v1/captures/{capture}/films/0")) == (503, "CAPTURE_DAMAGED")
        assert problem_of(await client.get("/v1/captures/cap_2/films/0")) == (404, "CAPTURE_UNKNOWN")


class FailingStore(MemoryStore):
    """A store in memory that fails to give a capture's files. fault: with what; after: so many reads of one"""

    fault: OSError
    suffix = ".zip"
    after = 0

    def get(self, name: str, **options: Any) -> bytes:
        if name.endswith(self.suffix):
            self.after -= 1
            if self.after < 0:
                raise self.fault
        return super().get(name, **options)


@pytest.mark.parametrize("suffix", [".zip", ".json"])
@pytest.mark.parametrize("path", ["pictures", "pictures/0", "films/0"])
async def test_a_store_that_fails_is_no_damaged_capture(tmp_path: Path, path: str, suffix: str) -> None:
    """Who deletes the capture, as is advised for a damaged one, loses it."""
    store = FailingStore()
    store.suffix = suffix
    capture = stored(store, "photos", {"a.jpg": photo((9, 9, 9)), "b.mp4": b"x" * 600_000})
    for fault, problem in (
        (ConnectionError("no answer"), (503, "STORE_UNAVAILABLE")),
        (FileNotFoundError("deleted meanwhile"), (404, "CAPTURE_UNKNOWN")),
    ):
        store.fault = fault
        async with gateway(tmp_path, store) as client:
            for after in range(2 if suffix == ".zip" else 1):
                store.after = after
                assert problem_of(await client.get(f"/v1/captures/{capture}/{path}")) == problem, after


@pytest.mark.parametrize(("at", "byte"), [(6, 200), (8, 1), (10, 9), (42, 255), (45, 255)])
async def test_a_rotten_list_of_an_archives_files_is_told(tmp_path: Path, at: int, byte: int) -> None:
    """They seem to ask for another version, a password or a method, or to lie before the archive."""
    store = memory()
    capture = stored(store, "photos", {"a.jpg": photo((9, 9, 9))})
    data = bytearray(store.get(capture_name(capture)))
    data[data.index(b"PK\1\2") + at] = byte
    store.put(capture_name(capture), bytes(data), content_type="application/zip")
    async with gateway(tmp_path, store) as client:
        assert problem_of(await client.get(f"/v1/captures/{capture}/pictures/0")) == (503, "CAPTURE_DAMAGED")
