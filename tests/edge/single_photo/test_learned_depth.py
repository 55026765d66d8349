"""The depth of one photo by a learned model: its shape and size, what is said of it, and when it is left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.arrays import Bools, Floats, no_tick
from capture2vr.edge.capture.nouns import Capture, Photo
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.graph import Graph
from capture2vr.edge.models.nouns import LearnedView
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.points.scale import scale_to_longest
from capture2vr.edge.preset import Preset
from capture2vr.edge.single_photo import learned_front
from capture2vr.edge.single_photo.learned_depth import contradiction
from capture2vr.edge.single_photo.relief import Relief, make_relief
from capture2vr.edge.single_photo.to_points import to_points
from capture2vr.storage.bundle import Bundle
from tests.support.photos.depth_graphs import Seen
from tests.support.photos.mask_graphs import card_of, folder_with, require_onnx, run_here
from tests.support.photos.single_photos import photo

SEEN = Seen(near=0.5, span=0.7, focal=2.0)
H, W = 514, 686  # of a picture that the graph takes as it is
MIDDLE, RADIUS = (400.0, 230.0), 150.0
AWAY = 0.9  # metres to the outline's plane
BUMP = (55.0, -50.0)  # pixels from the middle
SMALL = "moge-2-small"


def heights(x: Floats, y: Floats) -> Floats:
    """Height in pixels over the outline's plane of what is photographed, at pixels from its middle: a ball's cap with
    a bump on one side."""
    away = np.hypot(x, y) / RADIUS
    cap = 0.9 * RADIUS * np.sqrt(np.clip(1 - away**2, 0, None))
    return np.asarray(cap + 45 * np.exp(-((x - BUMP[0]) ** 2 + (y - BUMP[1]) ** 2) / (2 * 30**2)) * (away < 1))


def places() -> tuple[Floats, Floats]:
    x, y = np.meshgrid(np.arange(W) - MIDDLE[0], np.arange(H) - MIDDLE[1])
    return np.asarray(x, np.float64), np.asarray(y, np.float64)


def disc() -> Bools:
    return np.asarray(np.hypot(*places()) < RADIUS)


def depth(tilt: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Depth (H,W) in metres: the object before a wall. tilt: of the outline's plane, pixels deeper per pixel."""
    x, y = places()
    rise = heights(x, y) - tilt[0] * x - tilt[1] * y
    pixel_m = AWAY / SEEN.focal_px((H, W))
    return np.asarray(np.where(disc(), AWAY - rise * pixel_m, AWAY + 0.1))


def taken(seen: Floats | None = None, surface: Bools | None = None, turns: int = 0) -> Photo:
    rgb = np.rot90(SEEN.painted(depth() if seen is None else seen, surface), turns).copy()
    mask = np.rot90(disc(), turns)
    return replace(photo(rgb, turns=turns, name="ball.jpg"), load_mask=lambda: mask)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run graphs in this process: it is quicker."""
    require_onnx()
    monkeypatch.setattr(Graph, "run", lambda self, inputs, tick: run_here(self.file.read_bytes())(inputs, tick))


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: None) -> ModelFolder:
    return folder_with(tmp_path / "models", SEEN.graph(), monkeypatch, SMALL)


def relief_of(models: ModelFolder | None, shown: Photo | None = None) -> Relief:
    return make_relief(shown or taken(), models=models, tick=no_tick)


@cache
def plain() -> Relief:
    """Without a model."""
    return relief_of(None)


def is_right(relief: Relief) -> bool:
    """Whether a relief's front has the object's heights, and its unit the object's metres."""
    front = relief.xyz[relief.xyz[:, 2] > 0.02]
    seen = front[:, :2] / (1 - front[:, 2:] / 4) * 2 * RADIUS  # where the relief's camera, four units away, sees it
    deep = np.hypot(*seen.T) < 0.85 * RADIUS
    true = heights(seen[:, 0], -seen[:, 1])[deep] / (2 * RADIUS)
    metres = 2 * RADIUS * AWAY / SEEN.focal_px((H, W))
    off = np.abs(front[deep, 2] - true)
    return relief.metres is not None and abs(relief.metres / metres - 1) < 0.03 and float(np.quantile(off, 0.98)) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.35, -0.2)])
def test_the_front_has_the_depth_that_the_model_sees_and_the_object_its_size(
    models: ModelFolder, tilt: tuple[float, float]
) -> None:
    relief = relief_of(models, taken(depth(tilt)))
    assert is_right(relief)
    used = UsedBy(SEEN)
    assert relief.models == (used.model,)
    (warning,) = relief.warnings
    assert warning.startswith(
        "The front of the object in ball.jpg has the depth that a learned model sees, MoGe-2 Small"
    )
    assert used.model.sha256[:12] in warning


class UsedBy:
    """The model as a result names it."""

    def __init__(self, seen: Seen) -> None:
        content = seen.graph()
        self.model = Graph(card_of(content, SMALL), Path()).used


@pytest.mark.slow
def test_the_back_stays_the_membrane_and_without_a_model_so_does_the_front(models: ModelFolder) -> None:
    with_model, without = relief_of(models), plain()
    assert not is_right(without)
    assert without.metres is None
    behind = [relief.xyz[relief.xyz[:, 2] < -0.02] for relief in (with_model, without)]
    assert len(behind[0]) == len(behind[1])
    assert np.abs(behind[0] - behind[1]).max() < 1e-6
    outline = [np.ptp(relief.xyz[np.abs(relief.xyz[:, 2]) < 0.02], axis=0)[:2] for relief in (with_model, without)]
    assert np.abs(outline[0] - outline[1]).max() < 0.01


@pytest.mark.slow
def test_the_views_see_the_front_where_it_is(models: ModelFolder) -> None:
    relief = relief_of(models)
    front, back = (view.load_depth_m() for view in relief.views)
    assert 4 - front[front > 0].min() == pytest.approx(relief.xyz[:, 2].max(), abs=0.02)
    assert 4 - back[back > 0].min() == pytest.approx(-relief.xyz[:, 2].min(), abs=0.02)


@pytest.mark.slow
def test_a_photo_that_lies_on_its_side_is_shown_upright_to_the_model(models: ModelFolder) -> None:
    assert is_right(relief_of(models, taken(turns=1)))


Step = Callable[..., Any]
FAULTS: dict[str, Callable[[Step], Step]] = {
    "axes: rows and columns of the depth": lambda step: lambda d, *rest: step(d.T, *rest),
    "axes: mirrored": lambda step: lambda d, *rest: step(d[:, ::-1], *rest),
    "axes: upside down": lambda step: lambda d, *rest: step(d[::-1], *rest),
    "axes: deeper is nearer": lambda step: lambda d, *rest: step(np.where(d > 0, 2 * AWAY - d, 0), *rest),
    "padding: shifted by ten pixels": lambda step: lambda d, *rest: step(np.roll(d, 10, axis=1), *rest),
    "scale: the focal length in the photo's pixels": lambda step: lambda d, f, *rest: step(d, f * 2, *rest),
    "scale: depth in other units": lambda step: lambda d, *rest: step(d * 1.1, *rest),
    "precision: depth in 8 bits of four metres": lambda step: lambda d, *rest: step(np.round(d * 64) / 64, *rest),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_on_the_way_is_noticed(name: str, models: ModelFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    faulty = FAULTS[name](learned_front.learned_front)
    monkeypatch.setattr("capture2vr.edge.single_photo.relief.learned_front", faulty)
    assert not is_right(relief_of(models))


@pytest.mark.slow
def test_without_its_own_plane_something_aslant_would_be_sheared(
    models: ModelFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learned_front, "_plane", lambda seen, rim: np.full(seen.shape, np.median(seen[rim])))
    assert not is_right(relief_of(models, taken(depth((0.35, -0.2)))))


def same_as_without(relief: Relief) -> bool:
    return relief.metres is None and relief.models == () and np.array_equal(relief.xyz, plain().xyz)


LEFT_OUT: dict[str, tuple[Seen, Callable[[], Photo]]] = {
    "its normals are another surface's": (replace(SEEN, facing=0.2), taken),
    "it sees no surface in the object": (SEEN, lambda: taken(surface=~disc())),
    "it sees nothing": (SEEN, lambda: taken(surface=np.zeros((H, W), bool))),
    "the object would be kilometres long": (replace(SEEN, near=5e4, span=7e4, factor=2.5e5), taken),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_cannot_be_is_left_out(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: None) -> None:
    seen, shown = LEFT_OUT[name]
    relief = relief_of(folder_with(tmp_path / "models", seen.graph(), monkeypatch, SMALL), shown())
    assert same_as_without(relief)
    (warning,) = relief.warnings
    assert warning.startswith("MoGe-2 Small, a learned model, is not sure of the depth of the object in ball.jpg")


@pytest.mark.slow
def test_a_photo_goes_on_without_a_model_that_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    relief = relief_of(folder_with(tmp_path / "models", b"another", monkeypatch, SMALL, sha256="0" * 64))
    assert same_as_without(relief)
    (warning,) = relief.warnings
    assert warning.startswith("Depth and size of the object in ball.jpg were guessed without a learned model: MoGe-2")
    assert "is not the one that is known" in warning


@pytest.mark.slow
def test_the_largest_model_that_is_there_is_asked(tmp_path: Path) -> None:
    for file in ("moge-2-base.onnx", "moge-2-small.onnx"):
        (tmp_path / file).write_bytes(b"cut off")
    assert "MoGe-2 Base: its file moge-2-base.onnx is cut off" in relief_of(ModelFolder(tmp_path)).warnings[0]


@pytest.mark.slow
def test_the_size_is_an_estimate_until_a_person_tells_it(models: ModelFolder) -> None:
    capture = Capture("image", "photo", photos=(taken(),))
    points = to_points(capture, models=models)
    assert (points.scale_confidence, points.scale_by_model) == ("estimated", True)
    assert points.warnings[-1].startswith(
        f"A learned model, MoGe-2 Small, estimates that the object in ball.jpg is {points.metres_per_unit:.2g} m long."
    )
    told = to_points(capture, models=models, size_known=True)
    assert len(told.warnings) == len(points.warnings) - 1
    scaled = scale_to_longest(told.subset(np.arange(0, len(told), 50)), 0.25)
    assert (scaled.scale_confidence, scaled.scale_by_model) == ("estimated", False)
    assert scaled.metres_per_unit == pytest.approx(0.25, rel=0.2)  # its outline's longer side is the unit


def test_who_cancels_is_heard_while_the_model_looks(models: ModelFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(self: Graph, inputs: Any, tick: Callable[[float], None]) -> Any:
        tick(0.5)

    def stop(fraction: float) -> None:
        if fraction == pytest.approx(0.45):  # the model's half
            raise Cancelled

    monkeypatch.setattr(Graph, "run", run)
    with pytest.raises(Cancelled):
        make_relief(taken(), models=models, tick=stop)


def slope(across: float, down: float) -> LearnedView:
    """A view of a plane, with its true normals."""
    focal, (height, width) = 300.0, (120, 160)
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    normal = np.array([across, down, -1.0]) / np.linalg.norm([across, down, 1.0])
    seen = -1 / (np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1) @ normal)
    return LearnedView(depth_m=seen, normals=np.broadcast_to(normal, (*seen.shape, 3)), focal_px=focal)


def test_normals_that_are_those_of_the_depth_do_not_contradict_it() -> None:
    view = slope(0.8, -0.3)
    assert view.normals is not None
    assert contradiction(view) < 0.1
    assert contradiction(replace(view, normals=-view.normals)) > 179
    assert contradiction(replace(view, normals=view.normals[..., [1, 0, 2]])) > 45
    assert contradiction(replace(view, normals=view.normals * [-1, -1, 1])) > 45


@pytest.mark.slow
@pytest.mark.essential
def test_the_manifest_names_the_model_and_says_that_the_size_is_its_estimate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_onnx()
    models = folder_with(tmp_path / "models", SEEN.graph(), monkeypatch, SMALL)
    capture = Capture("image", "photo", photos=(taken(),))
    steps = reconstruct(capture, Preset("coarse", resolution=24), resources=JobResources(models=models))
    *_, bundle = (step for step in steps if isinstance(step, Bundle))
    assert bundle.manifest["models"] == [{"name": SMALL, "sha256": UsedBy(SEEN).model.sha256}]
    assert (bundle.manifest["scale_confidence"], bundle.manifest["scale_by_model"]) == ("estimated", True)
    true = 2 * RADIUS * AWAY / SEEN.focal_px((H, W))
    assert max(bundle.manifest["size_m"][:2]) == pytest.approx(true, rel=0.1)
    assert any("estimates that the object" in warning for warning in bundle.manifest["warnings"])
