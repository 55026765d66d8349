"""What bad input gets from the whole product: a reason that names the file and says what to do; nothing stays."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from capture2vr.cli import main as command_line
from capture2vr.cli.up import run_stack
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.support import captures
from tests.support.bad_captures import BAD, EMOJI, HTML, zipped
from tests.support.bundles import bundle
from tests.support.clouds import write_ply
from tests.support.patience import PATIENCE_S

PROBLEM = "application/problem+json"
JSON = {"Content-Type": "application/json"}
ZIP = {"Content-Type": "application/zip"}
FORM = {"Content-Type": "multipart/form-data; boundary=b0"}
END = b"--b0--\r\n"


@dataclass(frozen=True)
class Product:
    """Gateway, worker and store, running; `file` is the address of a published one."""

    url: str
    data: Path
    client: httpx.Client
    file: str

    def kept(self) -> set[str]:
        """The files that uploads and jobs leave: staged, in the worker's scratch, on the store."""
        roots = [self.data / "gateway" / "uploads", self.data / "scratch", self.data / "store"]
        # Not rglob: it raises where a folder goes while it is looked into.
        walked = [found for root in roots for found in os.walk(root)]
        paths = [Path(folder, name) for folder, folders, files in walked for name in (*folders, *files)]
        return {str(path) for path in paths if ".locks" not in path.parts}

    def logged(self) -> str:
        return "".join(path.read_text(errors="replace") for path in (self.data / "logs").iterdir())


@pytest.fixture(scope="module")
def product(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Product]:
    data = tmp_path_factory.mktemp("bad") / "data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDGE_DEVICE", "cpu")  # a worker that looks for a GPU imports PyTorch
        with run_stack("127.0.0.1", 0, data) as stack, httpx.Client(base_url=stack.url, timeout=PATIENCE_S) as client:
            publish(bundle(), LocalStore(stack.store_root), key="dress")
            name = client.get("/v1/assets/dress").json()["files"][0]["name"]
            client.post("/v1/captures")  # makes the staging folder
            yield Product(stack.url, data, client, f"/v1/files/{name}")


@pytest.fixture
def nothing_stays(product: Product) -> Iterator[None]:
    """What the test is refused leaves no file, no job and no traceback, and the product goes on."""
    before, said = product.kept(), len(product.logged())
    yield
    deadline = time.monotonic() + PATIENCE_S  # the worker's thread leaves its folder just after its answer
    while product.kept() != before and time.monotonic() < deadline:
        time.sleep(0.02)
    assert product.kept() == before
    assert "Traceback" not in product.logged()[said:]
    assert product.client.get("/v1/jobs").json()["jobs"] == []


def problem_of(answer: httpx.Response) -> dict[str, Any]:
    """The problem document, once it is one that a person can act upon."""
    assert 400 <= answer.status_code < 500, answer.text
    assert answer.headers["content-type"] == PROBLEM, answer.text
    document: dict[str, Any] = answer.json()
    assert document["status"] == answer.status_code
    assert document["detail"]
    assert "Traceback" not in answer.text
    assert all(document["hints"]), document
    assert document["hints"], document
    return document


def parts_of(source: Path) -> list[tuple[str, tuple[str, bytes]]]:
    """The form that a browser sends for a file or a folder."""
    paths = [path for path in sorted(source.rglob("*")) if path.is_file()] if source.is_dir() else [source]
    root = source if source.is_dir() else source.parent
    return [("files", (path.relative_to(root).as_posix(), path.read_bytes())) for path in paths]


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", BAD)
def test_an_upload_is_refused(name: str, product: Product, tmp_path: Path) -> None:
    bad = BAD[name]
    answer = product.client.post("/v1/captures", files=parts_of(bad.make(tmp_path)))
    document = problem_of(answer)
    assert (document["code"], document.get("file", "")) == (bad.code, bad.file), document


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", [name for name in BAD if " zip" in name])
def test_so_is_the_bare_archive(name: str, product: Product, tmp_path: Path) -> None:
    """As a raw body, where the archive has no name."""
    bad = BAD[name]
    body = bad.make(tmp_path).read_bytes()
    document = problem_of(product.client.post("/v1/captures", content=body, headers=ZIP))
    assert document["code"] == bad.code, document


@dataclass(frozen=True)
class Said:
    """Exit code, and the lines that begin as the last word does."""

    code: int
    lines: list[str]


Run = Callable[..., Said]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """`capture2vr` in this process, with a folder for temporary files that must be empty afterwards."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))

    def run(*arguments: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["capture2vr", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            command_line.main()
        assert not (tmp_path / "out").exists()
        assert list(temporary.iterdir()) == []
        said = capsys.readouterr()
        assert said.out == ""
        assert "Traceback" not in said.err
        return Said(left.value.code, [line for line in said.err.splitlines() if line.startswith("capture2vr: ")])

    return run


# The sky's photos are searched for points that match, which takes seconds.
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "the sky" else name for name in BAD]
)
def test_the_command_line_says_it_in_one_sentence(name: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    source = BAD[name].make(tmp_path / "in")
    said = run("run", source, "-o", tmp_path / "out", "--device", "cpu")
    assert said.code == 2
    (line,) = said.lines
    assert source.name in line
    assert BAD[name].file in line
    assert re.search(r" \(.+\)$", line), f"nothing to do about it: {line}"


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", BAD)
def test_pushing_it_says_so_too(name: str, run: Run, product: Product, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    source = BAD[name].make(tmp_path / "in")
    said = run("push", source, "--key", "x", "--gateway", product.url)
    assert said.code == 2
    (line,) = said.lines
    assert (BAD[name].file or source.name) in line
    assert re.search(r" \(.+\)$", line), f"nothing to do about it: {line}"


@pytest.mark.parametrize(
    "gateway", ["nonsense", "http://127.0.0.1:8080http:", "ftp://x", "http://[", "http://127.0.0.1:1"]
)
@pytest.mark.parametrize("command", ["push", "pull"])
def test_a_gateway_that_is_none_is_named(command: str, gateway: str, run: Run, tmp_path: Path) -> None:
    (tmp_path / "scan.ply").write_bytes(b"ply\n")
    arguments = {"push": [tmp_path / "scan.ply", "--key", "x"], "pull": ["x", "-o", tmp_path / "out"]}
    said = run(command, *arguments[command], "--gateway", gateway)
    assert said.code == 2
    (line,) = said.lines
    assert gateway in line


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", ["scan[red].ply", "scan [.ply", os.fsdecode(b"caf\xe9.ply")])
def test_names_that_terminals_and_zips_take_for_something_else(
    name: str, run: Run, product: Product, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(b"ply\n")
    for said in (
        run("run", tmp_path / name, "-o", tmp_path / "out"),
        run("push", tmp_path / name, "--key", "x", "--gateway", product.url),
    ):
        assert said.code == 2
        (line,) = said.lines
        assert line.isprintable()
        assert name[:3] in line


@pytest.mark.slow
@pytest.mark.parametrize("name", ["an empty file", "a zip with ../"])
def test_as_a_process_of_its_own(name: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    source = BAD[name].make(tmp_path / "in")
    command = [sys.executable, "-m", "capture2vr.cli", "run", str(source), "-o", str(tmp_path / "out")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert result.returncode == 2
    assert len([line for line in result.stderr.splitlines() if line.startswith("capture2vr: ")]) == 1
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.ply"], ["nowhere.ply"]),
        (["good.ply", "--preset", "magic"], ["magic", "draft"]),
        (["good.ply", "--key", "../escape"], ["../escape"]),
        (["good.ply", "--key", "a b"], ["a b"]),
        (["pipe.ply"], ["pipe.ply"]),
        (["x" * 300 + ".ply"], ["x" * 300]),
        (["good.ply", "-o", "good.ply"], ["good.ply"]),
        (["good.ply", "-o", "good.ply/out"], ["good.ply"]),
        (["good.ply", "--box", "0.8,0.1,0.2,0.9"], ["--box", "empty", "left,top,right,bottom"]),
        (["good.ply", "--box", "120,80,900,700"], ["--box", "beyond the photo", "divide by"]),
        (["good.ply", "--box", "all"], ["--box", "four numbers"]),
        (["good.ply", "--box", "0.1,0.1,0.9,0.9"], ["good.ply", "rectangle", "photo", "leave the rectangle out"]),
        (["bell\a\nring.ply"], ["ring.ply"]),
        ([b"caf\xe9.ply".decode("utf-8", "surrogateescape")], [".ply"]),
    ],
)
def test_bad_arguments_too(
    arguments: list[str], words: list[str], run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_ply(tmp_path / "good.ply", np.random.default_rng(0).normal(size=(500, 3)))
    os.mkfifo(tmp_path / "pipe.ply")
    said = run("run", "-o", tmp_path / "out", *arguments)
    assert said.code == 2
    (line,) = said.lines
    assert line.isprintable()
    assert all(word in line for word in words)


def part(file: str, content: bytes = b"ply\n") -> bytes:
    """A file of a form."""
    disposition = f'form-data; name="files"; filename="{file}"'
    return f"--b0\r\nContent-Disposition: {disposition}\r\n\r\n".encode() + content + b"\r\n"


def field(name: str, content: bytes) -> bytes:
    """A text field of a form."""
    return f'--b0\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'.encode() + content + b"\r\n"


UPLOADS: dict[str, tuple[Mapping[str, str | bytes], bytes, str]] = {
    "no media type": ({}, b"x", "UPLOAD_MEDIA_TYPE"),
    "JSON": (JSON, b"{}", "UPLOAD_MEDIA_TYPE"),
    "a bare picture": ({"Content-Type": "image/png"}, b"\x89PNG\r\n\x1a\n", "UPLOAD_MEDIA_TYPE"),
    "a form without boundary": ({"Content-Type": "multipart/form-data"}, b"x", "UPLOAD_MEDIA_TYPE"),
    "a boundary of 300 letters": (
        {"Content-Type": "multipart/form-data; boundary=" + "x" * 300},
        b"x",
        "UPLOAD_MALFORMED",
    ),
    "a boundary of other letters": (
        {"Content-Type": b"multipart/form-data; boundary=\xff\xe4"},
        b"x",
        "UPLOAD_MALFORMED",
    ),
    "an empty body": (ZIP, b"", "CAPTURE_EMPTY"),
    "an empty form body": (FORM, b"", "UPLOAD_MALFORMED"),
    "an empty form": (FORM, END, "CAPTURE_EMPTY"),
    "a form without an end": (FORM, part("a.ply"), "UPLOAD_MALFORMED"),
    "a file without a name": (FORM, part("") + END, "CAPTURE_EMPTY"),
    "a file named ..": (FORM, part("..") + END, "CAPTURE_EMPTY"),
    "text where files belong": (FORM, field("files", b"1 2 3") + END, "CAPTURE_EMPTY"),
    "a name of 5,000 letters": (FORM, part("x" * 5000 + ".ply") + END, "UPLOAD_MALFORMED"),
    "a path of 3,000 folders": (FORM, part("a/" * 3000 + "b.ply") + END, "UPLOAD_MALFORMED"),
    "a folder that is a file": (FORM, part("a.ply") + part("a.ply/b.ply") + END, "UPLOAD_NAMES"),
    "a header of 200 kB": (FORM, b"--b0\r\nA: " + b"x" * 200_000 + b"\r\n\r\n\r\n" + END, "UPLOAD_MALFORMED"),
    "5,000 headers": (FORM, b"--b0\r\n" + b"A: x\r\n" * 5000 + b"\r\n\r\n" + END, "UPLOAD_MALFORMED"),
    "a text field of 5 kB": (FORM, field("name", b"x" * 5000) + END, "UPLOAD_FIELD_TOO_LARGE"),
    "6,000 files": (FORM, b"".join(part(f"{n}.txt", b"1") for n in range(6000)) + END, "UPLOAD_TOO_MANY_FILES"),
    "a body that gzip should open": ({**ZIP, "Content-Encoding": "gzip"}, b"\x1f\x8b\x08", "ARCHIVE_BROKEN"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", UPLOADS)
def test_an_odd_request_to_upload_is_refused(name: str, product: Product) -> None:
    headers, body, code = UPLOADS[name]
    document = problem_of(product.client.post("/v1/captures", headers=dict(headers), content=body))
    assert document["code"] == code, document


def test_names_in_any_script_are_kept(product: Product) -> None:
    xyz, _, _ = captures.sphere()
    answer = product.client.post("/v1/captures", files=[("files", (EMOJI, captures.ply_bytes(xyz)))])
    assert answer.status_code == 201, answer.text
    assert [file["file"] for file in answer.json()["files"]] == [EMOJI]


def job(**changes: object) -> bytes:
    """An order of an unknown capture."""
    return json.dumps({"capture": "cap_unknown", "asset_key": "dress"} | changes).encode()


JOBS: dict[str, tuple[bytes, int, str]] = {
    "no body": (b"", 422, "REQUEST_INVALID"),
    "half a document": (b"{", 422, "REQUEST_INVALID"),
    "a list": (b"[]", 422, "REQUEST_INVALID"),
    "null": (b"null", 422, "REQUEST_INVALID"),
    "NaN": (b"NaN", 422, "REQUEST_INVALID"),
    "bytes that are no text": (b"\xff\xfe{", 400, "BAD_REQUEST"),
    "60,000 brackets": (b"[" * 60_000, 400, "BAD_REQUEST"),
    "a number of 5,000 digits": (b'{"capture": ' + b"1" * 5000 + b"}", 400, "BAD_REQUEST"),
    "a megabyte": (job(label="x" * 1_000_000), 413, "REQUEST_TOO_LARGE"),
    "half a character": (b'{"capture": "\\ud800", "asset_key": "dress"}', 422, "REQUEST_INVALID"),
    "a number for a capture": (job(capture=1), 422, "REQUEST_INVALID"),
    "a list for a preset": (job(preset=["draft"]), 422, "REQUEST_INVALID"),
    "a cut that does not exist": (job(cut="maybe"), 422, "REQUEST_INVALID"),
    "a thing of no size": (job(longest_m=0), 422, "REQUEST_INVALID"),
    "a thing of a light year": (job(longest_m=9.5e15), 422, "REQUEST_INVALID"),
    "a box of three numbers": (job(box=[0.1, 0.2, 0.3]), 422, "BOX_INVALID"),
    "a reversed box": (job(box=[0.8, 0.1, 0.2, 0.9]), 422, "BOX_INVALID"),
    "a box in pixels": (job(box=[120, 80, 900, 700]), 422, "BOX_INVALID"),
    "a word for a box": (job(box="all"), 422, "REQUEST_INVALID"),
    "an unknown field": (job(colour="red"), 422, "REQUEST_INVALID"),
    "a label of 300 letters": (job(label="x" * 300), 422, "REQUEST_INVALID"),
    "an unknown preset": (job(preset="magic"), 422, "PRESET_UNKNOWN"),
    "an unknown capture": (job(), 404, "CAPTURE_UNKNOWN"),
    "a capture that is a path": (job(capture="../../etc/passwd"), 404, "CAPTURE_UNKNOWN"),
    "a capture of 0 bytes": (job(capture="\0"), 404, "CAPTURE_UNKNOWN"),
    "no key": (job(asset_key=""), 422, "KEY_INVALID"),
    "a key with a slash": (job(asset_key="a/b"), 422, "KEY_INVALID"),
    "a key of dots": (job(asset_key=".."), 422, "KEY_INVALID"),
    "a key that leads out": (job(asset_key="../x"), 422, "KEY_INVALID"),
    "a key of 101 letters": (job(asset_key="x" * 101), 422, "KEY_INVALID"),
    "a key of a picture": (job(asset_key="🪑"), 422, "KEY_INVALID"),
    "a key with a line's end": (job(asset_key="a\n"), 422, "KEY_INVALID"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", JOBS)
def test_an_order_that_makes_no_sense_is_refused(name: str, product: Product) -> None:
    body, status, code = JOBS[name]
    document = problem_of(product.client.post("/v1/jobs", content=body, headers=JSON))
    assert (document["status"], document["code"]) == (status, code), document


def scene(**changes: object) -> bytes:
    """A scene of one thing, which is changed."""
    thing = {"id": "a", "asset": "chair", "position_m": [0, 0, 0], **changes}
    return json.dumps({"name": "Room", "items": [thing]}).encode()


SCENES: dict[str, tuple[bytes, int, str]] = {
    "no body": (b"", 422, "REQUEST_INVALID"),
    "no name": (b"{}", 422, "REQUEST_INVALID"),
    "a name of blanks": (b'{"name": "  "}', 422, "REQUEST_INVALID"),
    "a name with a line's end": (b'{"name": "a\\nb"}', 422, "REQUEST_INVALID"),
    "a name of 101 letters": (json.dumps({"name": "x" * 101}).encode(), 422, "REQUEST_INVALID"),
    "51 things": (json.dumps({"name": "x", "items": [{}] * 51}).encode(), 422, "REQUEST_INVALID"),
    "60,000 brackets": (b"[" * 60_000, 400, "BAD_REQUEST"),
    "a megabyte": (json.dumps({"name": "x" * 1_000_000}).encode(), 413, "REQUEST_TOO_LARGE"),
    "NaN": (b'{"name": "x", "items": [{"id": "a", "asset": "b", "position_m": [NaN, 0, 0]}]}', 422, "REQUEST_INVALID"),
    "an asset that leads out": (scene(asset="../x"), 422, "REQUEST_INVALID"),
    "an id of markup": (scene(id="<img>"), 422, "REQUEST_INVALID"),
    "a place on the moon": (scene(position_m=[0, 3.8e8, 0]), 422, "REQUEST_INVALID"),
    "a place in the plane": (scene(position_m=[0, 0]), 422, "REQUEST_INVALID"),
    "words for a place": (scene(position_m=["0", "0", "0"]), 422, "REQUEST_INVALID"),
    "a rotation to nowhere": (scene(rotation=[0, 0, 0, 0]), 422, "REQUEST_INVALID"),
    "a scale of 0": (scene(scale=0), 422, "REQUEST_INVALID"),
    "a mirror": (scene(scale=-1), 422, "REQUEST_INVALID"),
    "an unknown field": (scene(colour="red"), 422, "REQUEST_INVALID"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", SCENES)
def test_a_scene_that_makes_no_sense_is_refused(name: str, product: Product) -> None:
    body, status, code = SCENES[name]
    document = problem_of(product.client.post("/v1/scenes", content=body, headers=JSON))
    assert (document["status"], document["code"]) == (status, code), document


def moving(sender: object = "me", count: int = 1, **changes: object) -> bytes:
    """A report of things that are moved, which are changed."""
    thing = {"id": "a", "position_m": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": 1, **changes}
    return json.dumps({"sender": sender, "items": [thing] * count}).encode()


MOVINGS: dict[str, tuple[bytes, int, str]] = {
    "no body": (b"", 422, "REQUEST_INVALID"),
    "a list": (b"[]", 422, "REQUEST_INVALID"),
    "nothing that moves": (moving(count=0), 422, "REQUEST_INVALID"),
    "9 things": (moving(count=9), 422, "REQUEST_INVALID"),
    "60,000 brackets": (b"[" * 60_000, 400, "BAD_REQUEST"),
    "a megabyte": (moving(sender="x" * 1_000_000), 413, "REQUEST_TOO_LARGE"),
    "a sender of markup": (moving(sender="<img>"), 422, "REQUEST_INVALID"),
    "a sender with a line's end": (moving(sender="a\nevent: scene"), 422, "REQUEST_INVALID"),
    "no sender": (moving(sender=None), 422, "REQUEST_INVALID"),
    "an id of markup": (moving(id="<img>"), 422, "REQUEST_INVALID"),
    "a place on the moon": (moving(position_m=[0, 3.8e8, 0]), 422, "REQUEST_INVALID"),
    "a place that is no number": (moving(position_m=[0, float("nan"), 0]), 422, "REQUEST_INVALID"),
    "a rotation to nowhere": (moving(rotation=[0, 0, 0, 0]), 422, "REQUEST_INVALID"),
    "no rotation": (moving(rotation=None), 422, "REQUEST_INVALID"),
    "a scale of 0": (moving(scale=0), 422, "REQUEST_INVALID"),
    "an asset": (moving(asset="chair"), 422, "REQUEST_INVALID"),
    "no such scene": (moving(), 404, "SCENE_UNKNOWN"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", MOVINGS)
def test_a_move_that_makes_no_sense_is_refused(name: str, product: Product) -> None:
    body, status, code = MOVINGS[name]
    path = "/v1/scenes/scn_000000000000000000000000/moving"
    document = problem_of(product.client.post(path, content=body, headers=JSON))
    assert (document["status"], document["code"]) == (status, code), document


CONTINUES: dict[str, tuple[str, int, str]] = {
    "an unknown capture": ("cap_unknown", 404, "CAPTURE_UNKNOWN"),
    "a capture that is a path": ("../../etc/passwd", 422, "REQUEST_INVALID"),
    "a capture of another folder": ("tenants%2fada%2fcap_1", 422, "REQUEST_INVALID"),
    "a capture of 0 bytes": ("%00", 422, "REQUEST_INVALID"),
    "a capture of 300 letters": ("x" * 300, 422, "REQUEST_INVALID"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", CONTINUES)
def test_an_upload_that_continues_nothing_is_refused(name: str, product: Product) -> None:
    capture, status, code = CONTINUES[name]
    body, headers = zipped({"scan.ply": HTML}), {"Content-Type": "application/zip"}
    answer = product.client.post(f"/v1/captures?continues={capture}", content=body, headers=headers)
    assert (answer.status_code, problem_of(answer)["code"]) == (status, code)


INSIDE_OUT = b'{"edits": {"crop": {"centre": [0, 0, 0], "size": [-1, 1, 1]}}}'
TWO_CORNERS = b'{"edits": {"lassos": [{"photo": "a.jpg", "line": [[0, 0], [1, 1]]}]}}'
BEYOND_PHOTO = b'{"edits": {"lassos": [{"photo": "a.jpg", "line": [[0, 0], [1, 1e9], [0, 1]]}]}}'
MANY_LASSOS = json.dumps({"edits": {"lassos": 31 * [{"photo": "a", "line": [[0, 0], [1, 1], [0, 1]]}]}}).encode()
ZERO_LENGTH = b'{"edits": {"length": {"start": [0, 0, 0], "end": [1, 0, 0], "metres": 0}}}'
AGAIN: dict[str, tuple[str, bytes, int, str]] = {
    "an unknown job": ("job_unknown", b'{"cut": "scene"}', 404, "JOB_UNKNOWN"),
    "a job of 0 bytes": ("%00", b'{"cut": "scene"}', 404, "JOB_UNKNOWN"),
    "no cut": ("job_unknown", b"{}", 422, "REQUEST_INVALID"),
    "a cut that does not exist": ("job_unknown", b'{"cut": "half"}', 422, "REQUEST_INVALID"),
    "edits that are none": ("job_unknown", b'{"edits": {"crop": {}}}', 422, "EDITS_INVALID"),
    "a box inside out": ("job_unknown", INSIDE_OUT, 422, "EDITS_INVALID"),
    "a length of zero": ("job_unknown", ZERO_LENGTH, 422, "EDITS_INVALID"),
    "a lasso of two corners": ("job_unknown", TWO_CORNERS, 422, "EDITS_INVALID"),
    "a lasso beyond its photo": ("job_unknown", BEYOND_PHOTO, 422, "EDITS_INVALID"),
    "31 lassos": ("job_unknown", MANY_LASSOS, 422, "EDITS_INVALID"),
    "NaN": ("job_unknown", b'{"edits": {"up": [NaN, 0, 0]}}', 422, "EDITS_INVALID"),
    "a capture of 300 letters": ("job_unknown", b'{"capture": "' + b"x" * 300 + b'"}', 422, "REQUEST_INVALID"),
    "another preset": ("job_unknown", b'{"cut": "scene", "preset": "fine"}', 422, "REQUEST_INVALID"),
    "60,000 brackets": ("job_unknown", b"[" * 60_000, 400, "BAD_REQUEST"),
    "a megabyte": ("job_unknown", b'{"cut": "' + b"x" * 1_000_000 + b'"}', 413, "REQUEST_TOO_LARGE"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", AGAIN)
def test_a_job_that_cannot_be_repeated_is_refused(name: str, product: Product) -> None:
    job_id, body, status, code = AGAIN[name]
    document = problem_of(product.client.post(f"/v1/jobs/{job_id}/again", content=body, headers=JSON))
    assert (document["status"], document["code"]) == (status, code), document


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("headers", [{}, {"Content-Type": "text/plain"}, {"Content-Type": "multipart/form-data"}])
def test_an_order_that_is_not_sent_as_json_is_told_so(headers: dict[str, str], product: Product) -> None:
    document = problem_of(product.client.post("/v1/jobs", content=job(), headers=headers))
    assert (document["status"], document["code"]) == (415, "REQUEST_MEDIA_TYPE")
    assert "application/json" in document["detail"]


@pytest.mark.parametrize("key", ["a b", "k" * 201, "käse".encode()])
def test_an_odd_idempotency_key_is_refused(key: str, product: Product) -> None:
    answer = product.client.post("/v1/jobs", content=job(), headers={**JSON, "Idempotency-Key": key})
    assert problem_of(answer)["code"] == "REQUEST_INVALID"


GETS: dict[str, tuple[str, str]] = {
    "an unknown job": ("/v1/jobs/job_unknown", "JOB_UNKNOWN"),
    "its events": ("/v1/jobs/job_unknown/events", "JOB_UNKNOWN"),
    "a job of 0 bytes": ("/v1/jobs/%00", "JOB_UNKNOWN"),
    "a job that is no text": ("/v1/jobs/%ff%fe", "JOB_UNKNOWN"),
    "a job of 9,000 letters": ("/v1/jobs/" + "x" * 9000, "JOB_UNKNOWN"),
    "a job that leads out": ("/v1/jobs/..%2f..%2fetc", "NOT_FOUND"),
    "no jobs a page": ("/v1/jobs?limit=0", "REQUEST_INVALID"),
    "a page of words": ("/v1/jobs?limit=many", "REQUEST_INVALID"),
    "a page behind nothing": ("/v1/jobs?after=%00", "REQUEST_INVALID"),
    "events before the first": ("/v1/jobs/job_unknown/events?after=-1", "REQUEST_INVALID"),
    "an unknown asset": ("/v1/assets/unknown", "ASSET_UNKNOWN"),
    "an asset that leads out": ("/v1/assets/%2e%2e", "KEY_INVALID"),
    "an asset in a folder": ("/v1/assets/a%2fb", "NOT_FOUND"),
    "an asset of 300 letters": ("/v1/assets/" + "x" * 300, "REQUEST_INVALID"),
    "an asset of 0 bytes": ("/v1/assets/%00", "KEY_INVALID"),
    "an unknown asset's level": ("/v1/assets/unknown/lod/0", "ASSET_UNKNOWN"),
    "an unknown level": ("/v1/assets/dress/lod/9", "LOD_UNKNOWN"),
    "an asset of another tenant": ("/v1/assets/dress?tenant=nobody", "ASSET_UNKNOWN"),
    "a tenant that leads out": ("/v1/assets/dress?tenant=..%2fada", "REQUEST_INVALID"),
    "an altered share link": ("/s/shr_000000000000000000000000.x", "SHARE_UNKNOWN"),
    "an unknown scene": ("/v1/scenes/scn_000000000000000000000000", "SCENE_UNKNOWN"),
    "a scene that leads out": ("/v1/scenes/..%2fx", "NOT_FOUND"),
    "a scene of letters": ("/v1/scenes/room", "REQUEST_INVALID"),
    "an unknown scene's events": ("/v1/scenes/scn_000000000000000000000000/events", "SCENE_UNKNOWN"),
    "events of a scene of letters": ("/v1/scenes/room/events", "REQUEST_INVALID"),
    "events after no version": ("/v1/scenes/scn_000000000000000000000000/events?after=-1", "REQUEST_INVALID"),
    "scenes behind nothing": ("/v1/scenes?after=x", "REQUEST_INVALID"),
    "a viewer of no scene": ("/scene/room", "SCENE_INVALID"),
    "a wardrobe that leads out": ("/wardrobe/%2e%2e", "COLLECTION_INVALID"),
    "a share of letters": ("/v1/shares/dress/qr.svg", "REQUEST_INVALID"),
    "a level of letters": ("/v1/assets/dress/lod/x", "REQUEST_INVALID"),
    "an unknown asset's QR code": ("/v1/assets/unknown/qr.svg", "ASSET_UNKNOWN"),
    "an unknown asset's notes": ("/v1/assets/unknown/notes", "ASSET_UNKNOWN"),
    "notes that lead out": ("/v1/assets/%2e%2e/notes", "KEY_INVALID"),
    "an unknown asset's downloads": ("/v1/assets/unknown/downloads", "ASSET_UNKNOWN"),
    "an unknown asset's download": ("/v1/assets/unknown/download?format=obj", "ASSET_UNKNOWN"),
    "a download of no format": ("/v1/assets/dress/download", "REQUEST_INVALID"),
    "a download of an unknown format": ("/v1/assets/dress/download?format=..%2fobj", "FORMAT_UNKNOWN"),
    "a download of a format of 300 letters": (f"/v1/assets/dress/download?format={'z' * 300}", "REQUEST_INVALID"),
    "a download of version 0": ("/v1/assets/dress/download?format=obj&version=0", "REQUEST_INVALID"),
    "a download of a version of letters": ("/v1/assets/dress/download?format=obj&version=x", "REQUEST_INVALID"),
    "a download of an unknown version": ("/v1/assets/dress/download?format=obj&version=99", "VERSION_UNKNOWN"),
    "assets behind a path": ("/v1/assets?after=../x", "KEY_INVALID"),
    "an unknown file": ("/v1/files/assets/unknown", "FILE_UNKNOWN"),
    "a folder": ("/v1/files/assets/dress", "FILE_UNKNOWN"),
    "somebody's capture": ("/v1/files/captures/x.zip", "FILE_UNKNOWN"),
    "a file that leads out": ("/v1/files/assets/%2e%2e/%2e%2e/gateway/jobs.db", "FILE_UNKNOWN"),
    "a file of 0 bytes": ("/v1/files/assets/a%00b", "FILE_UNKNOWN"),
    "a file of 300 letters": ("/v1/files/assets/" + "y" * 300, "FILE_UNKNOWN"),
    "a viewer of nothing": ("/view/%2e%2e", "KEY_INVALID"),
    "no page": ("/nowhere", "NOT_FOUND"),
    "no module": ("/web/nowhere.js", "NOT_FOUND"),
    "a module that leads out": ("/web/%2e%2e/app.py", "NOT_FOUND"),
    "a module of 0 bytes": ("/web/%00", "NOT_FOUND"),
    "a module of 300 letters": ("/web/" + "x" * 300, "NOT_FOUND"),
}


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("name", GETS)
def test_what_is_not_there_is_said(name: str, product: Product) -> None:
    path, code = GETS[name]
    assert problem_of(product.client.get(path))["code"] == code


@pytest.mark.parametrize("number", ["abc", "-1", "1.5", "9" * 30, "\N{ARABIC-INDIC DIGIT ONE}".encode()])
@pytest.mark.parametrize("path", ["/v1/jobs/job_unknown/events", f"/v1/scenes/scn_{'0' * 24}/events"])
def test_a_malformed_last_event_id_is_refused(path: str, number: str, product: Product) -> None:
    answer = product.client.get(path, headers={"Last-Event-ID": number})
    assert problem_of(answer)["code"] == "REQUEST_INVALID"


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize(
    "wanted",
    [
        *("potato", "bytes", "bytes=", "bytes=-", "bytes=abc", "bytes=5-2", "bytes=--1", "bytes=0-1,3-4", "lines=0-1"),
        *("bytes=" + "9" * 5000 + "-", "bytes=-" + "9" * 5000, "bytes=0-" + "9" * 5000, "bytes=\u0661-".encode()),
    ],
)
def test_what_is_no_range_gives_the_whole_file_or_416(wanted: str, product: Product) -> None:
    """RFC 9110, 14.2: a malformed Range is ignored; one behind the end is 416."""
    whole = product.client.get(product.file).content
    answer = product.client.get(product.file, headers={"Range": wanted})
    if answer.status_code == 416:
        assert problem_of(answer)["code"] == "RANGE_UNSATISFIABLE"
        assert answer.headers["content-range"] == f"bytes */{len(whole)}"
    else:
        assert answer.status_code in (200, 206)
        assert answer.content == whole


PATHS = ["/", "/view/dress", "/v1/captures", "/v1/jobs", "/v1/jobs/x", "/v1/jobs/x/events", "/v1/jobs/x/cancel"]
PATHS += ["/v1/presets", "/v1/assets", "/v1/assets/dress", "/v1/assets/dress/lod/0", "/v1/assets/dress/qr.svg"]
PATHS += ["/v1/assets/dress/downloads", "/v1/assets/dress/notes"]
PATHS += ["/v1/uploads/upl_0/capture", "/livez", "/readyz", "/metrics", "/openapi.json", "/web/nowhere.js"]


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("path", PATHS)
def test_other_methods_are_refused_or_harmless(path: str, product: Product) -> None:
    known = {"DELETE", "PATCH"} if path == "/v1/assets/dress" else set()
    methods = {"OPTIONS", "PUT", "DELETE", "PATCH", "TRACE"} - known
    for method in methods:
        assert problem_of(product.client.request(method, path))["code"] in ("METHOD_NOT_ALLOWED", "NOT_FOUND")
    head = product.client.head(path)
    assert head.status_code in (200, 404, 405)
    assert head.content == b""


def talk(product: Product, request: bytes, *, leave: bool) -> bytes:
    """Send bytes and hear the answer to its end; `leave` hangs up at once."""
    host, port = product.url.removeprefix("http://").split(":")
    heard = b""
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
        connection.sendall(request)
        while not leave and (block := connection.recv(65536)):
            heard += block
    return heard


def upload(length: object, body: bytes, *extra: str) -> bytes:
    lines = ["POST /v1/captures HTTP/1.1", "Host: x", "Content-Type: application/zip", f"Content-Length: {length}"]
    return "\r\n".join([*lines, *extra, "", ""]).encode() + body


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize("sent", [0, 4, 3_000_000])
def test_an_upload_that_breaks_off_leaves_nothing(sent: int, product: Product) -> None:
    archive = b"PK\x03\x04" + bytes(4_000_000)
    talk(product, upload(len(archive), archive[:sent]), leave=True)
    assert product.client.get("/readyz").is_success


@pytest.mark.usefixtures("nothing_stays")
@pytest.mark.parametrize(
    ("length", "status"), [(10, 422), (10**12, 413), (-1, 400), ("ten", 400), ("5, 7", 400), (10**30, 400)]
)
def test_a_length_that_lies_is_refused(length: object, status: int, product: Product) -> None:
    body = zipped({"scan.ply": HTML})
    answer = talk(product, upload(length, body, "Connection: close"), leave=False)
    assert answer.startswith(f"HTTP/1.1 {status} ".encode())
    assert b"Traceback" not in answer


@pytest.mark.slow
def test_the_product_goes_on(product: Product) -> None:
    """After all of this. The gateway's first process still serves: a crash would have closed its connections."""
    assert product.client.get("/readyz").json()["ready"]
    assert "Traceback" not in product.logged()
