"""The attacks of docs/security.md: each has a test that exists; files that cost much, sent to the running product."""

from __future__ import annotations

import ast
import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from PIL import Image

from capture2vr.cli.up import run_stack
from tests.edge.jobs.test_inspect_capture import obj_of_materials, ply_of_one_face
from tests.support import captures
from tests.support.patience import HANG_S
from tests.support.photos import private_pictures
from tests.support.repository import ROOT

PAGE = ROOT / "docs" / "security.md"
_ROW = re.compile(r"^\| (?P<attack>.+?) \| (?P<now>.+?) \| (?P<tests>.+?) \|$", re.MULTILINE)
_TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def rows() -> dict[str, list[tuple[str, str]]]:
    """File and name of the tests of each attack."""
    found = {row["attack"].strip(): _TEST.findall(row["tests"]) for row in _ROW.finditer(PAGE.read_text())}
    return {attack: tests for attack, tests in found.items() if attack != "attack" and not attack.startswith("-")}


@pytest.mark.parametrize("attack", rows())
def test_each_attack_has_a_test(attack: str) -> None:
    tests = rows()[attack]
    assert tests
    for file, name in tests:
        tree = ast.parse((ROOT / file).read_text())
        assert name in {
            each.name for each in ast.walk(tree) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
        }


def many_scans(side: int, scans: int) -> bytes:
    """A progressive JPEG whose last scan comes again and again."""
    buffer = io.BytesIO()
    Image.new("RGB", (side, side), (9, 99, 199)).save(buffer, "JPEG", progressive=True)
    whole = buffer.getvalue()
    last = whole.rindex(b"\xff\xda")
    return whole[:last] + whole[last:-2] * scans + whole[-2:]


def deep_png() -> bytes:
    whole = bytearray(private_pictures.png())
    whole[16:26] = struct.pack(">IIBB", 10_000, 9_990, 16, 6)
    whole[29:33] = struct.pack(">I", zlib.crc32(whole[12:29]))
    return bytes(whole)


COSTLY: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "a JPEG of 700 scans": ("a.jpg", lambda: many_scans(500, 700), "IMAGE_UNREADABLE"),
    "a large JPEG of 90 scans": ("a.jpg", lambda: many_scans(4_500, 80), "IMAGE_TOO_LARGE"),
    "a face of five million corners": ("a.ply", lambda: ply_of_one_face(5_100_000), "CAPTURE_TOO_LARGE"),
    "an OBJ of 60,000 materials": ("a.obj", lambda: obj_of_materials(60_000), "CAPTURE_TOO_LARGE"),
    "a PNG of 800 MB": ("a.png", deep_png, "IMAGE_TOO_LARGE"),
    "a line of 4 million numbers": ("a.xyz", lambda: b"1 2 3\n" + b"0.1 " * 4_000_000, "CAPTURE_UNREADABLE"),
}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A client of the running product."""
    data: Path = tmp_path_factory.mktemp("attacks") / "data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGE_DEVICE", "cpu")
        with run_stack("127.0.0.1", 0, data) as stack, httpx.Client(base_url=stack.url, timeout=HANG_S) as client:
            yield client


def upload(client: httpx.Client, file: str, content: bytes) -> httpx.Response:
    return client.post("/v1/captures", files=[("files", (file, content))])


@pytest.mark.slow
@pytest.mark.parametrize("name", COSTLY)
def test_a_costly_file_is_refused_and_others_go_on(name: str, client: httpx.Client) -> None:
    file, make, code = COSTLY[name]
    content = make()
    honest = captures.ply_bytes(*captures.sphere())
    with ThreadPoolExecutor() as threads:
        refused = [threads.submit(upload, client, file, content) for _ in range(2)]
        accepted = upload(client, "honest.ply", honest)
    assert (accepted.status_code, accepted.json()["inspected"]) == (201, True)
    for answer in refused:
        problem = answer.result().json()
        assert (problem["status"], problem["code"], problem["file"]) == (422, code, file), problem
        assert problem["hints"]
