"""`capture2vr run` on one photo: with a rectangle, and where nothing stands out."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.local.test_run import capture2vr
from tests.support.photos.generators import boxes, boxes_glb, generator, glb, photo_of
from tests.support.photos.walkaround import render_walkaround

pytestmark = pytest.mark.slow

PROPOSED = 1  # of the rendered photos, one before whose table nothing stands out
BRIEFLY = ("--preset", "draft", "--resolution", "40")


def report(out: Path) -> dict[str, object]:
    return dict(json.loads((out / "report.json").read_text()))


def test_the_rectangle_says_which_thing_is_made(tmp_path: Path) -> None:
    rgb = np.full((300, 400, 3), 215, np.uint8)
    for middle, colour in ((110, (180, 40, 30)), (290, (30, 60, 170))):
        cv2.circle(rgb, (middle, 150), 60, colour, cv2.FILLED)
    cv2.imwrite(str(tmp_path / "discs.png"), rgb[..., ::-1])
    result = capture2vr("run", "discs.png", "-o", "out", "--box", "0.55,0.2,0.95,0.8", *BRIEFLY, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "Nothing stands out" not in result.stderr
    red, _, blue = np.array(report(tmp_path / "out")["anchors"]["rgb"]).reshape(-1, 3).mean(axis=0)  # type: ignore[index]
    assert blue > red + 50


def test_the_setting_of_a_worker_names_the_models_of_a_run_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rgb = np.full((300, 400, 3), 215, np.uint8)
    cv2.circle(rgb, (200, 150), 60, (180, 40, 30), cv2.FILLED)
    cv2.imwrite(str(tmp_path / "disc.png"), rgb)
    monkeypatch.setenv("EDGE_MODELS", str(tmp_path / "gone"))
    result = capture2vr("run", "disc.png", "-o", "out", *BRIEFLY, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "without a learned model" in result.stderr
    assert report(tmp_path / "out")["models"] == []


def test_a_generator_of_the_setting_makes_it_up_and_the_result_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rgb, mask = photo_of(boxes(), 300)
    cv2.imwrite(str(tmp_path / "boxes.png"), np.dstack([rgb[..., ::-1], np.where(mask, 255, 0)]).astype(np.uint8))
    asked = ("run", "boxes.png", "-o", "out", "--preset", "generate", "--resolution", "40")
    refused = capture2vr(*asked, cwd=tmp_path)
    assert refused.returncode != 0
    assert "EDGE_GENERATOR" in refused.stderr
    assert not (tmp_path / "out").exists()
    with generator(glb(boxes_glb(turn=120))) as stub:
        monkeypatch.setenv("EDGE_GENERATOR", stub.url)
        result = capture2vr(*asked, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "Generated: a generator made this shape up" in result.stdout + result.stderr
    assert report(tmp_path / "out")["origin"] == "generated"
    assert "<b>Generated: a generator" in (tmp_path / "out" / "report.html").read_text()


def test_a_proposal_is_told_with_its_rectangle_and_what_to_do(tmp_path: Path) -> None:
    photo = render_walkaround(tmp_path / "walk", views=4, size=(480, 360)).photos[PROPOSED]
    result = capture2vr("run", photo, "-o", tmp_path / "out", *BRIEFLY, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    (warning,) = (each for each in report(tmp_path / "out")["warnings"] if "stands out" in each)  # type: ignore[attr-defined]
    assert photo.name in warning
    assert "in the rectangle 0." in warning
    assert "(--box)" in warning
    assert "--box" in result.stderr
