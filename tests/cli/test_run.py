"""`capture2vr run` as a person types it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.clouds import write_ply


def capture2vr(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "services.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd)


@pytest.fixture(scope="module")
def bowl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hemisphere of radius 3 around (10, 20, 30), coloured."""
    direction = np.random.default_rng(1).normal(size=(8000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 1] = -np.abs(direction[:, 1])
    path = tmp_path_factory.mktemp("run") / "my bowl.ply"
    write_ply(path, direction * 3 + [10, 20, 30], rgb=((direction * 0.5 + 0.5) * 255).astype(np.uint8))
    return path


@pytest.fixture(scope="module")
def out(bowl: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of one run."""
    out = tmp_path_factory.mktemp("out")
    result = capture2vr("run", bowl, "-o", out)
    assert result.returncode == 0, result.stderr
    return out


def test_the_folder_holds_what_is_promised(out: Path) -> None:
    names = {path.name for path in out.iterdir()}
    assert names == {"mesh.ply", "lod0.glb", "lod1.glb", "lod2.glb", "preview.png", "report.json", "bundle"}


def test_the_mesh_is_in_the_files_own_frame_and_units(out: Path) -> None:
    mesh = trimesh.load(out / "mesh.ply")
    radius = np.linalg.norm(mesh.vertices - [10, 20, 30], axis=1)
    assert np.abs(radius - 3).max() < 0.1
    assert mesh.visual.kind == "vertex"


def test_levels_of_detail_get_coarser_and_stand_on_the_floor(out: Path) -> None:
    levels = [trimesh.load(out / f"lod{level}.glb", force="mesh") for level in range(3)]
    faces = [len(level.faces) for level in levels]
    assert faces == sorted(faces, reverse=True)
    assert faces[2] <= 5_000
    for level in levels:
        assert level.bounds[0][1] == pytest.approx(0, abs=0.05)
        assert level.extents == pytest.approx([6, 3, 6], abs=0.2)


def test_the_report_tells_figures_seconds_and_warnings(out: Path) -> None:
    report = json.loads((out / "report.json").read_text())
    assert report["points"] > 7900
    assert report["quality"]["components"] == 1
    assert report["quality"]["non_manifold_edges"] == 0
    assert report["quality"]["boundary_loops"] == 1
    assert {"POINT_CLOUD", "FITTING", "EXTRACTING", "PACKING"} <= report["seconds"].keys()
    assert report["scale_confidence"] == "unknown"
    assert report["key"] == "my-bowl"
    to_asset = np.array(report["capture_to_asset"]).reshape(4, 4)
    assert (to_asset @ [10, 17, 30, 1])[1] == pytest.approx(0, abs=0.05), "the bottom of the bowl is the floor"


def test_the_picture_shows_something_on_four_sides(out: Path) -> None:
    pixels = np.asarray(Image.open(out / "preview.png").convert("RGB")).astype(int)
    height, width = pixels.shape[:2]
    for quarter in (pixels[: height // 2], pixels[height // 2 :], pixels[:, : width // 2], pixels[:, width // 2 :]):
        assert (np.abs(quarter - pixels[0, 0]).max(axis=2) > 12).mean() > 0.05


def test_the_bundle_is_addressed_by_content(out: Path) -> None:
    entry = json.loads((out / "bundle" / "catalog" / "my-bowl.json").read_text())
    for item in entry["files"]:
        content = (out / "bundle" / item["name"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == item["sha256"]
        assert item["sha256"][:16] in item["name"]
        assert len(content) == item["bytes"]


def test_a_zip_gives_the_same_mesh_as_its_file(bowl: Path, out: Path, tmp_path: Path) -> None:
    archive = tmp_path / "upload.zip"
    with zipfile.ZipFile(archive, "w") as zipped:
        zipped.write(bowl, "top/bowl.ply")
    result = capture2vr("run", archive, "-o", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "out" / "mesh.ply").read_bytes() == (out / "mesh.ply").read_bytes()


def _cloud(points: np.ndarray) -> str:
    return "\n".join(" ".join(map(str, point)) for point in points)


_SPIRAL = np.c_[np.cos(np.arange(500)), np.sin(np.arange(500)), np.arange(500) / 500]

BAD = {
    "empty.ply": (b"", "empty"),
    "list.ply": (b"this is a shopping list\n" * 50, ""),
    "few.xyz": (_cloud(_SPIRAL[:12]).encode(), "12"),
    "nan.xyz": (_cloud(np.where(_SPIRAL > 0.5, np.nan, _SPIRAL)).encode(), ""),
    "huge.xyz": (_cloud(np.where(_SPIRAL > 0.5, 1e30, _SPIRAL)).encode(), ""),
    "one.xyz": (_cloud(np.ones((1000, 3))).encode(), ""),
    "line.xyz": (_cloud(np.outer(np.arange(500), [1.0, 2.0, 3.0])).encode(), "line"),
    "photo.txt": (b"\xff\xd8\xff\xe0 not really", ""),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_ends_with_one_sentence_and_leaves_nothing(name: str, tmp_path: Path) -> None:
    content, word = BAD[name]
    (tmp_path / name).write_bytes(content)
    result = capture2vr("run", tmp_path / name, "-o", tmp_path / "out")
    assert result.returncode == 2
    said = [line for line in result.stderr.strip().splitlines() if line.startswith("capture2vr:")]
    assert len(said) == 1
    assert name in said[0]
    assert word in said[0]
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


def test_an_unknown_preset_is_told_with_the_known_ones(bowl: Path, tmp_path: Path) -> None:
    result = capture2vr("run", bowl, "-o", tmp_path / "out", "--preset", "magic")
    assert result.returncode == 2
    assert "magic" in result.stderr
    assert "draft" in result.stderr


def test_a_missing_file_and_a_bad_key_are_told(bowl: Path, tmp_path: Path) -> None:
    assert capture2vr("run", tmp_path / "nowhere.ply", "-o", tmp_path / "out").returncode == 2
    bad_key = capture2vr("run", bowl, "-o", tmp_path / "out", "--key", "../escape")
    assert bad_key.returncode == 2
    assert "../escape" in bad_key.stderr


def test_a_bomb_of_zeros_is_refused(tmp_path: Path) -> None:
    archive = tmp_path / "bomb.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as zipped:
        zipped.writestr("cloud.xyz", b"\0" * 50_000_000)
    result = capture2vr("run", archive, "-o", tmp_path / "out")
    assert result.returncode == 2
    assert "bomb.zip" in result.stderr


@pytest.mark.data
@pytest.mark.parametrize(
    "capture",
    ["cloud_room/fragment.pcd", "rgbd_livingroom", "phone_tof", "dress/dress-v17k-f34k.obj", "car", "milktruck"],
)
def test_real_captures_become_assets(capture: str, data_dir: Path, tmp_path: Path) -> None:
    result = capture2vr("run", data_dir / capture, "-o", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    quality = report["quality"]
    assert quality["non_manifold_edges"] <= 0.001 * 1.5 * quality["triangles"]
    # Half of the points lie on the surface to within a cell.
    assert quality["points_to_mesh_median"] < 1.0 / quality["resolution"]
