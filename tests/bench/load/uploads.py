"""32 phones send 20 MB of photos each, at once, to a real gateway; meanwhile somebody keeps asking for a job.

Plainly to a gateway without keys, and with keys by uploads that can go on (tus), by turns. `--parts film` sends a film
of a gigabyte that is cut twenty times.
"""

from __future__ import annotations

import argparse
import http.client
import io
import json
import os
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
from PIL import Image

from tests.bench.interrupted_film import film_with_cuts
from tests.support.photos.private_pictures import telling_exif
from tests.support.tenants import bearer, make_key
from tests.support.tus import PART, TUS, metadata
from tests.support.workers.inspecting_worker import inspecting_worker

PHONES, PHOTOS, PHOTO_BYTES = 32, 8, 2_500_000
_PROBE_S, _SAMPLE_S = 0.02, 0.05  # between two questions for the job, between two looks at the memory
_BOUNDARY = "------------------------bench"
_FORM = f"multipart/form-data; boundary={_BOUNDARY}"
_PIECE_BYTES = 16 << 20  # of one request, as the capture page has it


def photo() -> bytes:
    """A JPEG of 12 megapixels and about PHOTO_BYTES, with a place and serial numbers in it."""
    noise = Image.frombytes("RGB", (500, 375), random.Random(0).randbytes(500 * 375 * 3))
    image = noise.resize((4000, 3000), Image.Resampling.BICUBIC)
    for quality in range(95, 20, -5):
        buffer = io.BytesIO()
        image.save(buffer, "JPEG", quality=quality, exif=telling_exif())
        if buffer.tell() <= PHOTO_BYTES:
            break
    return buffer.getvalue()


def form(photo_bytes: bytes) -> bytes:
    """The body of one phone's upload."""
    parts = []
    for number in range(PHOTOS):
        disposition = f'form-data; name="files"; filename="IMG_{number}.jpg"'
        head = f"--{_BOUNDARY}\r\nContent-Disposition: {disposition}\r\nContent-Type: image/jpeg\r\n\r\n"
        parts.append(head.encode() + photo_bytes + b"\r\n")
    return b"".join(parts) + f"--{_BOUNDARY}--\r\n".encode()


@dataclass(frozen=True, slots=True)
class Door:
    """A gateway process: its port, and the headers that it wants."""

    process: psutil.Process
    port: int
    headers: dict[str, str]

    def ask(
        self, method: str, path: str, body: bytes | memoryview = b"", **headers: str
    ) -> tuple[http.client.HTTPResponse, bytes]:
        """The answer and its body. Headers' names are written with _ for -."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=600)
        told = {name.replace("_", "-"): value for name, value in headers.items()}
        try:
            connection.request(method, path, body, {**self.headers, **told})
            answer = connection.getresponse()
            return answer, answer.read()
        finally:
            connection.close()


@contextmanager
def gateway(folder: Path, *, keys: bool) -> Iterator[Door]:
    """A gateway process on an empty folder."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = os.environ | {
        "GATEWAY_PORT": str(port),
        "GATEWAY_DATA_DIR": str(folder / "data"),
        "GATEWAY_WORKERS": inspecting_worker(),  # which reads nothing, so nothing but the gateway is measured
        "GATEWAY_LOG_LEVEL": "WARNING",
        "STORAGE_ROOT": str(folder / "objects"),
    }
    headers = bearer(make_key(folder / "data", "ada")) if keys else {}
    process = subprocess.Popen((sys.executable, "-m", "capture2vr.gateway"), env=environment)
    door = Door(psutil.Process(process.pid), port, headers)
    try:
        while True:
            try:
                if door.ask("GET", "/v1/keys")[0].status == 200:
                    break
            except OSError:
                time.sleep(0.1)
        yield door
    finally:
        process.terminate()
        process.wait(30)


def send_plainly(door: Door, body: bytes) -> tuple[int, bytes]:
    """Upload a form in one request; status and receipt."""
    answer, receipt = door.ask("POST", "/v1/captures", body, Content_Type=_FORM)
    return answer.status, receipt


def send_resumably(door: Door, body: bytes) -> tuple[int, bytes]:
    """Upload the same form as an upload that can go on, as the capture page does; status and receipt."""
    told = metadata({"filetype": _FORM, "name": "bench"})
    headers = {"Tus_Resumable": TUS["Tus-Resumable"], "Upload_Length": str(len(body)), "Upload_Metadata": told}
    upload = door.ask("POST", "/v1/uploads", **headers)[0].headers["Location"]
    for offset in range(0, len(body), _PIECE_BYTES):
        piece = memoryview(body)[offset : offset + _PIECE_BYTES]  # a copy would hold up the one who asks for the job
        headers = {"Tus_Resumable": TUS["Tus-Resumable"], "Content_Type": PART, "Upload_Offset": str(offset)}
        answer, said = door.ask("PATCH", upload, piece, **headers)
        if answer.status != 204:
            return answer.status, said
    answer, receipt = door.ask("POST", f"{upload}/capture")
    return answer.status, receipt


WAYS: dict[str, tuple[bool, Callable[[Door, bytes], tuple[int, bytes]]]] = {
    "plain, no keys": (False, send_plainly),
    "tus, keys": (True, send_resumably),
}
"""Whether the gateway asks for keys, and how a phone sends."""


class Watch(threading.Thread):
    """Samples the gateway's memory and the latency of one request until it is stopped."""

    def __init__(self, door: Door, path: str) -> None:
        super().__init__(daemon=True)
        self.rss: list[int] = []
        self.seconds: list[float] = []
        self._door, self._path = door, path
        self._stopped = threading.Event()

    def run(self) -> None:
        sampler = threading.Thread(target=self._sample, daemon=True)
        sampler.start()
        connection = http.client.HTTPConnection("127.0.0.1", self._door.port, timeout=60)
        while not self._stopped.wait(_PROBE_S):
            began = time.perf_counter()
            connection.request("GET", self._path, headers=self._door.headers)
            connection.getresponse().read()
            self.seconds.append(time.perf_counter() - began)
        sampler.join()

    def stop(self) -> None:
        self._stopped.set()
        self.join()

    def _sample(self) -> None:
        while not self._stopped.wait(_SAMPLE_S):
            self.rss.append(self._door.process.memory_info().rss)


@dataclass(frozen=True, slots=True)
class Round:
    """One round of all phones. job_s: seconds of each question for a job meanwhile"""

    wall_s: float
    created: int
    upload_s: list[float]
    job_s: list[float]
    rss: int


def one_round(way: str, body: bytes, folder: Path) -> Round:
    """Let all phones send at once, to a gateway of their own."""
    keys, send = WAYS[way]
    with gateway(folder, keys=keys) as door:
        capture = json.loads(send_plainly(door, body)[1])["capture"]
        order = json.dumps({"capture": capture, "asset_key": "bench"}).encode()
        job = json.loads(door.ask("POST", "/v1/jobs", order, Content_Type="application/json")[1])["id"]
        watch = Watch(door, f"/v1/jobs/{job}")
        watch.start()

        def one_phone(_: int) -> tuple[int, float]:
            began = time.perf_counter()
            status, _answer = send(door, body)
            return status, time.perf_counter() - began

        began = time.perf_counter()
        with ThreadPoolExecutor(PHONES) as pool:
            answers = list(pool.map(one_phone, range(PHONES)))
        wall = time.perf_counter() - began
        watch.stop()
    created = sum(status == 201 for status, _ in answers)
    return Round(wall, created, [seconds for _, seconds in answers], watch.seconds, max(watch.rss))


def phones(rounds: int) -> Iterator[tuple[str, str]]:
    """All phones by each way, by turns."""
    body = form(photo())
    yield "uploads", f"{PHONES} × {len(body) / 1e6:.1f} MB ({PHOTOS} photos of 12 megapixels), {rounds} rounds by turns"
    found: dict[str, list[Round]] = {way: [] for way in WAYS}
    for _ in range(rounds):
        for way, each in found.items():
            with tempfile.TemporaryDirectory(prefix="bench-uploads-") as folder:
                each.append(one_round(way, body, Path(folder)))
    for way, each in found.items():
        wall = statistics.median(one.wall_s for one in each)
        created = sum(one.created for one in each)
        yield f"{way}: answered 201", f"{created} of {PHONES * rounds}"
        yield f"{way}: all done after", f"{wall:.1f} s median, {PHONES * len(body) / wall / 1e6:.0f} MB/s"
        yield f"{way}: one upload took", f"{statistics.median(s for one in each for s in one.upload_s):.1f} s median"
        yield f"{way}: memory at most", f"{max(one.rss for one in each) / 1e6:.0f} MB"
        yield f"{way}: GET job meanwhile", _latency([s for one in each for s in one.job_s])
    plain, tus = (statistics.median(one.wall_s for one in each) for each in found.values())
    yield "tus with keys against plain without", f"× {tus / plain:.2f} (1.30 wanted)"


def _latency(seconds: list[float]) -> str:
    ranked = sorted(seconds)
    p99 = ranked[min(len(ranked) - 1, int(len(ranked) * 0.99))]
    return f"p50 {statistics.median(ranked) * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, of {len(ranked)} (p99 of 50 wanted)"


def main(arguments: list[str]) -> None:
    """Print the chosen parts."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench uploads", description=__doc__)
    parser.add_argument("--parts", nargs="*", default=["phones", "film"], choices=["phones", "film"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--megabytes", type=int, default=1024, help="of the film")
    parser.add_argument("--cuts", type=int, default=20, help="of the film's upload")
    options = parser.parse_args(arguments)
    for part in options.parts:
        rows = phones(options.rounds) if part == "phones" else film_with_cuts(options.megabytes, options.cuts)
        for what, figure in rows:
            print(f"{what:<36} {figure}", flush=True)
