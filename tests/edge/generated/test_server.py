"""The contract with a generator: what it is sent, and what becomes of slow, wrong, huge and broken answers."""

from __future__ import annotations

import resource
import socket
import threading
import time
from contextlib import suppress
from dataclasses import replace
from http.server import BaseHTTPRequestHandler
from pathlib import Path

import pytest

from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.generated.server import GeneratorServer
from tests.support.photos.generators import Tell, boxes_glb, generator, glb, write

PNG = b"\x89PNG\r\n\x1a\n\r\n--not a boundary"
GLB = boxes_glb()
HEAD = b"glTF\x02\0\0\0" + (2**31 - 1).to_bytes(4, "little")
AT_LEAST = 1 << 20


def ask(url: str, folder: Path, **limits: float) -> bytes:
    target = folder / "out.glb"
    replace(GeneratorServer(url), **limits).generate(PNG, target)  # type: ignore[arg-type]
    return target.read_bytes()


def test_a_picture_goes_as_the_part_image_of_a_form_and_a_glb_comes_back(tmp_path: Path) -> None:
    with generator(glb(GLB)) as stub:
        assert ask(stub.url, tmp_path) == GLB
    assert stub.asked == ["/health", "/generate"]
    assert stub.fields == {"image": PNG}


def test_an_answer_in_chunks_is_taken_too(tmp_path: Path) -> None:
    def chunked(to: BaseHTTPRequestHandler) -> None:
        to.protocol_version = "HTTP/1.1"
        to.send_response(200)
        to.send_header("Transfer-Encoding", "chunked")
        to.end_headers()
        for part in (GLB[:7], GLB[7:]):
            to.wfile.write(f"{len(part):x}\r\n".encode() + part + b"\r\n")
        to.wfile.write(b"0\r\n\r\n")

    with generator(chunked) as stub:
        assert ask(stub.url, tmp_path) == GLB


def slow(to: BaseHTTPRequestHandler) -> None:
    time.sleep(0.6)


def drips(to: BaseHTTPRequestHandler) -> None:
    """A byte of the head at a time, so that no single wait is long."""
    for byte in b"HTTP/1.0 200 OK\r\nContent-":
        to.wfile.write(bytes([byte]))
        to.wfile.flush()
        time.sleep(0.05)


def huge(to: BaseHTTPRequestHandler) -> None:
    write(to, HEAD, size=2 * 10**9)


def endless(to: BaseHTTPRequestHandler) -> None:
    """Two gigabytes without a length before them."""
    to.send_response(200)
    to.end_headers()
    to.wfile.write(HEAD)
    for _ in range(2 * 10**9 >> 16):
        to.wfile.write(bytes(1 << 16))


def moved(to: BaseHTTPRequestHandler) -> None:
    to.send_response(302)
    to.send_header("Location", "http://127.0.0.1:1/generate")
    to.send_header("Content-Length", "0")
    to.end_headers()


FAULTS: dict[str, tuple[Tell, str]] = {
    "slow": (slow, "has not answered within 0 s"),
    "drips": (drips, "has not answered within 0 s"),
    "a page": (lambda to: write(to, b"<!DOCTYPE html><html>", kind="text/html"), "no GLB file"),
    "nothing": (lambda to: write(to, b""), "no GLB file"),
    "huge": (huge, "larger than the 1 MiB"),
    "endless": (endless, "larger than the 1 MiB"),
    "cut off": (lambda to: write(to, GLB[:200], size=len(GLB)), f"cut off: 200 of {len(GLB):,} bytes came"),
    "its own error": (
        lambda to: write(to, b'{"error":"out of\n\x1b[31m memory"}', status=500),
        r'status 500: {"error":"out of \[31m memory"}',
    ),
    "a redirect": (moved, "status 302"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_answer_is_one_sentence_with_what_to_do(fault: str, tmp_path: Path) -> None:
    tell, sentence = FAULTS[fault]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with generator(tell) as stub, pytest.raises(EdgeError, match=sentence) as caught:
        ask(stub.url, tmp_path, most_s=0.3, most_bytes=AT_LEAST)
    assert caught.value.code == "GENERATOR_FAILED"
    assert "the capture is kept" in caught.value.hints[0]
    assert "\n" not in caught.value.message
    assert caught.value.retryable == (fault in ("slow", "drips"))
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= AT_LEAST
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kilobytes


def test_a_generator_that_is_not_ready_is_not_sent_the_picture(tmp_path: Path) -> None:
    with generator(glb(GLB), health=503) as stub, pytest.raises(EdgeError, match=r"not ready.* 503") as caught:
        ask(stub.url, tmp_path)
    assert (caught.value.code, caught.value.retryable, stub.asked) == ("GENERATOR_UNAVAILABLE", True, ["/health"])


def test_nobody_there_and_who_speaks_no_http_cannot_be_reached(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"http://127.0.0.1:{server.getsockname()[1]}"

        def babble() -> None:
            with suppress(OSError), server.accept()[0] as caller:
                caller.recv(1000)
                caller.sendall(b"SSH-2.0-OpenSSH\r\n")

        thread = threading.Thread(target=babble)
        thread.start()
        with pytest.raises(EdgeError, match="cannot be reached") as caught:
            ask(url, tmp_path)
        thread.join()
    assert caught.value.code == "GENERATOR_UNAVAILABLE"
    with pytest.raises(EdgeError, match=r"cannot be reached.*refused") as caught:
        ask(url, tmp_path)
    assert (caught.value.code, caught.value.retryable) == ("GENERATOR_UNAVAILABLE", True)
    assert "EDGE_GENERATOR" in caught.value.hints[0]


def test_proxies_of_the_environment_are_not_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:1")
    with generator(glb(GLB)) as stub:
        assert ask(stub.url, tmp_path) == GLB


def test_a_cancelled_job_does_not_wait_for_the_answer(tmp_path: Path) -> None:
    def cancel(fraction: float) -> None:
        if fraction > 0:
            raise Cancelled

    with generator(slow) as stub:
        began = time.monotonic()
        with pytest.raises(Cancelled):
            GeneratorServer(stub.url).generate(PNG, tmp_path / "out.glb", cancel)
        assert time.monotonic() - began < 0.5


@pytest.mark.parametrize(
    "url",
    [
        "ftp://host",
        "host:8080",
        "http://",
        "http://host/path",
        "http://a@host",
        "http://host:99999",
        "http://h?x=1",
        "x",
    ],
)
def test_an_address_is_a_server_alone(url: str) -> None:
    with pytest.raises(ValueError, match=r"must be http|[Pp]ort"):
        GeneratorServer.at(url)


def test_an_address_may_be_a_name_a_number_or_none() -> None:
    assert GeneratorServer.at("") is None
    for url in ("http://host:8080/", "https://generator.example", "http://[::1]:8080"):
        assert GeneratorServer.at(url) == GeneratorServer(url.rstrip("/"))
