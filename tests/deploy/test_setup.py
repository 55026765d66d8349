"""deploy/setup.sh: where PyTorch comes from, and what is said where nothing can be fetched. A recorder is pip."""

from __future__ import annotations

import os
import shutil
import subprocess
import threading
import venv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from tests.support.repository import ROOT

NOWHERE = "http://127.0.0.1:9"
PIP = """#!/bin/bash
echo "$@" >>"$(dirname "$0")/asked"
exit ${PIP_FAILS:-0}
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with an empty environment, whose pip notes what it is asked for."""
    for name in ("deploy/setup.sh", "deploy/missing.py", "pyproject.toml", "constraints.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    venv.create(tmp_path / ".venv", with_pip=False)
    _program(tmp_path / ".venv" / "bin" / "pip", PIP)
    return tmp_path


def _program(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


def _set_up(checkout: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    path = f"{checkout / 'programs'}:{os.environ['PATH']}"
    command = ["bash", checkout / "deploy" / "setup.sh", "product"]
    return subprocess.run(command, env={**os.environ, "PATH": path, **variables}, capture_output=True, text=True)


def _asked(checkout: Path) -> list[str]:
    """What pip was to install of PyTorch alone."""
    lines = (checkout / ".venv" / "bin" / "asked").read_text().splitlines()
    return [line for line in lines if line.endswith(" torch")]


@contextmanager
def _index(folder: Path) -> Iterator[str]:
    (folder / "index" / "torch").mkdir(parents=True)
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder / "index"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def _lend_cuda(checkout: Path) -> None:
    _program(checkout / "programs" / "nvidia-smi", "#!/bin/sh\n")


def _lend_torch(checkout: Path) -> None:
    (site,) = (checkout / ".venv").glob("lib/*/site-packages")
    (site / "torch-2.0.dist-info").mkdir()
    (site / "torch-2.0.dist-info" / "METADATA").write_text("Name: torch\nVersion: 2.0\n")


@pytest.mark.skipif(Path("/dev/nvidia0").exists(), reason="a CUDA device is there")
def test_the_cpu_build_comes_from_its_own_index(checkout: Path) -> None:
    with _index(checkout) as url:
        assert _set_up(checkout, TORCH_CPU_INDEX=url).returncode == 0
    (asked,) = _asked(checkout)
    assert f"-c constraints.txt --no-deps --index-url {url} torch" in asked


@pytest.mark.skipif(Path("/dev/nvidia0").exists(), reason="a CUDA device is there")
def test_an_index_that_does_not_answer_is_not_asked_again(checkout: Path) -> None:
    done = _set_up(checkout, TORCH_CPU_INDEX=NOWHERE)
    assert done.returncode == 0
    assert f"no CPU build of PyTorch from {NOWHERE}" in done.stderr
    (asked,) = _asked(checkout)
    assert "-c constraints.txt torch" in asked


@pytest.mark.parametrize("lend", [_lend_cuda, _lend_torch])
def test_a_cuda_device_or_a_torch_that_is_there_asks_for_none(checkout: Path, lend: Callable[[Path], None]) -> None:
    lend(checkout)
    assert _set_up(checkout, TORCH_CPU_INDEX=NOWHERE).returncode == 0
    assert _asked(checkout) == []


def test_offline_it_says_what_is_missing_and_what_to_do(checkout: Path) -> None:
    _lend_torch(checkout)
    done = _set_up(checkout, PIP_FAILS="1")
    assert done.returncode == 1
    (said,) = (line for line in done.stderr.splitlines() if line.startswith("setup: pip could not install"))
    assert " torch," not in said
    assert {"numpy", "scipy", "trimesh"} <= {word.strip(",;") for word in said.split()}
    assert "PIP_FIND_LINKS=folder" in said
