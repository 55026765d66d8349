"""The gateway as it is started: a process of its own that has opened no picture yet, with nothing the tests import."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pillow_heif
import pytest
from PIL import Image, ImageDraw

from capture2vr.cli.up import free_port
from tests.support.fresh_process import BARE_ENVIRONMENT, run_fresh
from tests.support.photos import private_pictures
from tests.support.photos.walkaround import render_walkaround

pytestmark = pytest.mark.slow

VIEWS = 5

# Those that need a decoder which is not loaded by itself come first: one JPEG, and Pillow knows more than it did.
ENCODERS: dict[str, tuple[str, dict[str, Any]]] = {
    "heic": ("HEIF", {"quality": 92}),
    "webp": ("WEBP", {"quality": 92}),
    "tiff": ("TIFF", {}),
    "png": ("PNG", {}),
    "jpg": ("JPEG", {"quality": 92}),
}

# The gateway's check of one file in each folder. One interpreter loads what checks uploads, and forks for each: none
# knows what the others have loaded.
STRIP = """
import os, sys, traceback
from pathlib import Path
from capture2vr.gateway.uploads.validate import validate

for folder in sorted(Path(sys.argv[1]).iterdir()):
    if os.fork() == 0:
        try:
            (file,) = folder.iterdir()
            (verdict,) = validate(folder, [file.name], lambda name: None)
            said = f"{verdict.verdict} {','.join(verdict.stripped)}"
        except BaseException:
            said = traceback.format_exc()
        Path(sys.argv[2], folder.name).write_text(said)
        os._exit(0)
    os.wait()
"""


def several_pictures() -> bytes:
    """Phones write a second picture (depth, gain map) behind the first; Pillow calls that format MPO."""
    buffer = io.BytesIO()
    private_pictures.picture().save(
        buffer,
        "MPO",
        save_all=True,
        append_images=[private_pictures.picture(32, 24)],
        exif=private_pictures.telling_exif(),
    )
    return buffer.getvalue()


FILES: dict[str, tuple[str, Callable[[], bytes]]] = {
    "HEIC": ("a.heic", private_pictures.heic),
    "WebP": ("a.webp", private_pictures.webp),
    "TIFF": ("a.tiff", private_pictures.tiff),
    "PNG": ("a.png", private_pictures.png),
    "JPEG": ("a.jpg", private_pictures.jpeg),
    "several in one JPEG": ("a.jpg", several_pictures),
    "OpenEXR": ("a.exr", private_pictures.exr),
    "QuickTime": ("a.mov", private_pictures.film),
    "E57": ("a.e57", private_pictures.e57),
    "WebM": ("a.webm", private_pictures.webm),
}


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, bytes]]:
    """What a gateway that has just started says of each of `FILES`, and what it makes of the file."""
    uploads, answers = tmp_path_factory.mktemp("uploads"), tmp_path_factory.mktemp("answers")
    for name, (file, make) in FILES.items():
        (uploads / name).mkdir()
        (uploads / name / file).write_bytes(make())
    run_fresh(STRIP, uploads, answers, extras=["gateway"], cwd=answers)
    return {
        name: ((answers / name).read_text(), (uploads / name / file).read_bytes()) for name, (file, _) in FILES.items()
    }


@pytest.mark.parametrize("name", FILES)
def test_each_format_is_checked_and_stripped_by_a_process_that_knows_no_other(
    name: str, checked: dict[str, tuple[str, bytes]]
) -> None:
    said, content = checked[name]
    verdict, _, stripped = said.partition(" ")
    assert (verdict, bool(stripped)) == ("ok", True), said
    assert private_pictures.PLACE not in content


def encoded(picture: Image.Image, kind: str) -> bytes:
    """A file of a kind of `ENCODERS`, with the picture's EXIF."""
    pillow_heif.register_heif_opener()
    buffer = io.BytesIO()
    name, options = ENCODERS[kind]
    picture.save(buffer, name, exif=picture.getexif().tobytes(), **options)
    return buffer.getvalue()


def one_thing() -> Image.Image:
    """A red ball before a light wall: what a single photo must show."""
    picture = Image.new("RGB", (400, 300), (225, 225, 220))
    ImageDraw.Draw(picture).ellipse((120, 70, 280, 230), fill=(190, 40, 30))
    return picture


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, bytes]]:
    """Photos of a walk around a thing, in every kind of picture by turns."""
    kinds = list(ENCODERS)
    found = []
    photos = render_walkaround(tmp_path_factory.mktemp("walk"), views=VIEWS, size=(320, 240), arc=50).photos
    for number, photo in enumerate(photos):
        kind = kinds[number % len(kinds)]
        with Image.open(photo) as picture:
            found.append((f"IMG_{number:04}.{kind}", encoded(picture, kind)))
    return found


@pytest.fixture
def client(tmp_path: Path) -> Iterator[httpx.Client]:
    """A client of a product that has just been started, with nothing in its environment."""
    port = free_port()
    command = [sys.executable, "-m", "capture2vr.cli", "up", "--port", str(port), "--data", str(tmp_path / "data")]
    with subprocess.Popen(command, env=BARE_ENVIRONMENT, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as product:
        assert product.stderr is not None
        assert any("capture page" in line for line in product.stderr)
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0) as client:
                yield client
        finally:
            product.send_signal(signal.SIGINT)


def upload(client: httpx.Client, files: list[tuple[str, bytes]]) -> dict[str, Any]:
    """The receipt of a capture of these files, all of which must have been taken."""
    parts = [("files", (name, content, "application/octet-stream")) for name, content in files]
    answer = client.post("/v1/captures", files=parts)
    assert answer.status_code == 201, answer.text
    receipt: dict[str, Any] = answer.json()
    assert [(each["file"], each["verdict"]) for each in receipt["files"]] == [(name, "ok") for name, _ in files]
    return receipt


def test_every_kind_of_picture_is_taken_alone_and_as_a_set_that_becomes_an_asset(
    client: httpx.Client, walk: list[tuple[str, bytes]]
) -> None:
    for kind in ENCODERS:
        alone = upload(client, [(f"IMG_0000.{kind}", encoded(one_thing(), kind))])
        assert (alone["inspected"], alone["kind"], alone["frames"]) == (True, "image", 1)
    whole = upload(client, walk)
    assert (whole["kind"], whole["frames"]) == ("photos", VIEWS)

    asked = {"capture": whole["capture"], "asset_key": "shell", "preset": "draft"}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    deadline = time.monotonic() + 300
    while (found := client.get(f"/v1/jobs/{job}").json())["state"] not in {"SUCCEEDED", "FAILED"}:
        assert time.monotonic() < deadline, found
        time.sleep(0.5)
    assert found["state"] == "SUCCEEDED", found
    entry = client.get("/v1/assets/shell").raise_for_status().json()
    assert client.get(entry["lods"][0]["url"]).content[:4] == b"glTF"
