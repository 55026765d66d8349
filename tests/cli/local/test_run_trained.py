"""`capture2vr run` with a preset that trains: two pictures, two certificates, one page, and a kill in between."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from base64 import b64encode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture2vr.cli.local.results import Results, print_result
from capture2vr.cli.local.run import RunOptions, run_preset
from capture2vr.cli.local.run_many import run_captures
from capture2vr.cli.remote.push import continue_capture, push_capture
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.preset import Preset, preset_names
from capture2vr.edge.worker import memory_budget
from capture2vr.errors import BadInput
from capture2vr.order.job_options import JobOptions
from capture2vr.process.archives import pack
from capture2vr.storage.bundle import Bundle, sha256_hex
from tests.cli.local.test_run import capture2vr
from tests.support.clouds import write_ply
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

pytestmark = pytest.mark.usefixtures("small_pictures")

MESHES = {"mesh.ply", "lod0.glb", "lod1.glb", "lod2.glb"}
ON_CPU = RunOptions(device="cpu")
TINY = Preset("tiny", resolution=24, fit=NetworkConfig(warm_start=5, steps=5, warm_up=1, batch=100, pool=2_000))

# A process of its own, which can be killed: enough steps, and a checkpoint soon.
LONG = """
import sys
from pathlib import Path
import pytest
from capture2vr.cli.local.run import RunOptions, run_preset
from capture2vr.edge.field import checkpoint
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.preset import Preset
from tests.support.photos.small_pictures import draw_small
checkpoint.SECONDS = 0.2
draw_small(pytest.MonkeyPatch())
fit = NetworkConfig(warm_start=5, steps=int(sys.argv[3]), warm_up=1, batch=100, pool=2_000)
run_preset(Path(sys.argv[1]), Path(sys.argv[2]), Preset("tiny", resolution=24, fit=fit), RunOptions(device="cpu"))
"""


@pytest.fixture(scope="module")
def bowl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The lower half of a sphere, 1,500 points."""
    direction = np.random.default_rng(1).normal(size=(1500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 1] = -np.abs(direction[:, 1])
    return write_ply(tmp_path_factory.mktemp("trained") / "bowl.ply", direction)


def bundle(state: str, mean: float, **quality: object) -> Bundle:
    """A bundle with everything that the report looks at, and nothing else."""
    figures = {
        "held_out": 200,
        "held_out_mean": mean,
        "held_out_median": mean,
        "held_out_p95": 2 * mean,
        "coverage": 0.99,
        "stray_area": 0.0,
        "origins": {"measured": 1.0, "proposed": 0.0, "filled": 0.0},
        "consistency": 0.01,
        "components": 1,
        "boundary_loops": 1,
        "boundary_length": 3.14,
        "border_over_root": 1.57,
        "fringe": 1.0,
        "largest_hole": 0.2,
        "non_manifold_edges": 0,
        "triangles": 1000,
        "resolution": 96,
        "steps": 0,
        "device": "cpu",
        "seconds": 1.5,
        **quality,
    }
    manifest = {
        "label": "My <shirt>",
        "preset": "standard",
        "preset_because": "",
        "capture": {
            "kind": "photos",
            "format": "photos",
            "frames": 2,
            "photos": [
                {"name": "1.jpg", "verdict": "ok", "advice": ""},
                {"name": "<2>.jpg", "verdict": "no_overlap", "advice": "take more between 1.jpg and this one"},
            ],
            "unseen": [{"advice": "Shoot from <behind>.", "toward": [0.0, 0.0, -1.0], "share": 0.2}],
        },
        "points": 10_000,
        "origin": "measured",
        "origins": {"measured": 10_000, "proposed": 0, "filled": 77},
        "size_m": [1.0, 2.0, 3.0],
        "scale_confidence": "metric",
        "lods": [],
        "quality": figures,
        "seconds": {},
        "warnings": ["one"],
    }
    files = {"preview.png": state.encode(), "mesh.ply": state.encode()}
    return Bundle(state=state, files=files, manifest=manifest)


@pytest.fixture
def results(tmp_path: Path) -> Results:
    """A folder with a preview in it."""
    results = Results(tmp_path / "out", "shirt")
    results.write(bundle("preview", 0.003))
    return results


PHOTOS = {"photos": 2, "cover": 0.987, "lace": 0.0123, "inside_out": 0.0, "leak": 0.0456, "depth": None, "psnr": 21.5}


def with_photos(state: str, figures: dict[str, object] = PHOTOS, pictures: int = 2, **quality: object) -> Bundle:
    """A bundle that was compared with photos."""
    private = {f"photo-{number}.jpg": b"%d" % number for number in range(1, pictures + 1)}
    return replace(bundle(state, 0.002, photos=figures, **quality), private=private)


def report_of(results: Results) -> dict[str, object]:
    return json.loads((results.out / "report.json").read_text())


def test_the_refined_files_stand_on_top_and_both_pictures_side_by_side(results: Results) -> None:
    preview = bundle("preview", 0.003).manifest["quality"]
    results.write(bundle("refined", 0.002, verdict="better", because="it is nearer", preview=preview))
    assert (results.out / "mesh.ply").read_text() == "refined"
    assert (results.out / "preview" / "mesh.ply").read_text() == "preview"
    assert (results.out / "preview.png").read_text() == "preview"
    assert (results.out / "refined.png").read_text() == "refined"
    report = report_of(results)
    assert report["certificates"]["preview"] == preview
    assert report["certificates"]["refined"]["held_out_mean"] == 0.002
    assert report["verdict"] == "better"
    catalogue = json.loads((results.out / "bundle" / "catalog" / "shirt.json").read_text())
    assert [each["state"] for each in catalogue["versions"]] == ["preview", "refined"]


def test_a_kept_preview_stays_on_top_with_the_figures_of_what_was_refused(results: Results) -> None:
    refused = bundle("refined", 0.004, verdict="worse", because="it is farther").manifest["quality"]
    results.keep_preview("the preview was kept: it is farther", refused, {"FITTING": 7.0})
    assert (results.out / "mesh.ply").read_text() == "preview"
    assert not (results.out / "refined.png").exists()
    report = report_of(results)
    assert report["state"] == "preview"
    assert report["seconds"] == {"FITTING": 7.0}
    assert report["verdict"] == "worse"
    assert report["warnings"] == ["one", "the preview was kept: it is farther"]
    assert report["certificates"]["refined"]["held_out_mean"] == 0.004
    page = (results.out / "report.html").read_text()
    assert "worse than the preview, so the preview is the result" in page
    assert "0.00300" in page
    assert "0.00400" in page


def test_a_worse_mesh_that_is_published_all_the_same_is_the_result(results: Results) -> None:
    preview = bundle("preview", 0.003).manifest["quality"]
    results.write(bundle("refined", 0.004, verdict="worse", because="it is farther", preview=preview))
    assert (results.out / "mesh.ply").read_text() == "refined"
    page = (results.out / "report.html").read_text()
    assert "<b>worse than the preview</b>: it is farther" in page
    assert "not published" not in page


def test_a_failed_training_leaves_one_certificate_and_a_warning(results: Results) -> None:
    results.keep_preview("the preview was kept: the fit diverged", None, {"FITTING": 7.0})
    report = report_of(results)
    assert report["certificates"]["refined"] is None
    assert report["warnings"][-1] == "the preview was kept: the fit diverged"


def test_the_page_needs_nothing_from_anywhere_and_trusts_no_name(results: Results) -> None:
    page = (results.out / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert "http" not in page
    assert "My &lt;shirt&gt;" in page
    assert "<shirt>" not in page
    assert "<td>&lt;2&gt;.jpg</td><td>no overlap</td><td>take more between 1.jpg and this one</td>" in page
    assert "<li>Shoot from &lt;behind&gt;.</li>" in page


def test_held_out_photos_are_shown_with_their_figures(tmp_path: Path) -> None:
    results = Results(tmp_path / "out", "shirt")
    results.write(with_photos("preview"))
    assert (results.out / "photo-1.jpg").read_bytes() == b"1"
    assert (results.out / "photo-2.jpg").read_bytes() == b"2"
    assert report_of(results)["quality"]["photos"] == PHOTOS
    page = (results.out / "report.html").read_text()
    assert "<h2>Compared with photos that were not used</h2>" in page
    assert page.count("data:image/jpeg;base64,") == 2
    assert f"data:image/jpeg;base64,{b64encode(b'2').decode()}" in page
    for name, figure in {"held-out photos": "2", "holes": "1.23%", "surface beside the object": "4.56%"}.items():
        assert re.search(rf"<td>{name} <small>.*?</small></td><td class=\"figure\">{figure}</td>", page)
    assert "21.50" in page
    assert "SSIM" not in page, "it was not measured"
    assert "of their depth" not in page


def test_what_was_not_measured_is_shown_in_its_colours_with_numbers(tmp_path: Path) -> None:
    results = Results(tmp_path / "out", "shirt")
    shares = {"measured": 0.9, "proposed": 0.0, "filled": 0.1}
    results.write(replace(bundle("preview", 0.002, origins=shares), private={"origin.png": b"sheet"}))
    page = (results.out / "report.html").read_text()
    assert page.count(f"data:image/png;base64,{b64encode(b'sheet').decode()}") == 1
    assert '<b style="color: rgb(204, 121, 167)">■</b> filled in (77 points)' in page
    assert re.search(r"<td>filled in <small>.*?</small></td><td class=\"figure\">10.00%</td>", page)
    assert "Compared with photos" not in page, "it is no photo"
    plain = Results(tmp_path / "plain", "shirt")
    plain.write(bundle("preview", 0.002))
    assert "■" not in (plain.out / "report.html").read_text()


def test_the_grade_comes_first_on_the_page_and_on_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = Results(tmp_path / "out", "shirt")
    grade = {"level": "shoot again", "because": "the surface is in <shreds>", "advice": "Give it light."}
    made = bundle("preview", 0.003, grade=grade)
    made.manifest["warnings"].append("Shoot it again: the surface is in <shreds>. Give it light.")
    results.write(made)
    page = (results.out / "report.html").read_text()
    line = "<b>Shoot again: the surface is in &lt;shreds&gt;. Give it light.</b>"
    assert page.index(line) < page.index("<table>")
    assert "Shoot it again" not in page, "once is enough"
    print_result(results.out, results.report)
    assert capsys.readouterr().err.startswith("Shoot again: the surface is in <shreds>. Give it light.")


def test_both_certificates_have_a_column_of_photos(results: Results) -> None:
    """The preview was not compared with photos, and a figure that one of them lacks leaves its place empty."""
    preview = bundle("preview", 0.003).manifest["quality"]
    results.write(with_photos("refined", verdict="better", because="", preview=preview))
    page = (results.out / "report.html").read_text()
    assert re.search(
        r"<td>holes <small>.*?</small></td><td class=\"figure\"></td><td class=\"figure\">1.23%</td>", page
    )


def test_a_run_without_photos_to_spare_shows_none(results: Results) -> None:
    page = (results.out / "report.html").read_text()
    assert "Compared with photos" not in page
    assert "held-out photos" not in page


def test_photos_never_reach_the_store(tmp_path: Path) -> None:
    results = Results(tmp_path / "out", "shirt")
    results.write(with_photos("preview"))
    assert not [path for path in (results.out / "bundle").rglob("*") if "photo" in path.name]


def test_what_an_earlier_run_left_does_not_stay(results: Results) -> None:
    preview = bundle("preview", 0.003).manifest["quality"]
    refined = bundle("refined", 0.002, verdict="better", because="", preview=preview)
    tiles = {"tileset.json": b"{}", "tile-0-0-0.1.glb": b"1", "cameras.json": b"{}", "splats.spz": b"1"}
    results.write(replace(refined, files={**refined.files, **tiles}))
    pulled = dict.fromkeys(("points.laz", "thumbnail.webp"), b"of a pull")
    for name, content in pulled.items():
        (results.out / name).write_bytes(content)
    records = [{"file": name, "sha256": sha256_hex(content)} for name, content in pulled.items()]
    (results.out / "manifest.json").write_text(json.dumps({"key": "dress", "files": records}))
    (results.out / "thumbnail.webp").write_bytes(b"mine")  # somebody has put another one in its place
    again = Results(results.out, "shirt")
    again.write(with_photos("preview"))
    again.write(bundle("preview", 0.003))
    (results.out / "thumbnail.webp").unlink()
    assert {path.name for path in results.out.iterdir()} == {
        "bundle",
        "mesh.ply",
        "preview.png",
        "report.html",
        "report.json",
    }


@pytest.mark.parametrize("has_results", [False, True])
def test_what_is_not_of_an_earlier_run_stays(tmp_path: Path, has_results: bool) -> None:
    """Photos of somebody's own whose names are like those of a run's pictures."""
    results = Results(tmp_path / "out", "shirt")
    if has_results:
        results.write(bundle("preview", 0.003))
    mine = {results.out / name for name in ("photo-0001.jpg", "cut-list.jpg", "mine.txt")}
    for path in mine:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    results.write(with_photos("preview"))
    assert {path for path in mine if path.read_text() == "mine"} == mine


@pytest.mark.parametrize("name", ["bundle", "preview"])
def test_a_folder_of_others_stops_a_run_before_it_begins(bowl: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "mine.txt").write_text("mine")
    with pytest.raises(BadInput, match=f"{name} exists and is no result of `capture2vr run`"):
        run_preset(bowl, tmp_path, TINY, ON_CPU)
    assert [path.name for path in tmp_path.rglob("*")] == [name, "mine.txt"]


def test_a_run_never_replaces_its_capture(bowl: Path, tmp_path: Path) -> None:
    capture = tmp_path / "mesh.ply"
    capture.write_bytes(b"the capture")
    with pytest.raises(BadInput, match="would be replaced by the result of that name"):
        Results(tmp_path, "shirt", capture=capture).write(bundle("preview", 0.003))
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the capture"]
    scan = capture.rename(tmp_path / "scan.ply")
    for out, source in ((tmp_path, "scan.ply"), (tmp_path / "out", "")):
        Results(out, "shirt", capture=scan).write(bundle("preview", 0.003))
        assert json.loads((out / "report.json").read_text())["source"] == source  # `convert` spares it
    with pytest.raises(BadInput, match="is the capture: name another folder"):
        run_preset(tmp_path, tmp_path, TINY, ON_CPU)


def test_results_are_not_written_into_the_capture(bowl: Path, tmp_path: Path) -> None:
    """The next run would take the first one's mesh, which is larger, for the capture."""
    (tmp_path / "scan").mkdir()
    scan = tmp_path / "scan" / "scan.ply"
    scan.write_bytes(bowl.read_bytes())
    options = replace(ON_CPU, key="bowl")
    with pytest.raises(BadInput, match="out lies in the capture, and would be read as a part of it"):
        run_preset(scan.parent, scan.parent / "out", TINY, options)
    with pytest.raises(BadInput, match="lies in the capture"):
        run_captures([scan.parent, bowl], scan.parent / "out", replace(ON_CPU, job=JobOptions("draft")))
    assert list(tmp_path.rglob("*")) == [scan.parent, scan]


def test_results_and_a_gateways_data_are_no_part_of_a_capture(bowl: Path, tmp_path: Path) -> None:
    """As a folder is where `up` was started, or an earlier version of `run` has written to."""
    capture = tmp_path / "scan"
    Results(capture / "out", "shirt").write(bundle("preview", 0.003))
    (capture / "scan.ply").write_bytes(bowl.read_bytes())
    with pytest.raises(BadInput, match="scan/out lies in the capture and was made by capture2vr"):
        run_preset(capture, tmp_path / "out", TINY, ON_CPU)
    (capture / "out").rename(tmp_path / "out")
    (capture / "capture2vr-data" / "gateway").mkdir(parents=True)
    (capture / "capture2vr-data" / "gateway" / "gateway.db").write_bytes(b"")
    with pytest.raises(BadInput, match="capture2vr-data/gateway lies in the capture"):
        push_capture(capture, "http://127.0.0.1:9", key="scan")
    with pytest.raises(BadInput, match="capture2vr-data/gateway lies in the capture"):
        continue_capture(capture, "http://127.0.0.1:9", key="scan", cut=None, edits=None)
    # Results are a mesh like another to whoever names them.
    with pytest.raises(BadInput, match="cannot be reached"):
        push_capture(tmp_path / "out", "http://127.0.0.1:9", key="scan")


def test_a_folder_on_a_disk_that_is_away_is_told_before_the_work(bowl: Path, tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    with pytest.raises(BadInput, match="out is a link to something that is not there"):
        run_preset(bowl, tmp_path / "out", TINY, ON_CPU)


@pytest.mark.slow
def test_a_training_run_leaves_both_certificates_and_no_checkpoint(bowl: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_preset(bowl, out, TINY, ON_CPU)
    names = {path.name for path in out.iterdir()}
    assert {*MESHES, "preview.png", "report.json", "report.html", "bundle"} <= names
    assert "fit.checkpoint" not in names
    report = json.loads((out / "report.json").read_text())
    assert report["certificates"]["refined"]["steps"] == 10
    assert report["verdict"] in {"better", "even", "worse"}
    assert ("refined.png" in names) == ("preview" in names) == (report["verdict"] != "worse")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_ended_leaves_no_copy_of_the_capture(
    bowl: Path, tmp_path: Path, number: signal.Signals
) -> None:
    pack(bowl, tmp_path / "bowl.zip")
    scratch = tmp_path / "tmp"
    scratch.mkdir()
    command = [sys.executable, "-m", "capture2vr.cli", "run", tmp_path / "bowl.zip", "-o", tmp_path / "out"]
    child = subprocess.Popen(
        command,
        stderr=subprocess.DEVNULL,
        cwd=ROOT,
        env={**os.environ, "TMPDIR": str(scratch)},
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # tests under nohup ignore it
    )
    deadline = time.monotonic() + HANG_S
    while not list(scratch.rglob("bowl.ply")):
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    child.send_signal(number)
    assert child.wait(HANG_S) == 128 + number
    assert list(scratch.iterdir()) == []


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_checkpoint(bowl: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", LONG, str(bowl), str(out), "150"]
    child = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=ROOT)
    checkpoint = out / "fit.checkpoint"
    deadline = time.monotonic() + 120
    while not checkpoint.exists() and time.monotonic() < deadline and child.poll() is None:
        time.sleep(0.05)
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert checkpoint.exists()
    assert (out / "preview.png").exists(), "the preview was there before the training began"

    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    assert "starts from the beginning" not in result.stderr, "the checkpoint was taken"
    assert not checkpoint.exists()
    report = json.loads((out / "report.json").read_text())
    assert report["certificates"]["refined"]["steps"] == 155


def test_a_preset_that_memory_does_not_hold_is_refused_before_any_work(
    bowl: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory_budget, "machine_bytes", lambda: 1 << 20)
    with pytest.raises(BadInput, match=r"preset tiny needs .* GB of memory for 1,500 points") as told:
        run_preset(bowl, tmp_path / "out", TINY, ON_CPU)
    assert "capture2vr presets" in str(told.value)
    assert not (tmp_path / "out").exists()


def test_a_device_that_is_not_there_is_said_plainly(bowl: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cuda:97"):
        run_preset(bowl, tmp_path / "out", TINY, RunOptions(device="cuda:97"))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_presets_are_listed_with_what_they_take() -> None:
    result = capture2vr("presets")
    assert result.returncode == 0, result.stderr
    rows = [[cell.strip() for cell in line.split("│")] for line in result.stdout.splitlines() if "│" in line]
    assert {"auto", *preset_names()} <= {row[1] for row in rows}, "a name is whole, and in one line"
    assert "GB" in result.stdout
    assert result.stderr == ""
