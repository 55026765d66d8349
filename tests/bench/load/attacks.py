"""The attacks of attack.py: what each does, and what should become of it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import httpx

from tests.bench.load import attack_files as files
from tests.bench.load.attack import HANG_S, Product, processor_seconds, said, send
from tests.support import costly

Verdict = tuple[str, str]
"""What the product answered, and what of it is not as it should be, or ""."""

_ENDS_S = 300.0  # of a job that an attack starts
_REVOKED_S = 60.0  # within which what hangs on a key ends


@dataclass(frozen=True, slots=True)
class Attack:
    """An attack. cheap: whether it costs so little that it is among the tests

    alone      whether ada sends nothing meanwhile
    most_s     processor seconds that it may cost, and most_waited_s: that ada may wait meanwhile
    variables  of the product's environment
    """

    name: str
    run: Callable[[Product], Verdict]
    cheap: bool = False
    alone: bool = False
    most_s: float = 60.0
    most_waited_s: float = 10.0
    variables: Mapping[str, str] = field(default_factory=dict)


# ---- files that cost ------------------------------------------------------------------------------------------------


def _many(product: Product, uploads: Iterable[tuple[str, bytes]]) -> Verdict:
    """Send all at once, and make an asset of what is accepted."""
    with ThreadPoolExecutor(32) as threads:
        sent = list(threads.map(lambda each: send(product.mallory, *each), uploads))
    answers = Counter(map(said, sent))
    for answer in sent:
        if answer.status_code == 201:
            answers[f"job {_job_of(product, answer.json()['capture'])}"] += 1
    told = ", ".join(f"{count} × {what}" for what, count in answers.items())
    return told, "taken uninspected" if any("not inspected" in what for what in answers) else ""


def _job_of(product: Product, capture: str) -> str:
    """How a draft of a capture ends."""
    order = {"capture": capture, "asset_key": capture.replace("_", "-").lower(), "preset": "draft"}
    created = product.mallory.post("/v1/jobs", json=order)
    if not created.is_success:
        return said(created)
    deadline = time.monotonic() + _ENDS_S
    while time.monotonic() < deadline:
        job = product.mallory.get(f"/v1/jobs/{created.json()['id']}").json()
        if job["state"] in ("SUCCEEDED", "FAILED", "CANCELLED"):
            return str((job["error"] or {}).get("code") or job["state"])
        time.sleep(0.2)
    return "does not end"


def _of(name: str, content: Callable[[], bytes], times: int = 1, refused: str = "") -> Callable[[Product], Verdict]:
    """Send a file so many times at once. refused: the code with which each of them should be"""

    def run(product: Product) -> Verdict:
        told, fault = _many(product, [(name, content())] * times)
        return told, fault or ("" if not refused or told == f"{times} × {refused}" else f"not {refused}")

    return run


def _of_zip(content: Callable[[], Mapping[str, bytes]], times: int = 1) -> Callable[[Product], Verdict]:
    return _of("a.zip", lambda: files.zipped(dict(content())), times)


def _album() -> bytes:
    return files.zipped({f"{number}.png": files.plain_png() for number in range(60)}, zipfile.ZIP_STORED)


def _textures() -> costly.Files:
    return costly.textures(200, files.plain_png(channels=1), one_view=True)


def _tiffs() -> dict[str, bytes]:
    return {f"{number}.tif": files.tiff_of_shared_strips() for number in range(8)}


# ---- jobs -----------------------------------------------------------------------------------------------------------


def _paper(product: Product) -> Verdict:
    """A job of days."""
    capture = send(product.mallory, "a.ply", files.cloud(1_500)).json()["capture"]
    order = {"capture": capture, "asset_key": "paper", "preset": "paper"}
    answer = product.mallory.post("/v1/jobs", json=order)
    if answer.is_success:
        product.mallory.post(f"/v1/jobs/{answer.json()['id']}/cancel")
    return said(answer), "" if answer.status_code == 403 else "any key starts it"


def _cancelled(product: Product) -> Verdict:
    """A training that is cancelled: what computes two seconds later."""
    capture = send(product.mallory, "a.ply", files.cloud(20_000)).json()["capture"]
    order = {"capture": capture, "asset_key": "cancelled", "preset": "standard"}
    job = product.mallory.post("/v1/jobs", json=order).json()["id"]
    deadline = time.monotonic() + _ENDS_S
    while product.mallory.get(f"/v1/jobs/{job}").json()["stage"] != "FITTING" and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(5.0)  # the first of that stage is for the preview
    product.mallory.post(f"/v1/jobs/{job}/cancel")
    time.sleep(2.0)
    before = processor_seconds([product.worker])
    time.sleep(3.0)
    spent = processor_seconds([product.worker]) - before
    return f"{spent:.2f} CPU s in the 3 s from 2 s on", "" if spent < 0.3 else "it computes on"


# ---- access ---------------------------------------------------------------------------------------------------------


def _revoked(product: Product) -> Verdict:
    """A key that is revoked: what hangs on it."""
    mallory = product.mallory
    claimed, begun = [mallory.post("/v1/pairings", json={"scopes": ["read"]}).json()["code"] for _ in range(2)]
    device = httpx.Client(base_url=product.url, timeout=HANG_S)
    device.post("/v1/pairings/claim", json={"code": claimed})
    capture = send(mallory, "a.ply", files.cloud(20_000)).json()["capture"]
    order = {"capture": capture, "asset_key": "long", "preset": "standard"}
    job = mallory.post("/v1/jobs", json=order).json()["id"]
    ended = threading.Event()

    def follow() -> None:
        with suppress(httpx.HTTPError), mallory.stream("GET", f"/v1/jobs/{job}/events") as answer:
            for _ in answer.iter_lines():
                pass
        ended.set()

    threading.Thread(target=follow, daemon=True).start()
    key = mallory.get("/v1/session").json()["key"]
    product.operator.post(f"/v1/api-keys/{key}/revoke")
    began = time.monotonic()
    late = httpx.post(f"{product.url}/v1/pairings/claim", json={"code": begun})
    while device.get("/v1/jobs").is_success and time.monotonic() - began < 2 * _REVOKED_S:
        time.sleep(0.2)
    device_s = time.monotonic() - began
    ended.wait(2 * _REVOKED_S)
    stream_s = time.monotonic() - began
    told = f"claim {said(late)}, device ended after {device_s:.0f} s, stream after {stream_s:.0f} s"
    return told, "" if late.status_code == 404 and max(device_s, stream_s) < _REVOKED_S else "access goes on"


def _logged_out(product: Product) -> Verdict:
    with httpx.Client(base_url=product.url, timeout=HANG_S) as browser:
        browser.post("/v1/session", json={"key": product.secrets["mallory"]})
        copied = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
        browser.delete("/v1/session")
    answer = httpx.get(f"{product.url}/v1/jobs", headers={"Cookie": copied})
    return said(answer), "" if answer.status_code == 401 else "the cookie goes on"


def _revoking(product: Product) -> Verdict:
    secret = product.key("mallory", "operate", "manage")
    higher = httpx.get(f"{product.url}/v1/session", headers={"Authorization": f"Bearer {secret}"}).json()["key"]
    answer = product.mallory.post(f"/v1/api-keys/{higher}/revoke")
    return said(answer), "" if answer.status_code == 403 else "a lower key revokes it"


def _guesses(product: Product) -> Verdict:
    """Wrong codes from sixty addresses, and then the right one from another."""
    code = product.ada.post("/v1/pairings", json={"scopes": ["read"]}).json()["code"]
    answers = Counter[str]()
    for number in range(60):
        transport = httpx.HTTPTransport(local_address=f"127.0.1.{number + 1}")
        with httpx.Client(base_url=product.url, transport=transport, timeout=HANG_S) as client:
            answers[said(client.post("/v1/pairings/claim", json={"code": f"{number:0{len(code)}}"}))] += 1
    right = httpx.post(f"{product.url}/v1/pairings/claim", json={"code": code})
    told = ", ".join(f"{count} × {what}" for what, count in answers.items())
    return f"{told}; then the right one: {said(right)}", "" if right.is_success else "nobody can pair"


# ---- this machine ---------------------------------------------------------------------------------------------------


def _readable(product: Product) -> Verdict:
    """What another user of this machine may read of the data folder."""
    closed = product.data.stat().st_mode & 0o077 == 0
    found = [] if closed else [path for path in product.data.rglob("*") if path.stat().st_mode & 0o004]
    return f"{len(found)} files and folders", "others read them" if found else ""


def _worker_port(product: Product) -> Verdict:
    """A port of the worker, at which every user of this machine may start jobs for any tenant."""
    if os.geteuid() != 0:
        return "not tried: needs root, to look into the worker", ""
    ports = [each for each in product.worker.net_connections("tcp") if each.status == "LISTEN"]
    return f"{len(ports)} ports", "any local user starts jobs" if ports else ""


def _open_worker(product: Product) -> Verdict:
    scratch = product.data.parent / "open"
    variables = {"EDGE_HOST": "127.0.0.2", "EDGE_PORT": "0", "EDGE_SCRATCH": str(scratch)}
    environment = {**product.environment, **variables, "STORAGE_ROOT": str(scratch / "objects")}
    worker = subprocess.Popen(
        product.command("edge"), env=environment, cwd=product.data.parent, stderr=subprocess.DEVNULL
    )
    try:
        status = worker.wait(20)
    except subprocess.TimeoutExpired:
        return "it serves", "without a token, to whoever reaches it"
    finally:
        worker.kill()
    return f"exit {status}", ""


def _strangers_folder(product: Product) -> Verdict:
    """A capture in a folder that has a package of the product's name."""
    folder = product.data.parent / "stranger"
    mark = folder / "ran"
    for package in ("services", "capture2vr"):
        (folder / package).mkdir(parents=True)
        (folder / package / "__init__.py").write_text(f"open({str(mark)!r}, 'w')\n")
    (folder / "scan.ply").write_bytes(files.cloud())
    (folder / "scan.laz").write_bytes(files.laz())
    environment = {name: value for name, value in product.environment.items() if name != "PYTHONSAFEPATH"}
    for capture in ("scan.ply", "scan.laz"):
        command = product.command("run", capture, "-o", f"out-{capture}", "--preset", "draft")
        subprocess.run(command, env=environment, cwd=folder, capture_output=True, timeout=HANG_S)
    return "the stranger's code ran" if mark.exists() else "none of it ran", "it ran" if mark.exists() else ""


@contextmanager
def _small_disk(folder: Path) -> Iterator[Path]:
    """A disk of 600 MB at a folder."""
    folder.mkdir()
    subprocess.run(("mount", "-t", "tmpfs", "-o", "size=600m", "tmpfs", str(folder)), check=True)
    try:
        yield folder
    finally:
        subprocess.run(("umount", "-l", str(folder)), check=True)


def _fill(disk: Path) -> None:
    with suppress(OSError), (disk / "full").open("wb", buffering=0) as file:
        while file.write(b"x" * 4096):
            pass


def _full(product: Product) -> Verdict:
    """A disk that is full when the product starts."""
    if os.geteuid() != 0:
        return "not tried: needs root, to mount a small disk", ""
    with _small_disk(product.data.parent / "small") as disk:
        environment = {**product.environment}
        with closing(Product(product.checkout, disk / "data", environment)) as first:
            capture = send(first.ada, "a.ply", files.cloud()).json()["capture"]
            secrets = first.secrets
        _fill(disk)
        try:
            again = Product(product.checkout, disk / "data", environment, secrets)
        except RuntimeError:
            return "it does not start", "nothing can be read or deleted"
        with closing(again):
            listed = again.ada.get("/v1/captures")
            refused = send(again.ada, "a.ply", files.cloud())
            deleted = again.ada.delete(f"/v1/captures/{capture}")
    answers = tuple(map(said, (listed, refused, deleted)))
    wanted = (listed.status_code, refused.status_code, deleted.status_code) == (200, 507, 200)
    return "list {}, upload {}, delete {}".format(*answers), "" if wanted else "it does not go on"


# ---- requests -------------------------------------------------------------------------------------------------------


def _trickle(product: Product) -> Verdict:
    """A body without a length, of which a byte comes every ten seconds."""
    began = time.monotonic()
    with socket.create_connection(("127.0.0.1", product.port)) as line:
        head = "POST /v1/captures HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n"
        head += f"Authorization: Bearer {product.secrets['mallory']}\r\nContent-Type: application/zip\r\n\r\n"
        line.sendall(head.encode())
        line.settimeout(10.0)
        while time.monotonic() - began < 300.0:
            with suppress(TimeoutError):
                answer = line.recv(1 << 16).decode(errors="replace")
                return f"{answer.split()[1] if answer else 'closed'} after {time.monotonic() - began:.0f} s", ""
            line.sendall(b"1\r\nx\r\n")
    return "goes on after 300 s", "it never ends"


def _tus(product: Product) -> Verdict:
    """An upload of 300 parts of a byte."""
    tus = {"Tus-Resumable": "1.0.0"}
    made = product.mallory.post("/v1/uploads", headers={**tus, "Upload-Length": "1000"})
    where = made.headers["location"]
    for offset in range(300):
        part = {**tus, "Upload-Offset": str(offset), "Content-Type": "application/offset+octet-stream"}
        product.mallory.patch(where, headers=part, content=b"x")
    left = [path for path in product.data.rglob("*") if path.is_file() and "uploads" in path.parts]
    return f"{len(left)} files", "" if len(left) <= 60 else "each part is a file or two"


def _half_requests(product: Product) -> Verdict:
    """Four hundred requests of which half a head comes."""
    lines = [socket.create_connection(("127.0.0.1", product.port)) for _ in range(400)]
    for line in lines:
        line.sendall(b"GET / HTTP/1.1\r\nHost: 127")
        line.settimeout(60.0)
    began = time.monotonic()
    with suppress(OSError):
        for line in lines:
            while line.recv(1 << 16):
                pass
    lasted = time.monotonic() - began
    for line in lines:
        line.close()
    return f"closed after {lasted:.0f} s", "" if lasted < 45.0 else "they stay"


def _large_header(product: Product) -> Verdict:
    """A header of 20 MB."""
    with socket.create_connection(("127.0.0.1", product.port)) as line, suppress(OSError):
        line.settimeout(30.0)
        line.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ")
        with suppress(OSError):
            for _ in range(200):
                line.sendall(b"x" * 100_000)
        status = line.recv(1 << 16).decode(errors="replace").split()[1]
        return status, "" if status == "431" else "it is read"
    return "closed", ""


def _small_rows(product: Product) -> Verdict:
    """Lists that a proxy may keep, a host name of other letters, a limit that is none, a catalogue that is none."""
    listed = product.mallory.get("/v1/captures").headers.get("cache-control", "")
    host = product.mallory.get("/v1/captures", headers={"Host": "evil。example".encode()})
    limit = product.operator.put("/v1/tenants/ada/limits", json={"jobs_at_once": True})
    pulled = _pull_of_nothing(product)
    told = f"Cache-Control: {listed or 'none'}; {said(host)}; {said(limit)}; pull: {pulled}"
    wanted = "no-store" in listed and host.status_code in (400, 421) and limit.status_code == 422
    return told, "" if wanted and pulled != "a traceback" else "not all are refused"


def _pull_of_nothing(product: Product) -> str:
    """What `pull` says to a server that answers {} to everything."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError):
                while True:
                    line, _ = server.accept()
                    with line:
                        line.recv(1 << 16)
                        head = "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 2\r\n"
                        line.sendall(f"{head}Connection: close\r\n\r\n{json.dumps({})}".encode())

        threading.Thread(target=answer, daemon=True).start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
        command = product.command("pull", "dress", "--gateway", url, "-o", str(product.data.parent / "pulled"))
        done = subprocess.run(command, env=product.environment, capture_output=True, text=True, timeout=60)
    return "a traceback" if "Traceback" in done.stderr + done.stdout else f"exit {done.returncode}"


_LARGE = "CAPTURE_TOO_LARGE"

ATTACKS = (
    Attack("seven zips at once of an OBJ that repeats its library", _of_zip(files.obj_of_libraries, 7), most_s=140.0),
    Attack("an OBJ of 594 KB that repeats its library", _of_zip(files.obj_of_libraries), cheap=True, most_s=20.0),
    Attack("an OBJ with a library of 300,000 materials", _of_zip(files.obj_of_a_large_library), most_s=20.0),
    Attack("an OBJ of 60,000 materials", _of("a.obj", partial(files.obj_of_materials, 60_000), 2, _LARGE), cheap=True),
    Attack(
        "a face of five million corners", _of("a.ply", partial(files.ply_of_one_face, 5_100_000), 2, _LARGE), cheap=True
    ),
    Attack("a line of four million numbers", _of("a.xyz", files.long_line, 2, "CAPTURE_UNREADABLE"), cheap=True),
    Attack("a GLB of 200 textures of 64 megapixels", _of_zip(_textures), most_s=30.0),
    Attack("a GLB of 100,000 primitives", _of_zip(partial(costly.primitives, 100_000)), most_s=30.0),
    Attack("eight TIFFs of 100 megapixels that share their strips", _of_zip(_tiffs)),
    Attack("ten uploads of 60 pictures of 64 megapixels", _of("a.zip", _album, 10), most_s=2_000.0, most_waited_s=3.0),
    Attack(
        "a JPEG of 700 scans", _of("a.jpg", partial(files.jpeg_of_scans, 500, 700), 2, "IMAGE_UNREADABLE"), cheap=True
    ),
    Attack(
        "a large JPEG of 80 scans",
        _of("a.jpg", partial(files.jpeg_of_scans, 4_500, 80), 2, "IMAGE_TOO_LARGE"),
        cheap=True,
    ),
    Attack("a PNG of 800 MB", _of("a.png", files.deep_png, 2, "IMAGE_TOO_LARGE"), cheap=True),
    Attack("the preset paper, by any key", _paper, cheap=True),
    Attack("a cancelled training", _cancelled, alone=True),
    Attack("what hangs on a key that is revoked", _revoked),
    Attack("a copied cookie after logging out", _logged_out, cheap=True),
    Attack("a manage key that revokes an operator's", _revoking, cheap=True),
    Attack("wrong pairing codes from 60 addresses", _guesses, cheap=True),
    Attack("another user who reads the data folder", _readable, cheap=True),
    Attack("another user who starts jobs at the worker of `up`", _worker_port, cheap=True),
    Attack("a worker that others reach, without a token", _open_worker, cheap=True),
    Attack("a package of the product's name beside a capture", _strangers_folder),
    Attack("a full disk at the start", _full),
    Attack("a body of a byte in ten seconds", _trickle),
    Attack("an upload of 300 parts of a byte", _tus, cheap=True),
    Attack("400 requests of half a head", _half_requests),
    Attack("a header of 20 MB", _large_header, cheap=True),
    Attack("answers that a proxy keeps, odd hosts, limits and catalogues", _small_rows, cheap=True),
)
