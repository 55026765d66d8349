"""The bench of textures: each level's stages are measured, and an older commit is measured from its own files."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.export.ply import ply_bytes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.preset import Preset
from capture2vr.edge.texture import texture_mesh
from tests.bench import texture
from tests.support import surfaces

NEW = {"levels": [{"unwrap": [2.0, 1.0], "bake": [4.0, 6.0], "encode": [0.5, 0.25]}], "until": [3.0, 10.0]}
OLD = {"levels": [{"unwrap": [2.0, 4.0], "bake": [4.0, 6.0], "encode": [0.5, 0.5]}], "until": [6.0, 10.0]}


@pytest.mark.slow
def test_every_level_of_a_reconstruction_is_measured(tmp_path: Path) -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, 0.1 * np.sin(5 * u)], 140, 140)
    odd = np.floor(sheet.vertices * 20).astype(int).sum(axis=1) % 2 == 1
    rgb = np.where(odd[:, None], (210, 40, 40), (40, 60, 200)).astype(np.uint8)
    source = tmp_path / "sheet.ply"
    source.write_bytes(ply_bytes(Mesh(sheet.vertices, sheet.faces[:0], rgb)))
    original = texture_mesh.unwrap
    found = texture.one(source, Preset("coarse", resolution=40))
    assert len(found["levels"]) == 3
    for level in found["levels"]:
        assert all(seconds > 0 for seconds, _ in level.values())
    assert found["levels"][0]["bake"][1] > 0
    assert len(found["until"]) == 1
    assert found["psnr"] is None
    assert texture_mesh.unwrap is original


def test_an_older_commit_has_its_own_files_and_leaves_none(tmp_path: Path) -> None:
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    subprocess.run([*git, "init", "-q"], check=True)
    for content in ("old", "new"):
        (tmp_path / "file").write_text(content)
        subprocess.run([*git, "add", "file"], check=True)
        subprocess.run([*git, "commit", "-q", "-m", content], check=True)
    with texture.worktree("HEAD~1", tmp_path) as tree:
        assert (tree / "file").read_text() == "old"
    assert not tree.exists()
    assert (tmp_path / "file").read_text() == "new"


def test_the_table_has_seconds_ratios_and_likeness() -> None:
    level, total = texture.lines_of("shirt", {**NEW, "psnr": 23.5, "sharp": 0.5}, {**OLD, "psnr": 23.0, "sharp": 0.5})
    assert level == "| shirt, LOD 0 | 2.00 (1.00), × 0.25 | 4.00 (6.00), × 1.00 | 0.50 (0.25), × 0.50 | | |"
    assert total == "| shirt, CPU s to each bundle: 3.0, × 0.50; 10.0, × 1.00 | | | | 23.00 → 23.50 | 0.50 → 0.50 |"
    level, total = texture.lines_of("shirt", {**NEW, "psnr": None, "sharp": None})
    assert level == "| shirt, LOD 0 | 2.00 (1.00) | 4.00 (6.00) | 0.50 (0.25) | | |"
    assert total == "| shirt, CPU s to each bundle: 3.0; 10.0 | | | |  |  |"
