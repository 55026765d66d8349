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

from capture2vr.cli.local.reference_mesh import read_reference
from capture2vr.cli.local.run import RunOptions, run_capture, run_preset
from capture2vr.edge.preset import Preset
from capture2vr.errors import BadInput
from capture2vr.order.job_options import JobOptions
from tests.referees.glb_reader import Glb
from tests.support.clouds import write_ply

# For speed: what is read, fused and oriented is the same at any resolution.
RESOLUTION = 72
BRIEFLY = ("--preset", "draft", "--resolution", RESOLUTION)
COARSE = Preset("coarse", resolution=48, most_points=10_000, lod_faces=(2_000,))


def capture2vr(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "capture2vr.cli", *map(str, arguments)]
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
    reference = out.parent / "known.ply"
    known = trimesh.creation.icosphere(subdivisions=4)
    known.update_faces(known.triangles_center[:, 2] < 0)  # a hemisphere of another size, turned another way
    known.export(reference)
    told = ("--reference", reference, "--longest", "0.5", "--collection", "bowls")
    result = capture2vr("run", bowl, "-o", out, *BRIEFLY, *told)
    assert result.returncode == 0, result.stderr
    assert "distance to the reference" in result.stderr
    return out


@pytest.mark.essential
@pytest.mark.slow
def test_the_folder_holds_what_is_promised(out: Path) -> None:
    names = {path.name for path in out.iterdir()}
    meshes = {"mesh.ply", "lod0.glb", "lod1.glb", "lod2.glb"}
    pictures = {"preview.png", "thumbnail.webp", "turning.webp"}
    assert names == {*meshes, *pictures, "asset.usdz", "points.laz", "report.json", "report.html", "bundle"}


def test_the_mesh_is_in_the_files_own_frame_and_units(out: Path) -> None:
    mesh = trimesh.load(out / "mesh.ply")
    radius = np.linalg.norm(mesh.vertices - [10, 20, 30], axis=1)
    assert np.abs(radius - 3).max() < 0.1
    assert mesh.visual.kind == "vertex"


def test_levels_of_detail_get_coarser_and_stand_on_the_floor(out: Path) -> None:
    levels = [Glb.of((out / f"lod{level}.glb").read_bytes()) for level in range(3)]
    faces = [len(level.faces) for level in levels]
    assert faces == sorted(faces, reverse=True)
    assert faces[2] <= 5_000
    for level in levels:
        assert level.positions[:, 1].min() == pytest.approx(0, abs=0.005)
        assert np.ptp(level.positions, axis=0) == pytest.approx([0.5, 0.25, 0.5], rel=0.05)  # the length that was told


def test_the_report_tells_figures_seconds_and_warnings(out: Path) -> None:
    report = json.loads((out / "report.json").read_text())
    assert report["points"] > 7900
    assert report["quality"]["components"] == 1
    assert report["quality"]["pieces"][0]["reason"] == "the largest"
    page = (out / "report.html").read_text()
    assert "<h2>Pieces</h2>" in page
    assert "the largest" in page
    assert report["quality"]["non_manifold_edges"] == 0
    assert report["quality"]["boundary_loops"] == 1
    assert {"POINT_CLOUD", "FITTING", "EXTRACTING", "PACKING"} <= report["seconds"].keys()
    assert report["scale_confidence"] == "estimated"
    assert report["key"] == "my-bowl"
    to_asset = np.array(report["capture_to_asset"]).reshape(4, 4)
    assert (to_asset @ [10, 17, 30, 1])[1] == pytest.approx(0, abs=0.05), "the bottom of the bowl is the floor"


def test_a_reference_may_have_polygons_and_relative_indices(tmp_path: Path) -> None:
    squares = [f"v 0 0 {z}\nv 1 0 {z}\nv 1 1 {z}\nv 0 1 {z}\nf -4 -3 -2 -1\n" for z in (0, 5)]
    (tmp_path / "known.obj").write_text("mtllib gone.mtl\n" + "".join(squares))
    mesh = read_reference(tmp_path / "known.obj")
    assert [list(each) for each in mesh.vertices[mesh.faces][:, :, 2]] == [[0] * 3] * 2 + [[5] * 3] * 2


def test_the_report_tells_how_far_the_reference_is(out: Path) -> None:
    found = json.loads((out / "report.json").read_text())["reference"]
    assert found["median"] < 0.002
    assert found["complete"] > 0.97
    page = (out / "report.html").read_text()
    assert "Comparison with the reference" in page
    assert f"{found['median']:.3%}" in page


@pytest.mark.parametrize("content", [b"", b"v 0 0 0\nv 1 0 0\n", b"\0" * 100])
def test_a_reference_that_is_no_surface_is_refused_before_any_work(content: bytes, bowl: Path, tmp_path: Path) -> None:
    (tmp_path / "known.obj").write_bytes(content)
    named = RunOptions(JobOptions("draft"), reference=tmp_path / "known.obj", resolution=RESOLUTION)
    with pytest.raises(BadInput, match=r"known\.obj"):
        run_capture(bowl, tmp_path / "out", named)
    assert not (tmp_path / "out").exists()


def test_the_picture_shows_something_on_four_sides(out: Path) -> None:
    pixels = np.asarray(Image.open(out / "preview.png").convert("RGB")).astype(int)
    height, width = pixels.shape[:2]
    for quarter in (pixels[: height // 2], pixels[height // 2 :], pixels[:, : width // 2], pixels[:, width // 2 :]):
        assert (np.abs(quarter - pixels[0, 0]).max(axis=2) > 12).mean() > 0.05


def test_the_bundle_is_addressed_by_content(out: Path) -> None:
    entry = json.loads((out / "bundle" / "catalog" / "my-bowl.json").read_text())
    assert entry["collections"] == [path.name for path in (out / "bundle" / "collections").iterdir()] == ["bowls"]
    for item in entry["files"]:
        content = (out / "bundle" / item["name"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == item["sha256"]
        assert item["sha256"][:16] in item["name"]
        assert len(content) == item["bytes"]


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_a_zip_gives_the_same_mesh_as_its_file(bowl: Path, out: Path, tmp_path: Path) -> None:
    archive = tmp_path / "upload.zip"
    with zipfile.ZipFile(archive, "w") as zipped:
        zipped.write(bowl, "top/bowl.ply")
    run_capture(archive, tmp_path / "out", RunOptions(JobOptions("draft"), resolution=RESOLUTION))
    assert (tmp_path / "out" / "mesh.ply").read_bytes() == (out / "mesh.ply").read_bytes()


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.usefixtures("small_pictures")
@pytest.mark.parametrize(
    "capture",
    ["cloud_room/fragment.pcd", "rgbd_livingroom", "phone_tof", "dress/dress-v17k-f34k.obj", "car", "milktruck"],
)
def test_real_captures_become_assets(capture: str, data_dir: Path, tmp_path: Path) -> None:
    run_preset(data_dir / capture, tmp_path / "out", COARSE, RunOptions(device="cpu"))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    quality = report["quality"]
    assert quality["non_manifold_edges"] <= 0.001 * 1.5 * quality["triangles"]
    # Half of the points lie on the surface to within a cell.
    assert quality["points_to_mesh_median"] < 1.0 / quality["resolution"]
