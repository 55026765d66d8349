"""32 phones send 20 MB of photos each, at once, to a real gateway; meanwhile somebody keeps asking for a job."""

from __future__ import annotations

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
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import psutil
from PIL import Image

from tests.support.private_pictures import telling_exif

PHONES, PHOTOS, PHOTO_BYTES = 32, 8, 2_500_000
_PROBE_S, _SAMPLE_S = 0.02, 0.05  # between two questions for the job, between two looks at the memory
_BOUNDARY = "------------------------bench"


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


@contextmanager
def gateway(folder: Path) -> Iterator[tuple[psutil.Process, int]]:
    """A gateway process without a worker on an empty folder; its port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = os.environ | {
        "GATEWAY_PORT": str(port),
        "GATEWAY_DATA_DIR": str(folder / "data"),
        "GATEWAY_WORKERS": "127.0.0.1:9",  # discard: nobody answers, so nothing but the gateway is measured
        "GATEWAY_LOG_LEVEL": "WARNING",
        "STORAGE_ROOT": str(folder / "objects"),
    }
    process = subprocess.Popen((sys.executable, "-m", "services.gateway"), env=environment)
    try:
        while True:
            try:
                if ask(port, "GET", "/livez")[0] == 200:
                    break
            except OSError:
                time.sleep(0.1)
        yield psutil.Process(process.pid), port
    finally:
        process.terminate()
        process.wait(30)


def ask(port: int, method: str, path: str, body: bytes = b"", kind: str = "application/json") -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)
    try:
        connection.request(method, path, body, {"Content-Type": kind})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def upload(port: int, body: bytes) -> tuple[int, float]:
    """The status, and the seconds until it came."""
    began = time.perf_counter()
    status, _ = ask(port, "POST", "/v1/captures", body, f"multipart/form-data; boundary={_BOUNDARY}")
    return status, time.perf_counter() - began


def queued_job(port: int, body: bytes) -> str:
    """A job that waits for a worker; its path."""
    capture = json.loads(ask(port, "POST", "/v1/captures", body, f"multipart/form-data; boundary={_BOUNDARY}")[1])
    request = json.dumps({"capture": capture["capture"], "asset_key": "bench"}).encode()
    return f"/v1/jobs/{json.loads(ask(port, 'POST', '/v1/jobs', request)[1])['id']}"


class Watch(threading.Thread):
    """Samples the gateway's memory and the latency of one request until it is stopped."""

    def __init__(self, process: psutil.Process, port: int, path: str) -> None:
        super().__init__(daemon=True)
        self.rss: list[int] = []
        self.seconds: list[float] = []
        self._process, self._port, self._path = process, port, path
        self._stopped = threading.Event()

    def run(self) -> None:
        sampler = threading.Thread(target=self._sample, daemon=True)
        sampler.start()
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=60)
        while not self._stopped.wait(_PROBE_S):
            began = time.perf_counter()
            connection.request("GET", self._path)
            connection.getresponse().read()
            self.seconds.append(time.perf_counter() - began)
        sampler.join()

    def stop(self) -> None:
        self._stopped.set()
        self.join()

    def _sample(self) -> None:
        while not self._stopped.wait(_SAMPLE_S):
            self.rss.append(self._process.memory_info().rss)

    def latency(self) -> str:
        ranked = sorted(self.seconds)
        p99 = ranked[min(len(ranked) - 1, int(len(ranked) * 0.99))]
        return f"p50 {statistics.median(ranked) * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, of {len(ranked)}"


def main(arguments: list[str]) -> None:
    """Print the table."""
    body = form(photo())
    with tempfile.TemporaryDirectory(prefix="bench-uploads-") as folder, gateway(Path(folder)) as (process, port):
        job = queued_job(port, body)
        idle = Watch(process, port, job)
        idle.start()
        time.sleep(3)
        idle.stop()
        loaded = Watch(process, port, job)
        loaded.start()
        began = time.perf_counter()
        with ThreadPoolExecutor(PHONES) as pool:
            answers = list(pool.map(lambda _: upload(port, body), range(PHONES)))
        wall = time.perf_counter() - began
        loaded.stop()
    created = sum(status == 201 for status, _ in answers)
    print(f"{'uploads':<22} {PHONES} × {len(body) / 1e6:.1f} MB ({PHOTOS} photos of 12 megapixels)")
    print(f"{'answered 201':<22} {created} of {PHONES}")
    print(f"{'all done after':<22} {wall:.1f} s, {PHONES * len(body) / wall / 1e6:.0f} MB/s")
    print(f"{'one upload took':<22} {statistics.median(s for _, s in answers):.1f} s median")
    print(f"{'memory at rest':<22} {max(idle.rss) / 1e6:.0f} MB")
    print(f"{'memory at most':<22} {max(loaded.rss) / 1e6:.0f} MB")
    print(f"{'GET job, at rest':<22} {idle.latency()}")
    print(f"{'GET job, meanwhile':<22} {loaded.latency()}")
