"""`capture2vr run --cut`: the report says what was kept, shows both, and asks about a large part that was removed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from typer.testing import CliRunner

from capture2vr.cli.local.report import _UP_SOURCES
from capture2vr.cli.main import app
from capture2vr.edge.capture.nouns import UpTeller

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_pictures")]


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A cloud: a red ball on a table, and a green one of half as many points beside it."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(3_000, 3))
    balls = 0.1 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0.1, 0]
    balls[2_000:] += [0.35, 0, 0]
    table = np.column_stack([rng.uniform(-0.5, 0.5, 5_000), np.zeros(5_000), rng.uniform(-0.5, 0.5, 5_000)])
    xyz = np.concatenate([balls, table]) + rng.normal(0, 5e-4, (8_000, 3))
    rgb = np.repeat([[200, 40, 40], [40, 200, 40], [150, 120, 90]], [2_000, 1_000, 5_000], axis=0)
    path = tmp_path / "pair.xyz"
    np.savetxt(path, np.column_stack([xyz, rgb]), fmt=["%.5f"] * 3 + ["%d"] * 3)
    return path


def run(capture: Path, out: Path, cut: str) -> tuple[dict[str, Any], str]:
    """Report and page of a run."""
    arguments = ["run", str(capture), "-o", str(out), "--preset", "draft", "--resolution", "32", "--cut", cut]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    return json.loads((out / "report.json").read_text()), (out / "report.html").read_text()


def test_the_report_shows_both_cuts_and_the_next_run_the_other(pair: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    report, page = run(pair, out, "object")
    assert max(report["size_m"]) == pytest.approx(0.2, abs=0.03)
    cut = report["capture"]["cut"]
    assert (cut["kept"], cut["removed"]) == ("object", pytest.approx(0.5, abs=0.03))
    assert cut["doubt"] in page
    assert page.count('alt="cut-') == 2
    assert "--cut scene" in page
    assert {path.name for path in out.glob("cut-*.jpg")} == {"cut-object.jpg", "cut-scene.jpg"}
    assert not [path for path in (out / "bundle").rglob("*") if "cut-" in path.name], "surroundings are not published"

    report, page = run(pair, out, "scene")
    assert max(report["size_m"]) > 0.9
    assert report["capture"]["cut"]["kept"] == "scene"
    assert "everything was asked for" in page
    assert not list(out.glob("cut-*.jpg"))


def test_a_cloud_is_left_as_it_is_without_the_option(pair: Path, tmp_path: Path) -> None:
    report, page = run(pair, tmp_path / "out", "auto")
    assert report["capture"]["cut"] == {
        "kept": "scene",
        "because": "a cloud is taken as it is",
        "doubt": "",
        "removed": 0,
    }
    assert 'alt="cut-' not in page


def test_the_report_tells_what_told_up() -> None:
    assert set(_UP_SOURCES) == set(get_args(UpTeller)), "every source has a sentence"


def test_a_cut_that_does_not_exist_is_refused(pair: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["run", str(pair), "-o", str(tmp_path / "out"), "--cut", "half"])
    assert done.exit_code == 2
