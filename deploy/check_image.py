"""Use what an image is made of, while it is built: libraries that were made smaller still load, and do their work.

    check_image.py edge       a worker reconstructs a small cloud, trains its field, and serves
    check_image.py gateway    a gateway starts with an empty folder, and answers

Python writes the bytecode of all that is loaded meanwhile. slim.sh has removed it, and a container, whose files are
read-only, would compile it again at every start.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

_LIBRARIES = {
    "edge": [
        "av",
        "boto3",
        "cv2",
        "grpc",
        "laspy",
        "meshoptimizer",
        "pillow_heif",
        "pycolmap",
        "skimage.measure",
        "torch",
    ],
    "gateway": ["boto3", "cryptography.x509", "fastapi", "grpc", "pillow_heif", "psycopg", "sqlalchemy"],
}
_MAYBE = {"edge": ["embreex.rtcore", "pye57", "xatlas"], "gateway": []}  # no wheel for ARM
_TRACES = ["opentelemetry.sdk.trace.export", "opentelemetry.exporter.otlp.proto.http.trace_exporter"]
_READY = {
    "edge": [sys.executable, "-m", "capture2vr.edge.worker.health"],
    "gateway": [
        sys.executable,
        "-c",
        "import urllib.request as u; u.urlopen('http://127.0.0.1:8080/livez', timeout=2)",
    ],
}
_CAPTURE2VR = str(Path(sys.executable).with_name("capture2vr"))
_START_S = 120.0


def main(service: str) -> None:
    """Check the image of a service. Raises an exception for what does not work."""
    for name in [*_LIBRARIES[service], *_TRACES]:
        importlib.import_module(name)
    for name in _MAYBE[service]:
        if importlib.util.find_spec(name.partition(".")[0]):
            importlib.import_module(name)
    _open_bucket()
    with tempfile.TemporaryDirectory() as name:
        if service == "edge":
            _reconstruct(Path(name))
        _serve(service, Path(name))


def _open_bucket() -> None:
    """Make an S3 client, which loads the description of S3. Nothing is asked for."""
    from capture2vr.storage.s3 import S3Store

    S3Store(bucket="check", access_key="check", secret_key="check", endpoint="http://127.0.0.1:9")  # noqa: S106 - nobody is asked


def _reconstruct(folder: Path) -> None:
    """Run the whole way from points to an asset, with a trained field."""
    import numpy as np

    rng = np.random.default_rng(0)
    direction = rng.normal(size=(3000, 3))
    dome = 0.3 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    dome[:, 1] = np.abs(dome[:, 1])
    np.save(folder / "dome.npy", dome)
    run = [_CAPTURE2VR, "run", folder / "dome.npy", "-o", folder / "out", "--preset", "standard"]
    subprocess.run(run, check=True)  # noqa: S603 - no shell, and all words are from here
    if not list((folder / "out").rglob("*.glb")):
        raise RuntimeError("the reconstruction has left no mesh")


def _serve(service: str, folder: Path) -> None:
    """Start the service, wait until it is healthy, and stop it."""
    variables = {
        "STORAGE_KIND": "local",
        "STORAGE_ROOT": str(folder / "store"),
        "EDGE_SCRATCH": str(folder / "scratch"),
        "EDGE_METRICS_PORT": "9464",
        "GATEWAY_DATA_DIR": str(folder / "data"),
    }
    with subprocess.Popen([_CAPTURE2VR, service], env={**os.environ, **variables}) as child:  # noqa: S603
        try:
            _wait(_READY[service], child)
        finally:
            child.terminate()
    if child.returncode:
        raise RuntimeError(f"{service} has ended with {child.returncode}")


def _wait(is_ready: Sequence[str], child: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + _START_S
    while subprocess.run(is_ready, stderr=subprocess.DEVNULL).returncode:  # noqa: S603
        if child.poll() is not None or time.monotonic() > deadline:
            raise RuntimeError("the service does not become healthy")
        time.sleep(0.2)


if __name__ == "__main__":
    main(sys.argv[1])
