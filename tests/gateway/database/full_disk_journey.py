"""What a service does on a full disk: `python -m tests.gateway.database.full_disk_journey FOLDER`, a small disk's.

Prints the status of a list, an upload and a deletion: once the disk has filled while the service runs, and once it was
full when the service started; then why it does not start without its reserve.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx

from capture2vr.cli.up import run_stack
from capture2vr.errors import BadInput
from tests.support import captures
from tests.support.patience import PATIENCE_S


def main(disk: Path) -> None:
    """Fill the disk while the service runs, and before it starts."""
    os.environ["EDGE_DEVICE"] = "cpu"
    data = disk / "data"
    with _service(data) as client:
        sent = [_upload(client).json()["capture"] for _ in range(3)]
        _fill(disk)
        _use(client, sent)
    for file in disk.glob("others-*"):
        file.unlink()
    with _service(data):
        pass
    _fill(disk)
    with _service(data, has_reserve=False) as client:
        _use(client, sent)
    _fill(disk)
    try:
        with _service(data, has_reserve=False):
            print("started without a reserve", flush=True)
    except BadInput as error:
        print(error, flush=True)


@contextmanager
def _service(data: Path, *, has_reserve: bool = True) -> Iterator[httpx.Client]:
    """Run the service, and wait until it has taken its reserve."""
    with run_stack("127.0.0.1", 0, data) as stack, httpx.Client(base_url=stack.url, timeout=PATIENCE_S) as client:
        deadline = time.monotonic() + PATIENCE_S
        while has_reserve and not (data / "gateway" / "gateway.reserve").exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield client


def _fill(disk: Path) -> None:
    """Write until nothing more fits."""
    for size in (1 << 20, 4096, 1):
        with suppress(OSError), (disk / f"others-{size}").open("ab", buffering=0) as file:
            while file.write(bytes(size)) == size:
                pass
    assert shutil.disk_usage(disk).free == 0


def _use(client: httpx.Client, sent: list[str]) -> None:
    """Read, send, and delete the last capture."""
    answers = [client.get("/v1/captures"), _upload(client), client.delete(f"/v1/captures/{sent.pop()}")]
    print(*(answer.status_code for answer in answers), flush=True)
    left = client.get("/v1/captures").json()["captures"]
    assert [each["capture"] for each in left] == sent


def _upload(client: httpx.Client) -> httpx.Response:
    return client.post("/v1/captures", files=[("files", ("a.ply", captures.ply_bytes(*captures.sphere())))])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
