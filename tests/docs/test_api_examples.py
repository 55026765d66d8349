"""The ten usual calls of docs/api.md do what they say, in each language, against a product that runs."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from capture2vr.cli.up import free_port
from tests.conftest import missing
from tests.support.clouds import write_ply
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

RUN = {"sh": ("bash", "-eu", "calls.sh"), "python": (sys.executable, "calls.py"), "javascript": ("node", "calls.mjs")}
"""Language of a block -> the program that runs the page's blocks of it, one after the other, as one file."""


def blocks_of(language: str) -> list[str]:
    text = (ROOT / "docs" / "api.md").read_text()
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL of a product that runs."""
    port = free_port()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "capture2vr.cli", "up", "--port", str(port)]
    home = tmp_path_factory.mktemp("product")
    with subprocess.Popen(command, cwd=home, env=environment, stderr=subprocess.PIPE, text=True) as product:
        assert product.stderr is not None
        try:
            assert any("capture page" in line for line in product.stderr)
            yield f"http://127.0.0.1:{port}"
        finally:
            product.send_signal(signal.SIGINT)


def test_each_call_has_an_example_in_each_language() -> None:
    text = (ROOT / "docs" / "api.md").read_text()
    assert re.findall(r"^## (\d+)\. ", text, re.MULTILINE) == [str(number) for number in range(1, 11)]
    assert {language: len(blocks_of(language)) for language in RUN} == dict.fromkeys(RUN, 11)  # the set-up first


@pytest.mark.slow
@pytest.mark.parametrize("language", RUN)
def test_the_calls_run(language: str, gateway: str, tmp_path: Path) -> None:
    program, *_, file = RUN[language]
    if language == "javascript" and subprocess.run(["which", "node"], capture_output=True).returncode:
        missing("node")
    xyz = np.random.default_rng(3).normal(size=(400, 3))
    xyz *= [0.05, 0.3, 0.05] / np.linalg.norm(xyz, axis=1, keepdims=True)
    write_ply(tmp_path / "scan.ply", xyz, np.full((400, 3), 128))
    (tmp_path / file).write_text("\n".join(blocks_of(language)))
    ended = subprocess.run(
        [program, *RUN[language][1:]],
        cwd=tmp_path,
        env={**os.environ, "CAPTURE2VR_GATEWAY": gateway},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert ended.returncode == 0, ended.stderr
    assert "/s/shr_" in ended.stdout
    assert (tmp_path / "boot.glb").read_bytes()[:4] == b"glTF"
