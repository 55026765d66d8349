"""The bench of published methods: cells resume, keep what they reached, and tables tell how far each came."""

from __future__ import annotations

import errno
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.field import checkpoint
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from tests.bench import published
from tests.bench.paper import paper_tables
from tests.bench.published import Cell, cells, run_cell
from tests.bench.records import Records, record_of
from tests.bench.shapes import Row
from tests.support import surfaces

QUICK = NetworkConfig(steps=12, warm_up=2, batch=100, pool=3_000, densify=Densify(steps=4, batch=50, field_below=1.0))
CELL = Cell(Row("disk", partial(surfaces.disk), points=300, resolution=24), "paper", QUICK)


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(published, "STORED", tmp_path / "published.json")
    monkeypatch.setattr(published, "MEASURED_AT", (5, 10))
    monkeypatch.setattr(checkpoint, "SECONDS", 0.0)
    return tmp_path


def curve(stored: Path) -> list[dict[str, Any]]:
    return published.curve_of(CELL, Records(stored / "published.json").all())


@pytest.mark.slow
def test_a_cell_measures_on_its_way_and_goes_on_where_the_hours_ended(stored: Path) -> None:
    run_cell(CELL, stored / "state", until=0.0, device="cpu")
    assert [each["step"] for each in curve(stored)] == [1], "the time was over with the first step"
    run_cell(CELL, stored / "state", until=time.time() + 600, device="cpu")
    reached = curve(stored)
    assert [each["step"] for each in reached] == [1, 5, 10, 16]
    # 12 steps of 100 queries, then 4 of 50.
    assert [each["queries"] for each in reached] == [100, 500, 1_000, 1_400]
    seconds = [each["seconds"] for each in reached]
    assert seconds == sorted(seconds)
    kept = sorted(path.name for path in (stored / "state" / "disk-300-paper-100-queries").glob("step-*.pt"))
    assert kept == ["step-1.pt", "step-10.pt", "step-16.pt", "step-5.pt"]
    step, mesh = published.mesh_reached(CELL, stored / "state") or (0, None)
    assert step == 16
    assert mesh is not None
    assert len(mesh.faces) > 0
    run_cell(CELL, stored / "state", until=time.time() + 600, device="cpu")
    assert curve(stored) == reached, "a cell that has ended measures nothing again"


@pytest.mark.slow
def test_a_full_disk_is_one_sentence_and_what_was_measured_stays(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(published, "cells", lambda: iter([CELL]))
    arguments = ["--cell", "0", "--state", str(stored / "state"), "--until"]
    published.main([*arguments, "0"])
    before = curve(stored)

    def full(path: Path, *_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(checkpoint, "save", full)
    with pytest.raises(SystemExit, match=r"^disk, 300: paper, 100 queries: No space left on device: .*fit.pt; what"):
        published.main([*arguments, str(time.time() + 600)])
    assert curve(stored) == before
    assert [each["step"] for each in before] == [1]


@pytest.mark.slow
def test_a_cell_that_fails_is_named_and_the_others_go_on(
    stored: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The processes of their own know the real cells alone: a folder that is a file makes each of them fail."""
    labels = [f"{cell.row.label}: {cell.label}" for cell in cells() if "pleated" in cell.row.label]
    for label in labels:
        (stored / label.replace(": ", " ").replace(" ", "-").replace(",", "")).write_text("")
    with pytest.raises(SystemExit) as ended:
        published.main(["--rows", "pleated", "--state", str(stored), "--hours", "0.1"])
    assert all(label in str(ended.value) for label in labels)
    assert capfd.readouterr().err.count("File exists") == len(labels)


def test_no_cell_keeps_the_others_waiting_longer_than_told(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[float] = []

    class Ended:
        """A process that has ended."""

        returncode = 0

        def __init__(self, command: list[str], **_: object) -> None:
            ends.append(float(command[command.index("--until") + 1]))

        def poll(self) -> int:
            return 0

    monkeypatch.setattr(published.subprocess, "Popen", Ended)
    monkeypatch.setattr(published, "draw", lambda records: None)
    monkeypatch.setattr(published, "measure_product", lambda row, records: None)
    began = time.time()
    published.main(["--rows", "lounge, 108,088", "--state", str(stored), "--hours", "2", "--cell-minutes", "3"])
    assert len(ends) == 4
    assert all(began + 175 < each < time.time() + 185 for each in ends)


@pytest.mark.slow
def test_the_product_is_measured_once_on_a_scene(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = Row("lounge", partial(surfaces.disk), points=300, resolution=24)
    monkeypatch.setattr(published, "OWN", "draft")
    records = Records(stored / "published.json")
    with monkeypatch.context() as slow:
        slow.setattr(published, "_OWN_TIMEOUT_S", 0.01)
        published.measure_product(room, records)
    assert "failed" in next(iter(records.all().values())).figures
    published.measure_product(room, records)
    (record,) = records.all().values()
    assert (record.row, record.method) == (room.label, "draft")
    assert record.figures["chamfer_l1"] < 0.1
    monkeypatch.setattr(published, "run_yardstick_cell", None)
    published.measure_product(room, records)
    assert list(records.all().values()) == [record]


def test_what_a_gpu_reached_stands_beside_what_a_cpu_did(stored: Path) -> None:
    cell = next(iter(cells()))
    records = Records(stored / "published.json")
    for device, step in (("cuda", 40_000), ("cpu", 500)):
        records.add(record_of(cell.row.label, cell.label, cell.settings(device), {"curve": [{"step": step}]}))
    assert published.curve_of(cell, records.all()) == [{"step": 40_000}]
    assert published.curve_on("cpu", cell, records.all()) == [{"step": 500}]


def test_every_row_has_every_method_at_its_published_steps() -> None:
    steps = {(cell.row.name, cell.row.noise, cell.label): cell.config.loss_steps for cell in cells()}
    assert steps["dress", 0, "paper"] == steps["dress", 0, "paper, 5,000 queries"] == 40_000
    assert steps["truck", 0.006, "cap-udf"] == 60_000
    assert steps["pleated skirt", 0, "levelset-udf"] == 40_000
    assert steps["lounge", 0, "paper"] == steps["lounge", 0, "paper-no-self"] == 100_000
    scene = next(cell for cell in cells() if (cell.row.name, cell.method) == ("lounge", "levelset-udf")).config
    assert (scene.projection, scene.surface, scene.orthogonality) == (0.001, 0.01, 0.0001)
    named = {(cell.row.label, cell.label) for cell in cells()}
    assert len(named) == len(list(cells()))


@pytest.mark.usefixtures("data_dir")
@pytest.mark.parametrize("row", [published.DRESS, published.TRUCK], ids=lambda row: row.name)
def test_the_areas_of_the_objects_are_those_of_their_meshes(row: Row) -> None:
    assert area(row.truth()) == pytest.approx(published.AREA_M2[row.name], rel=1e-4)


def test_every_density_is_trained_with_and_without_the_loss_and_has_a_unit() -> None:
    found = {(cell.row.name, cell.row.points, cell.method) for cell in cells() if cell.metres}
    for name, points in (("dress", 2_492), ("truck", 2_734), ("lounge", 108_088)):
        for factor in (1, 10):
            near = {each[2] for each in found if each[0] == name and each[1] == pytest.approx(factor * points, abs=5)}
            assert {"paper", "paper-no-self"} <= near
    room = [cell for cell in cells() if cell.row == published.DENSE_SCENE]
    assert {cell.method for cell in room} == {"paper", "paper-no-self", "cap-udf", "levelset-udf"}
    assert all(cell.metres == pytest.approx(5) for cell in room), "the room is five metres long"


def test_the_lounge_has_a_thousand_points_per_square_metre() -> None:
    room = published.lounge()
    points = surfaces.sampled(room, 5_000)
    assert np.abs(points).max() == pytest.approx(0.5, abs=1e-6)
    # 92.8 m² of walls, floor and ceiling, and the furniture.
    assert published.SCENE.points == pytest.approx(1_000 * 108, rel=0.01)


@pytest.mark.parametrize("table", paper_tables.TABLES)
def test_a_table_tells_how_far_a_method_came_and_why_one_is_missing(
    table: str, stored: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half = {"step": 20_000, "queries": 2e7, "seconds": 60.0, "chamfer_l1": 0.0042, "floor": 0.0025, "floor_f_005": 0.95}
    whole = {**half, "step": 100_000, "chamfer_l1": 0.0043, "chamfer_l2": 3e-6, "gpu_mb": 398}
    records = Records(stored / "published.json")
    thin = published.by_density(published.DRESS, 1_000)
    reached = {(published.DRESS, "paper"): half, (thin, "paper"): half, (published.SCENE, "paper"): whole}
    for cell in cells():
        if (cell.row, cell.label) in reached:
            figures = {"curve": [reached[cell.row, cell.label]]}
            records.add(record_of(cell.row.label, cell.label, cell.settings("cpu"), figures))
    for scene, chamfer in ((published.SCENE, 0.0032), (published.DENSE_SCENE, 0.0031)):
        records.add(record_of(scene.label, "standard", {}, {"chamfer_l1": chamfer, "consistency": 0.0123}))
    paper_tables.main([], table)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in lines}) == 1, "every line has every column"
    expected = {
        "table2": ["| the paper | 20,000 of 40,000 | 0.00158 | 0.00420 |", "| no public code |"],
        "table3": [
            "| the paper | 100,000 | 0.00260 | 0.00430 |",
            "| the paper | 0 of 100,000 | – | – |",
            "| the product | – | – | 0.00320 |",
            "| the product | – | – | 0.00310 |",
            "| no public code |",
        ],
        "table4": [
            "| dress | 1,000 | with | 20,000 of 40,000 | 0.00160 | 0.00420 | 0.00250 | 2.1–3.2 | – | – |",
            "| dress | 10,000 | without | 0 of 40,000 | 0.01251 | – | – | 6.1–7.8 | – | – |",
            "| lounge | 1,000 | with | 100,000 | – | 0.00430 | 0.00250 | – | 398 | – |",
            "| lounge | 10,000 | with | 0 of 100,000 | – | – | – | – | – | – |",
        ],
    }
    assert all(any(part in line for line in lines) for part in expected[table])
