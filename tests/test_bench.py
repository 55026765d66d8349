"""The benches: rows are what they say, loaders read the papers' layouts, records keep, tables count honestly."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from capture2vr.edge.errors import EdgeError
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.mesh.topology import component_count
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from tests.bench import cell, datasets, methods, plots, report, yardstick
from tests.bench.__main__ import main as bench_main
from tests.bench.datasets import LayoutError
from tests.bench.methods import Settings, Unavailable
from tests.bench.paper import ablation, tables
from tests.bench.records import Record, Records, code_version, fingerprint
from tests.bench.shapes import ROWS, Row
from tests.support import surfaces
from tests.support.mesh_metrics import welded

FIGURES = {
    "chamfer_l1": 0.003,
    "chamfer_l2": 2e-5,
    "f_005": 0.9,
    "f_010": 0.99,
    "normal_consistency": 0.98,
    "components": 1,
    "boundary_loops": 2,
    "boundary_error": 0.01,
    "non_manifold_edges": 0,
    "area_ratio": 1.0,
    "floor": 0.0025,
    "floor_f_005": 0.95,
    "seconds": 1.5,
    "peak_mb": 300.0,
    "consistency": None,
}
CLEAN = Row("sheet", surfaces.smooth_sheet, points=500)
NOISY = replace(CLEAN, noise=0.004)


# Shapes


def test_every_row_has_a_label_of_its_own() -> None:
    assert len({row.label for row in ROWS}) == len(ROWS)


def test_density_falls_along_the_longest_side() -> None:
    sheet = surfaces.smooth_sheet()
    xyz = surfaces.sampled(sheet, 20_000, uneven=20)
    axis = int(np.argmax(np.ptp(sheet.vertices, axis=0)))
    dense, thin = (xyz[:, axis] < -0.4).sum(), (xyz[:, axis] > 0.4).sum()
    # Means over the outer tenths, of which the densities at the very ends differ twenty times.
    assert dense / thin == pytest.approx(20**0.9, rel=0.15)
    assert len(xyz) == 20_000


def test_half_a_surface_ends_in_a_clean_cut() -> None:
    half = welded(surfaces.half(surfaces.disk()))
    assert np.ptp(half.vertices, axis=0).max() == pytest.approx(1)
    edges = edges_of(half.faces)
    border = edges.border_ends
    assert component_count(border) == 1
    # A half disk of diameter d is bordered by d(1 + π/2) and has the area πd²/8, in whatever frame.
    length = np.linalg.norm(half.vertices[border[:, 0]] - half.vertices[border[:, 1]], axis=1).sum()
    assert length**2 / area(half) == pytest.approx(8 * (1 + np.pi / 2) ** 2 / np.pi, rel=0.01)


def test_nested_bowls_lie_their_distance_apart() -> None:
    bowls = surfaces.nested_bowls(0.06)
    outer, inner = np.split(bowls.vertices, 2)
    np.testing.assert_allclose(np.linalg.norm(outer - inner, axis=1), 0.06, atol=1e-9)
    assert component_count(edges_of(welded(bowls).faces).ends) == 2


# Methods and cells


def test_a_shortened_schedule_keeps_its_proportions() -> None:
    config = NetworkConfig(steps=40_000, warm_up=1_000, densify=Densify(steps=20_000), patience=7)
    short = methods.shortened(config, Settings("cap-udf", steps=600, batch=100, seed=3))
    assert (short.steps, short.densify and short.densify.steps, short.warm_up) == (400, 200, 10)
    assert (short.batch, short.densify and short.densify.batch, short.seed, short.patience) == (100, 100, 3, 0)
    assert short.loss_steps == 600


def test_no_steps_leave_the_published_ones_and_changes_come_through() -> None:
    short = methods.shortened(NetworkConfig(), Settings("paper", changes={"projection": 0.0}))
    assert (short.steps, short.batch, short.projection) == (40_000, 5_000, 0.0)


@pytest.mark.slow
def test_a_cell_measures_the_pipeline_in_a_process_of_its_own() -> None:
    truth = surfaces.hemisphere()
    figures = cell.run_cell(surfaces.sampled(truth, 2_000), truth, Settings("draft", resolution=48), timeout_s=120)
    assert figures["chamfer_l1"] < 1.5 * figures["floor"]
    assert figures["components"] == figures["boundary_loops"] == 1
    assert figures["boundary_error"] < 0.02
    assert 50 < figures["peak_mb"] < 2_000
    assert figures["seconds"] > 0


@pytest.mark.slow
def test_a_cell_names_what_failed() -> None:
    truth = surfaces.hemisphere()
    figures = cell.run_cell(np.zeros((50, 3)), truth, Settings("draft"), timeout_s=120)
    assert "CAPTURE_" in figures["failed"]


@pytest.mark.slow
def test_a_baseline_is_fitted_to_the_points_as_measured_and_changed_as_asked() -> None:
    points = surfaces.sampled(surfaces.hemisphere(), 300)
    settings = Settings("paper", steps=4, batch=50, changes={"widths": (8,) * 6, "pool": 3_000})
    seen, distance = methods.fitted(points, settings)
    np.testing.assert_array_equal(seen, points)
    f, gradient = distance(points)
    assert f.shape == (300,)
    assert gradient.shape == (300, 3)


def test_the_local_field_has_no_fit_to_run() -> None:
    with pytest.raises(ValueError, match="trains nothing"):
        methods.fitted(np.zeros((10, 3)), Settings("draft"))


def test_a_peer_that_is_not_installed_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPEN3D_PYTHON", "/bin/false")
    with pytest.raises(Unavailable, match="OPEN3D_PYTHON"):
        methods.peer(np.zeros((10, 3)), "poisson")


def test_a_peer_that_fails_says_its_last_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python = tmp_path / "python"
    python.write_text('#!/bin/sh\n[ "$1" = -c ] && exit 0\necho "RuntimeError: initial simplex is flat" >&2\nexit 1\n')
    python.chmod(0o755)
    monkeypatch.setenv("OPEN3D_PYTHON", str(python))
    with pytest.raises(EdgeError, match="simplex is flat"):
        methods.peer(np.zeros((10, 3)), "poisson")


def test_a_truth_of_points_tells_distances_and_no_more() -> None:
    sheet = surfaces.disk()
    dense = Mesh(surfaces.sampled(sheet, 50_000), np.empty((0, 3), np.int64))
    figures = cell.figures_of(surfaces.moved(sheet, (0, 0, 0.05)), dense)
    assert figures["chamfer_l1"] == pytest.approx(0.05, rel=0.02)
    assert figures["components"] == 1
    assert figures["normal_consistency"] is figures["floor"] is figures["boundary_error"] is None


# Records


def test_records_keep_the_last_of_each_key(tmp_path: Path) -> None:
    records = Records(tmp_path / "kept.json")
    records.add(Record("a", "draft", {"steps": 1}, "1", {"seconds": 1.0}))
    records.add(Record("a", "draft", {"steps": 2}, "1", {"seconds": 2.0}))
    Records(tmp_path / "kept.json").add(Record("a", "draft", {"steps": 1}, "2", {"seconds": 3.0}))
    kept = records.all()
    assert [record.figures["seconds"] for record in kept.values()] == [3.0, 2.0]
    assert [file.name for file in tmp_path.iterdir()] == ["kept.json"]
    assert len((tmp_path / "kept.json").read_text().splitlines()) == 4  # one a line: a change of one is a line's


def test_a_fingerprint_tells_settings_apart_and_not_their_order() -> None:
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1}) != fingerprint({"a": 1, "b": 3})


# Tables and plot


def _grid(standard: float, rival: float, row: Row = CLEAN) -> report.Grid:
    cells = {"standard": standard, "poisson": rival}
    records = {
        (row.label, method): Record(row.label, method, {}, code_version(method), {**FIGURES, "chamfer_l1": value})
        for method, value in cells.items()
    }
    return report.Grid([row], {"standard": "standard", "poisson": "screened Poisson"}, records, "standard")


@pytest.mark.parametrize(
    ("row", "own", "said"),
    [
        (CLEAN, 0.0029, "best on 1 of 1 rows"),
        (CLEAN, 0.00308, "within 3% of the best on 1 clean ones, behind on 0"),
        (NOISY, 0.00308, "within 3% of the best on 0 clean ones, behind on 1"),
        (CLEAN, 0.0032, "behind on 1"),
    ],
)
def test_wins_ties_and_losses_are_counted(row: Row, own: float, said: str) -> None:
    assert said in report.verdicts(_grid(own, 0.003, row))[0]


def test_a_loss_names_the_row_and_the_rival() -> None:
    assert f"{CLEAN.label}: 10.0% behind screened Poisson" in report.verdicts(_grid(0.0033, 0.003))[1]


def test_other_presets_of_the_product_are_rivals_of_their_own() -> None:
    grid = _grid(0.0029, 0.003, NOISY)
    fine = Record(NOISY.label, "fine", {}, "", {**FIGURES, "chamfer_l1": 0.0028})
    grid = replace(grid, heads={**grid.heads, "fine": "fine"}, records={**grid.records, (NOISY.label, "fine"): fine})
    said = "\n".join(report.verdicts(grid))
    assert "Chamfer-L1 against other methods: standard is best on 1 of 1 rows" in said
    assert f"{NOISY.label}: 3.6% behind fine" in said


def test_the_best_cell_is_bold_and_other_code_is_marked() -> None:
    grid = _grid(0.0029, 0.003)
    old = replace(grid.records[CLEAN.label, "standard"], version="0.0.0+other")
    told = report.everything(replace(grid, records={**grid.records, (CLEAN.label, "standard"): old}))
    assert "| 0.00250/0.950 | **0.00290/0.900** \\* | 0.00300/0.900 |" in told


def test_a_kept_preview_is_marked() -> None:
    grid = _grid(0.0029, 0.003)
    own = grid.records[CLEAN.label, "standard"]
    own = replace(own, figures={**own.figures, "remarks": ["the preview was kept: farther from the points"]})
    told = report.everything(replace(grid, records={**grid.records, (CLEAN.label, "standard"): own}))
    assert "| **0.00290/0.900**† | 0.00300/0.900 |" in told


def test_missing_failed_and_borderless_cells_have_their_signs() -> None:
    grid = _grid(0.0029, 0.003)
    failed = replace(grid.records[CLEAN.label, "poisson"], figures={"failed": "FIT_DIVERGED: at step 3"})
    closed = replace(grid.records[CLEAN.label, "standard"], figures={**FIGURES, "boundary_error": "inf"})
    told = report.everything(
        replace(grid, records={(CLEAN.label, "poisson"): failed, (CLEAN.label, "standard"): closed})
    )
    assert "| **∞/1.000** | — |" in told
    assert f"| {CLEAN.label} | 1/1/0 | **1/2/0** | — |" in told
    assert "screened Poisson failed: FIT_DIVERGED: at step 3" in told


def test_the_plot_is_drawn(tmp_path: Path) -> None:
    plots.heat(_grid(0.0029, 0.003), tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5_000


def test_only_missing_cells_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def measured(points: object, truth: Mesh, settings: Settings, timeout: float) -> dict[str, object]:
        asked.append(settings.method)
        return FIGURES

    monkeypatch.setattr(yardstick, "run_cell", measured)
    options = yardstick._parser().parse_args([])
    records = Records(tmp_path / "kept.json")
    for _ in range(2):
        yardstick.measure([CLEAN], ["draft", "cap-udf"], options, records)
    assert asked == ["draft", "cap-udf"]
    longer = yardstick._parser().parse_args(["--steps", "7"])
    yardstick.measure([CLEAN], ["draft", "cap-udf"], longer, records)
    assert asked == ["draft", "cap-udf", "cap-udf"]
    steps = [record.settings["steps"] for record in records.all().values()]
    assert steps == [0, yardstick.STEPS, 7]


@pytest.mark.usefixtures("data_dir")
def test_cells_of_older_code_are_taken_over_only_if_a_sample_comes_out_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = dict(FIGURES)
    monkeypatch.setattr(yardstick, "run_cell", lambda *given: answer | {"seconds": 99.0})
    options = yardstick._parser().parse_args(["--adopt", "2"])
    records = Records(tmp_path / "kept.json")
    for row in ROWS[:3]:
        key = yardstick._key(row, yardstick._settings(row, "draft", options))
        records.add(Record(row.label, "draft", key, "older", FIGURES))
    answer["chamfer_l1"] = FIGURES["chamfer_l1"] + 1e-5
    yardstick.adopt(ROWS[:3], ["draft"], options, records)
    assert {record.version for record in records.all().values()} == {"older"}
    answer["chamfer_l1"] = FIGURES["chamfer_l1"]
    yardstick.adopt(ROWS[:3], ["draft"], options, records)
    assert {record.version for record in records.all().values()} == {code_version("draft")}
    assert {record.figures["seconds"] for record in records.all().values()} == {FIGURES["seconds"]}


def test_every_loss_of_a_preset_is_ablated_and_none_that_it_lacks() -> None:
    names = dict(ablation.variants(NetworkConfig(surface=0.0, self_consistency=1e-2, far_share=0.0)))
    assert names["as it is"] == {}
    assert names["without L_sc"] == {"self_consistency": 0.0}
    assert "without L_surf" not in names
    assert "without far queries" not in names
    assert set(names) >= {"with L_surf, τ_f = 0.1", "τ_s = 0.001", "τ_s = 0.1"}


# The papers' data


def _write(mesh: Mesh, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file)


def _cloud(xyz: np.ndarray, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    trimesh.PointCloud(xyz).export(file)


def loaded(entries: list[datasets.Entry]) -> list[datasets.Subject]:
    return [entry.load() for entry in entries]


def test_cars_as_cap_udf_lays_them_out(tmp_path: Path) -> None:
    car = surfaces.hemisphere()
    points = surfaces.sampled(car, 300)
    _write(car, tmp_path / "ground_truth" / "3e5e4ff6.obj")
    _cloud(points, tmp_path / "input" / "3e5e4ff6.ply")
    (tmp_path / "query_data").mkdir()
    (subject,) = loaded(datasets.shapenet(tmp_path))
    assert subject.name == "3e5e4ff6"
    np.testing.assert_allclose(subject.points, points, atol=1e-6)
    assert area(subject.truth) == pytest.approx(area(car), rel=1e-4)


@pytest.mark.slow
def test_cars_as_ndf_lays_them_out(tmp_path: Path) -> None:
    car = surfaces.disk()
    points = surfaces.sampled(car, 200)
    for name in ("1a", "2b"):
        _write(car, tmp_path / "02958343" / name / "model_scaled.off")
    np.savez(tmp_path / "02958343" / "1a" / "voxelized_point_cloud_256res_200points.npz", point_cloud=points, res=256)
    entries = datasets.shapenet(tmp_path, points=150)
    assert [entry.group for entry in entries] == ["car", "car"]
    with_points, without = loaded(entries)
    np.testing.assert_array_equal(with_points.points, points)
    assert (with_points.name, without.name, without.points.shape) == ("1a", "2b", (150, 3))


@pytest.mark.parametrize("file", ["models/model_normalized.obj", "model.obj"])
def test_shapes_as_shapenet_lays_them_out_have_the_class_of_their_synset(tmp_path: Path, file: str) -> None:
    for synset in ("02958343", "03001627", "12345678"):
        _write(surfaces.disk(), tmp_path / synset / "1a" / file)
    entries = datasets.shapenet(tmp_path, points=50)
    assert [(entry.name, entry.group) for entry in entries] == [("1a", "car"), ("1a", "chair"), ("1a", "12345678")]
    assert [subject.points.shape for subject in loaded(entries)] == [(50, 3)] * 3


@pytest.mark.parametrize("suffix", [".xyz.npy", ".npy", ".xyz"])
def test_scenes_find_their_truth_by_the_name_before_the_density(tmp_path: Path, suffix: str) -> None:
    room = Mesh(surfaces.disk().vertices * 4, surfaces.disk().faces)
    points = surfaces.sampled(room, 100)
    _write(room, tmp_path / "ground_truth" / "lounge.ply")
    file = tmp_path / "input" / f"lounge_1000{suffix}"
    file.parent.mkdir()
    if suffix.endswith("npy"):
        np.save(file, points)
    else:
        np.savetxt(file, points)
    (subject,) = loaded(datasets.scenes(tmp_path))
    assert subject.name == "lounge_1000"
    np.testing.assert_allclose(subject.points, points, atol=1e-6)
    assert area(subject.truth) == pytest.approx(16 * area(surfaces.disk()), rel=1e-4)


def test_bare_scans_are_sampled_by_the_square_metre(tmp_path: Path) -> None:
    room = Mesh(surfaces.disk().vertices * 4, surfaces.disk().faces)
    _write(room, tmp_path / "copyroom" / "copyroom.ply")
    (subject,) = loaded(datasets.scenes(tmp_path, per_square_metre=100))
    assert len(subject.points) == pytest.approx(100 * area(room), abs=2)


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["point_cloud", "deep_fashion_3d_point_cloud"])
def test_garments_come_in_the_unit_frame_in_the_order_of_their_numbers(tmp_path: Path, folder: str) -> None:
    dress = Mesh(surfaces.pleated_skirt().vertices * 180 + 40, surfaces.pleated_skirt().faces)  # centimetres
    for stem in ("10-1", "2-1"):
        _cloud(surfaces.sampled(dress, 3_000), tmp_path / folder / stem.split("-")[0] / f"{stem}.ply")
    _write(dress, tmp_path / "filtered_registered_mesh" / "2-1" / "model_cleaned.obj")
    meshed, dense = loaded(datasets.deep_fashion(tmp_path, points=500))
    assert (meshed.name, dense.name) == ("2-1", "10-1")
    assert len(meshed.truth.faces) > 0
    assert (len(dense.truth.faces), len(dense.truth.vertices)) == (0, 3_000)
    for subject in (meshed, dense):
        assert np.ptp(subject.truth.vertices, axis=0).max() == pytest.approx(1, rel=1e-3)
        assert len(subject.points) == 500
        assert np.abs(subject.points).max() < 0.51


@pytest.mark.parametrize("load", [datasets.shapenet, datasets.scenes, datasets.deep_fashion])
def test_another_folder_is_refused_with_what_was_looked_for(tmp_path: Path, load: object) -> None:
    with pytest.raises(LayoutError, match=r"holds no .*\*|holds no point_cloud"):
        load(tmp_path)  # type: ignore[operator]


def test_points_without_a_truth_are_refused_by_name(tmp_path: Path) -> None:
    _write(surfaces.disk(), tmp_path / "ground_truth" / "lounge.ply")
    _cloud(np.eye(3), tmp_path / "input" / "copyroom_1000.ply")
    with pytest.raises(LayoutError, match=r"copyroom_1000.*lounge"):
        datasets.scenes(tmp_path)


def test_table_2_runs_on_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def measured(points: object, truth: Mesh, settings: Settings, timeout: float) -> dict[str, object]:
        if settings.method == "poisson":
            raise Unavailable("no Open3D")
        return {"failed": "x"} if settings.method == "cap-udf" else FIGURES

    monkeypatch.setattr(tables, "run_cell", measured)
    for name in ("1a", "2b"):
        _write(surfaces.hemisphere(), tmp_path / "ground_truth" / f"{name}.obj")
        _cloud(surfaces.sampled(surfaces.hemisphere(), 100), tmp_path / "input" / f"{name}.ply")
    tables.main(["--shapenet", str(tmp_path), "--methods", "draft,poisson,cap-udf"])
    printed = capsys.readouterr().out
    assert "| local field | 0.00300 | 20 | 0.9000 | 0.9900 | 0.980 | — | 1.5 | 300 | 2 of 2 |" in printed
    assert "| screened Poisson | — no Open3D |" in printed
    assert "| CAP-UDF | " + "— | " * 8 + "0 of 2 |" in printed
    assert "| floor | 0.00250 | | 0.9500 |" in printed


def test_classes_are_tables_of_their_own_and_what_is_missing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "run_cell", lambda *_: FIGURES)
    for garment in (1, 2, 7):
        _cloud(surfaces.sampled(surfaces.disk(), 50), tmp_path / "point_cloud" / f"{garment}" / f"{garment}-1.ply")
    (tmp_path / "point_cloud" / "2" / "2-1.ply").write_bytes(b"ply\nno")
    classes = "long_sleeve_dress 1 2\nshort_pants 7\nno_sleeve_upper 8 9\n"
    (tmp_path / "point_cloud" / "cloth_type_list.txt").write_text(classes)
    tables.main(["--garments", str(tmp_path), "--methods", "draft"])
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if line.startswith("###")] == [
        "### Table 2: DeepFashion3D, long_sleeve_dress",
        "### Table 2: DeepFashion3D, short_pants",
    ]
    assert printed.count("| 1 of 1 |") == 2, "what was measured stays"
    assert "Not measured: 2-1 cannot be read: " in printed
    assert f"Not measured: class no_sleeve_upper, none of whose 2 garments is in {tmp_path}" in printed


def test_a_list_of_classes_that_is_none_is_named_with_its_line(tmp_path: Path) -> None:
    _cloud(np.eye(3), tmp_path / "point_cloud" / "1" / "1-1.ply")
    (tmp_path / "cloth_type_list.txt").write_text("dress 1\n1: dress\n")
    with pytest.raises(LayoutError, match=r"cloth_type_list.txt, line 2: a class and numbers"):
        datasets.deep_fashion(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["figure5"], "dress-v17k-f34k.obj is missing: CAPTURE2VR_DATA names the folder"),
        (["tables", "--scenes", "nowhere"], "tables: nowhere holds no ground_truth"),
    ],
)
def test_missing_data_are_one_sentence(
    arguments: list[str], sentence: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CAPTURE2VR_DATA", str(tmp_path))
    with pytest.raises(SystemExit, match=re.escape(sentence)) as caught:
        bench_main(arguments)
    assert "\n" not in str(caught.value)


def test_tables_need_a_folder() -> None:
    with pytest.raises(SystemExit, match="--scenes DIR"):
        tables.main([])


def test_the_committed_records_are_of_rows_that_exist() -> None:
    stored = json.loads(yardstick.STORED.read_text())["records"] if yardstick.STORED.exists() else []
    labels = {row.label for row in ROWS}
    assert {record["row"] for record in stored} <= labels
