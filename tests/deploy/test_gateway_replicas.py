"""The edge cache in front of several gateways behind one name, which come and go: real nginx, a real name server."""

from __future__ import annotations

import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest

from capture2vr.cli.up import free_port
from tests.deploy.test_cdn import CONF, find_nginx, wait_for
from tests.support.network.name_server import name_server
from tests.support.patience import PATIENCE_S


@contextmanager
def replica(address: str, port: int) -> Iterator[None]:
    """A gateway that says only where it listens."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", str(len(address)))
            self.end_headers()
            self.wfile.write(address.encode())

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer((address, port), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def edge_cache(names: int, gateways: int) -> Iterator[str]:
    """nginx with the deployed configuration: the port of the name server, and of the gateways."""
    with tempfile.TemporaryDirectory() as name:
        folder, port, conf = Path(name), free_port(), CONF.read_text()
        folder.chmod(0o777)
        for deployed, here in [
            ("pid /tmp/nginx.pid", f"pid {folder}/nginx.pid"),
            ("/var/cache/nginx", str(folder)),
            ("/dev/stdout", f"{folder}/access.log"),
            ("/dev/stderr", f"{folder}/error.log"),
            ("resolver 127.0.0.11 ", f"resolver 127.0.0.1:{names} "),
            ("http://gateway:8080", f"http://gateway:{gateways}"),
            ("listen 8080", f"listen 127.0.0.1:{port}"),
        ]:
            assert deployed in conf
            conf = conf.replace(deployed, here)
        (folder / "nginx.conf").write_text(conf)
        child = subprocess.Popen([find_nginx(), "-c", folder / "nginx.conf", "-g", "daemon off;"])
        try:
            wait_for(f"http://127.0.0.1:{port}/healthz")
            yield f"http://127.0.0.1:{port}"
        finally:
            child.terminate()
            child.wait()


def answers(url: str, count: int = 40) -> Counter[str]:
    """Which gateways answer so many requests, none of which may fail."""
    got = [httpx.get(f"{url}/v1/jobs") for _ in range(count)]
    assert {answer.status_code for answer in got} == {200}
    return Counter(answer.text for answer in got)


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.2)


@pytest.mark.slow
def test_requests_go_to_all_gateways_and_to_those_that_are_left() -> None:
    port = free_port()
    with (
        name_server("127.0.0.2", "127.0.0.3") as names,
        edge_cache(names.port, port) as url,
        replica("127.0.0.2", port),
    ):
        with replica("127.0.0.3", port):
            assert set(answers(url)) == {"127.0.0.2", "127.0.0.3"}
        assert set(answers(url)) == {"127.0.0.2"}, "one that died is passed over, before its name is gone"
        names.addresses = ["127.0.0.2", "127.0.0.4"]
        with replica("127.0.0.4", port):
            until(lambda: set(answers(url)) == {"127.0.0.2", "127.0.0.4"})
