"""The paper's tables and figures: colours tell distances, pictures and files hold what they say, gaps are named."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.networks import network_of
from tests.bench import __main__ as benches
from tests.bench import published
from tests.bench.methods import Settings
from tests.bench.paper import frame_times, heat_maps, paper_delivery, paper_figures
from tests.bench.paper.heat_maps import Column, View
from tests.bench.paper.paper_delivery import Way
from tests.bench.peers import peer_extraction
from tests.bench.peers.peer_extraction_child import samples_of
from tests.bench.published import BATCH, Cell, keep_mesh
from tests.bench.records import fingerprint
from tests.bench.shapes import DEFORMED, Row
from tests.support import scenes, surfaces
from tests.support.mesh_metrics import distances_to

# As DCUDF2's network is laid out: its encoding is a local function.
FIELDS = """
import torch
from models.embedder import get_embedder
class UDFNetwork(torch.nn.Module):
    def __init__(self, multires, **_):
        super().__init__()
        self.embed_fn_fine = get_embedder(multires)[0]
        self.out = torch.nn.Linear(3, 1, bias=False)
    def load_state_dict(self, stored):
        super().load_state_dict(stored)
        self.out = torch.nn.utils.weight_norm(self.out)
    def forward(self, x):
        return self.out(self.embed_fn_fine(x))
"""
DISK = Row("disk", partial(surfaces.disk), points=300, resolution=24)
CELL = Cell(DISK, "paper", NetworkConfig(batch=BATCH, steps=40_000))
BLUE, RED = (30, 70, 210), (255, 25, 15)


# Colours


@pytest.mark.slow
def test_distances_are_those_from_the_surface_and_from_its_border() -> None:
    sheet = Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    over, beside = np.array([[0.5, 0.5, 0.003], [1.03, 0.5, 0.04]])[:, None]
    assert distances_to(sheet, over) == pytest.approx([0.003], abs=1e-9)
    assert distances_to(sheet, beside) == pytest.approx([0.05], abs=2e-3)


def test_colours_run_from_the_first_to_the_last_and_stay_there() -> None:
    colours = heat_maps.colours_of(np.array([0.0, heat_maps.WORST, 10.0]))
    assert [tuple(each) for each in colours.tolist()] == [BLUE, RED, RED]


@pytest.mark.slow
def test_a_mesh_on_the_truth_has_the_first_colour_and_one_beside_it_the_last() -> None:
    truth = surfaces.disk()
    on = heat_maps.coloured(truth, truth)
    off = heat_maps.coloured(surfaces.moved(truth, (0, 0, 0.05)), truth)
    assert on.rgb is not None
    assert off.rgb is not None
    inner = np.linalg.norm(truth.vertices, axis=1) < 0.4
    assert np.abs(on.rgb[inner].astype(int) - BLUE).max() <= 1
    assert (off.rgb[inner] == RED).all() or (np.linalg.norm(np.ptp(truth.vertices, axis=0)[2]) > 0.05)


@pytest.mark.slow
def test_a_picture_shows_colours_words_and_stays_small(tmp_path: Path) -> None:
    truth = surfaces.disk()
    rows = [[Column("one", "CD 0", heat_maps.coloured(truth, truth)), Column("two", "no mesh", None)]]
    heat_maps.draw(rows, View(0, 60), tmp_path / "figure.png")
    with Image.open(tmp_path / "figure.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    blue = (pixels[..., 2] > pixels[..., 0] + 60).mean()
    assert blue > 0.03, "the disk is drawn in the colour of no error"
    assert (tmp_path / "figure.png").stat().st_size < 300_000


def test_a_glb_holds_every_mesh_beside_the_other_and_a_scale_with_numbers(tmp_path: Path) -> None:
    truth = surfaces.disk()
    columns = [Column("paper", "", heat_maps.plain(truth)), Column("CAP-UDF", "none", None)]
    columns += [Column("truth", "", heat_maps.plain(truth))]
    heat_maps.write_glb(columns, tmp_path / "figure.glb")
    scene = trimesh.load_scene(tmp_path / "figure.glb")
    names = set(scene.graph.nodes_geometry)
    assert names == {"paper", "truth", "scale", *(f"{each} of the longest side" for each in NUMBERS)}
    paper, other = (scene.geometry[scene.graph[name][1]].bounds for name in ("paper", "truth"))
    assert other[0][0] > paper[1][0], "side by side"
    scale = scene.geometry[scene.graph["scale"][1]]
    colours = scale.visual.vertex_colors[:, :3]
    order = np.argsort(scale.vertices[:, 1])
    assert tuple(colours[order[0]]) == BLUE
    assert tuple(colours[order[-1]]) == RED


NUMBERS = ("0", "0.0025", "0.005", "0.0075", "0.01")


def test_every_digit_has_a_shape_of_its_own() -> None:
    shapes = {heat_maps._number(digit, at=(0, 0)).vertices.round(6).tobytes() for digit in "0123456789."}
    assert len(shapes) == 11


# Figures


@pytest.mark.slow
def test_a_figure_draws_what_is_kept_and_names_what_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(paper_figures, "cells", lambda: iter([CELL, replace(CELL, method="cap-udf")]))
    figure = paper_figures.Figure((DISK,), ("cap-udf", "paper"), points=True)
    monkeypatch.setitem(paper_figures.FIGURES, "figure5", figure)
    state = tmp_path / "state"
    (state / "disk-300-paper").mkdir(parents=True)
    keep_mesh(state / "disk-300-paper" / "step-500.npz", surfaces.hemisphere())
    keep_mesh(state / "disk-300-paper" / "step-2000.npz", surfaces.disk())
    keep_mesh(state / "disk-300-standard.npz", surfaces.disk())
    picture, glb = tmp_path / "figure.png", tmp_path / "figure.glb"
    paper_figures.main(["--state", str(state), "--picture", str(picture), "--glb", str(glb)], "figure5")
    lines = capsys.readouterr().out.splitlines()
    assert "| disk, 300 | CAP-UDF | no mesh in --state | | | |" in lines
    ours = next(line for line in lines if "the paper" in line)
    assert "2,000 of 40,000 steps" in ours
    assert float(ours.split("|")[4]) < 0.01, "the latest mesh is the disk, not the hemisphere"
    assert picture.exists()
    assert glb.exists()


@pytest.mark.slow
def test_a_mesh_without_faces_is_told_with_its_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(paper_figures, "cells", lambda: iter([CELL]))
    (tmp_path / "disk-300-paper").mkdir()
    keep_mesh(tmp_path / "disk-300-paper" / "step-500.npz", Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64)))
    keep_mesh(tmp_path / "disk-300-standard.npz", surfaces.disk())
    made = paper_figures.columns(DISK, paper_figures.Figure((DISK,), ("paper",)), tmp_path)
    assert made[0].mesh is None
    assert "no surface after 500 of 40,000 steps" in capsys.readouterr().out


def test_an_opened_room_shows_what_stands_in_it() -> None:
    room = scenes.furnished_room()
    seen = paper_figures.opened(room)
    low, high = room.vertices.min(axis=0), room.vertices.max(axis=0)
    middles = seen.vertices[seen.faces].mean(axis=1)
    assert 0 < len(seen.faces) < len(room.faces)
    assert (middles < high - 0.03 * (high - low)).all()
    assert (middles.min(axis=0) < low + 0.02 * (high - low)).all(), "floor and far walls stay"


def test_an_occluder_hides_what_is_near_it_and_nothing_else() -> None:
    whole = Row("disk", partial(surfaces.disk), points=5_000)
    hidden = replace(whole, occluders=2)
    truth = whole.truth()
    all_points, seen = whole.sampled(truth, 0), hidden.sampled(truth, 0)
    assert 0.8 * len(all_points) < len(seen) < len(all_points)
    gone = all_points[~(all_points[:, None] == seen[None]).all(axis=2).any(axis=1)]
    assert (np.linalg.norm(gone[:, None] - gone[None], axis=2).max(axis=1) < 1.3).all()
    assert "2 occluders" in hidden.label
    assert fingerprint(whole.scan) != fingerprint(hidden.scan)
    assert "occluders" not in whole.scan, "what was measured before stays valid"


@pytest.mark.usefixtures("data_dir")
@pytest.mark.parametrize("row", DEFORMED, ids=lambda row: row.name)
def test_a_deformed_garment_keeps_its_faces_and_its_frame(row: Row) -> None:
    mesh = row.truth()
    assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(1, abs=1e-6)
    areas = np.linalg.norm(np.cross(*(np.diff(mesh.vertices[mesh.faces], axis=1).transpose(1, 0, 2))), axis=1)
    assert np.isfinite(areas).all()


# Extraction


class Sphere(torch.nn.Module):
    """The distance to a sphere."""

    def forward(self, q: torch.Tensor) -> torch.Tensor:
        return (q.norm(dim=1) - 0.4).abs()


def test_the_same_field_is_meshed_from_its_network_and_peers_that_are_missing_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    network = tmp_path / "sphere.pt"
    torch.save(Sphere(), network)
    points = peer_extraction.points_of(peer_extraction.NetworkField(Sphere()))
    assert np.abs(np.linalg.norm(points, axis=1) - 0.4).max() < 1e-3
    subject = peer_extraction.Subject("sphere", network, points, None)
    for variable in ("DCUDF2_FOLDER", "MIND_FOLDER"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(peer_extraction, "subjects", lambda scratch, options: iter([subject]))
    peer_extraction.main(["--cells", "32"])
    lines = capsys.readouterr().out.splitlines()
    assert len({line.count("|") for line in lines}) == 1
    ours = next(line for line in lines if "the product's" in line).split("|")
    assert float(ours[7]) < 2e-3, "on the zero set"
    assert int(ours[9]) == 1
    assert any("DCUDF2 | 32 | no DCUDF2_FOLDER" in line for line in lines)


def test_the_quick_field_is_trained_and_written(tmp_path: Path) -> None:
    subject = peer_extraction.quick(
        tmp_path / "quick.pt", Settings("paper", steps=3, batch=50, changes={"widths": (8,) * 6})
    )
    values, gradients = peer_extraction.NetworkField.read(subject.network)(subject.points[:50])
    assert subject.name == "pleated skirt, 1,000: paper, six layers of 64, 3 steps"
    assert (values >= 0).all()
    assert np.allclose(np.linalg.norm(gradients, axis=1), 1, atol=1e-4)
    assert len(subject.points) == 1_000


@pytest.mark.slow
def test_the_garment_network_of_a_clone_is_written_and_read_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models = tmp_path / "models"
    checkpoints = tmp_path / "experiment" / "out_cloth_batch" / "564" / "checkpoints"
    for folder in (models, checkpoints):
        folder.mkdir(parents=True)
    (models / "embedder.py").write_text("def get_embedder(count):\n    return (lambda x: x * count), 3\n")
    (models / "fields.py").write_text(FIELDS)
    torch.save({"udf_network_fine": {"out.weight": torch.ones(1, 3)}}, checkpoints / "ckpt_080000.pth")
    monkeypatch.delenv("PEERS_PYTHON", raising=False)
    assert peer_extraction._child("dump", str(tmp_path), Path("-"), tmp_path / "garment.pt", Path("-")) == ""
    monkeypatch.syspath_prepend(str(tmp_path))
    values, _ = peer_extraction.NetworkField.read(tmp_path / "garment.pt")(np.array([[0, -0.5, 0], [0.25, 0, 0]]))
    for name in ("models", "models.fields", "models.embedder"):
        monkeypatch.delitem(sys.modules, name)
    assert values.tolist() == [4, 2], "eight frequencies, and never negative"


def test_mind_gets_its_own_number_of_points_a_face_up_to_a_limit() -> None:
    assert [samples_of(cells) for cells in (16, 64, 128, 256)] == [3_906, 62_500, 100_000, 100_000]


@pytest.mark.slow
def test_a_peer_that_dies_is_one_sentence(tmp_path: Path) -> None:
    failed = peer_extraction._child("dcudf2", str(tmp_path), tmp_path / "no.json", tmp_path / "no.pt", tmp_path / "m")
    assert failed
    assert "\n" not in failed


def test_the_network_of_a_cell_comes_back_with_its_weights(tmp_path: Path) -> None:
    network = network_of(CELL.config)
    with torch.no_grad():
        for weight in network.parameters():
            weight.mul_(1.1)
    torch.save(network.state_dict(), tmp_path / "step-500.pt")
    step = peer_extraction.write_network(CELL, (500, tmp_path / "step-500.pt"), tmp_path / "network.pt")
    queries = np.random.default_rng(0).random((50, 3)) - 0.5
    values, gradients = peer_extraction.NetworkField.read(tmp_path / "network.pt")(queries)
    assert step == 500
    assert np.allclose(values, network(torch.from_numpy(queries).float()).detach().numpy(), atol=1e-6)
    assert np.allclose(np.linalg.norm(gradients, axis=1), 1, atol=1e-4)


# Tables


def test_seconds_on_the_wire_are_bytes_over_the_link() -> None:
    way = Way("by hand", 10.0, 2_500_000, 0.5, by_hand=True)
    assert way.sending_s(20) == pytest.approx(1.0)
    lines = list(paper_delivery.table6([way, Way("the product", 10.0, 250_000, 0.01, by_hand=False)]))
    assert len({line.count("|") for line in lines}) == 1
    assert "| 10.0 |" in lines[3]
    assert "and the person's" in lines[2]
    assert "and the person's" not in lines[3]


def test_table_7_names_what_is_not_kept_and_counts_what_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sheet = surfaces.two_sheets()
    monkeypatch.setattr(paper_delivery, "product_mesh", lambda row, state: sheet)
    monkeypatch.setattr(paper_delivery, "import_costs", lambda files: [{"seconds": 0.002} for _ in files])
    cell = next(each for each in published.cells() if (each.row, each.label) == (published.SCENE, "paper"))
    folder = tmp_path / published._folder_name(cell, "cpu")
    folder.mkdir()
    keep_mesh(folder / "step-500.npz", sheet)
    lines = list(paper_delivery.table7(tmp_path))
    assert len({line.count("|") for line in lines}) == 1
    assert any("CAP-UDF | no mesh in --state | 827.62 | – |" in line for line in lines)
    paper = next(line for line in lines if "the paper | 500 of 100,000" in line)
    assert f"| {len(sheet.faces) / 1e3:.2f} |" in paper
    assert sum("LOD" in line for line in lines) == 3


def test_the_estimate_falls_only_beyond_the_budget() -> None:
    assert frame_times.quest_fps(5_000) == frame_times.quest_fps(800_000) == 90
    assert frame_times.quest_fps(2_000_000) == pytest.approx(36)


@pytest.mark.parametrize("name", [*benches.BENCHES, *benches.ON_DEMAND])
def test_every_named_bench_has_a_module(name: str) -> None:
    module, _ = benches._MODULES.get(name, (name.replace("-", "_"), False))
    assert importlib.util.find_spec(f"tests.bench.{module}") is not None
