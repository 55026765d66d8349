"""The programs and notebooks of examples/ run, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from tests.support.clouds import sphere_points
from tests.support.gateway_of_zips import gateway_of_zips
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

pytestmark = pytest.mark.slow

EXAMPLES = ROOT / "examples"
ALL = {"cloud_to_mesh.py", "photos_to_glb.py", "push_follow_pull.py"}
NOTEBOOKS = {"capture_to_headset.ipynb", "cloud_to_mesh.ipynb", "gateway.ipynb"}
BRIEFLY = ("--preset", "draft", "--resolution", "24")


@pytest.fixture
def gateway(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    for variable in ("XDG_STATE_HOME", "XDG_CACHE_HOME", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.delenv("CAPTURE2VR_KEY", raising=False)
    with gateway_of_zips(tmp_path) as served:
        yield served.url


def _run(name: str, *arguments: str | Path, cwd: Path) -> str:
    command = [sys.executable, "-P", str(EXAMPLES / name), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_no_example_is_left_out() -> None:
    assert {path.name for path in EXAMPLES.iterdir() if path.is_file()} - {"README.md"} == ALL | NOTEBOOKS


def test_a_cloud_becomes_a_mesh(tmp_path: Path) -> None:
    np.save(tmp_path / "cloud.npy", np.hstack([sphere_points(600), np.full((600, 3), 90)]))
    said = _run("cloud_to_mesh.py", "cloud.npy", "mesh.glb", *BRIEFLY, cwd=tmp_path)
    assert "EXTRACTING" in said
    assert (tmp_path / "mesh.glb").read_bytes()[:4] == b"glTF"


def test_photos_become_a_glb_and_what_is_none_is_told(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    picture = np.full((240, 320, 3), 215, np.uint8)
    cv2.circle(picture, (160, 120), 70, (40, 60, 180), cv2.FILLED)
    cv2.imwrite(str(tmp_path / "photos" / "ball.png"), picture)
    said = _run("photos_to_glb.py", "photos", "result", *BRIEFLY, cwd=tmp_path)
    assert "triangles" in said
    assert (tmp_path / "result" / "lod0.glb").read_bytes()[:4] == b"glTF"
    (tmp_path / "photos" / "ball.png").write_bytes(b"")
    with pytest.raises(AssertionError, match="choose the files again"):
        _run("photos_to_glb.py", "photos", "result", cwd=tmp_path)


def test_a_gateway_makes_an_asset(gateway: str, tmp_path: Path) -> None:
    np.save(tmp_path / "ball.npy", sphere_points(600))
    said = _run("push_follow_pull.py", "ball.npy", "ball", "result", "--gateway", gateway, cwd=tmp_path)
    assert "(preview published)" in said
    assert "ball version 2: mesh.ply in result" in said
    assert (tmp_path / "result" / "mesh.ply").is_file()


@pytest.mark.parametrize("name", sorted(NOTEBOOKS))
def test_a_notebook_runs_from_top_to_bottom(
    name: str, gateway: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAPTURE2VR_GATEWAY", gateway)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.read(EXAMPLES / name, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] for cell in cells), "outputs of whoever ran it last are not committed"
    NotebookClient(notebook, timeout=HANG_S, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert all(cell.execution_count for cell in cells)
