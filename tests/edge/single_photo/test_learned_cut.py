"""The cut of one photo by a learned model: when it decides, what is said of it, and that a photo goes on without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.jobs.inspection_work import inspect
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.isnet import SIDE
from capture2vr.edge.models.nouns import UsedModel
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import Preset
from capture2vr.edge.single_photo.cutout import CutOut, cut_out
from capture2vr.order.photo_box import PhotoBox
from capture2vr.storage.bundle import Bundle
from tests.support.photos.mask_graphs import card_of, constant_mask, folder_with, not_finite, require_onnx
from tests.support.photos.single_photos import photo

H, W = 240, 320
BOX = PhotoBox(0.05, 0.2, 0.45, 0.8)


def disc(middle: tuple[float, float], radius: float, shape: tuple[int, int] = (H, W)) -> Bools:
    """A disc, as shares of the picture's width and height."""
    y, x = ((np.arange(side) + 0.5) / side for side in shape)
    return np.asarray(np.hypot(x[None] - middle[0], (y[:, None] - middle[1]) * H / W) < radius)


def two_discs() -> Bytes:
    """A wall with a red disc on the left, which stands out as well as the blue one on the right."""
    rgb = np.full((H, W, 3), 215, np.uint8)
    rgb[disc((0.25, 0.5), 0.15)] = 180, 40, 30
    rgb[disc((0.75, 0.5), 0.15)] = 30, 60, 170
    return rgb


BLUE = disc((0.75, 0.5), 0.15)


def overlap(one: Bools, other: Bools) -> float:
    return float((one & other).sum() / max(1, (one | other).sum()))


def sees(mask: Bools | Floats) -> bytes:
    return constant_mask(mask.astype(np.float32))


BLUE_SEEN = disc((0.75, 0.5), 0.15, (SIDE, SIDE))


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModelFolder:
    """A model that sees the blue disc in every photo."""
    require_onnx()
    return folder_with(tmp_path / "models", sees(BLUE_SEEN), monkeypatch)


@pytest.fixture
def unused(tmp_path: Path) -> ModelFolder:
    """A folder that would be complained of if it were looked into."""
    return ModelFolder(tmp_path / "gone")


@pytest.mark.slow
@pytest.mark.essential
def test_the_model_decides_where_nobody_has_said_what_is_meant(models: ModelFolder) -> None:
    cut = cut_out(photo(two_discs(), name="two.jpg"), None, models=models)
    assert overlap(cut.mask, BLUE) > 0.97
    used = UsedModel("isnet", card_of(sees(BLUE_SEEN)).sha256)
    assert cut.models == (used,)
    (warning,) = cut.warnings
    assert warning.startswith(
        f"The object in two.jpg was cut out by a learned model, IS-Net (file {used.sha256[:12]})."
    )


@pytest.mark.slow
def test_a_photo_that_lies_on_its_side_is_shown_upright_to_the_model(models: ModelFolder) -> None:
    cut = cut_out(photo(np.rot90(two_discs()).copy(), turns=1), None, models=models)
    assert overlap(cut.mask, BLUE) > 0.97


@pytest.mark.slow
def test_a_rectangle_of_nearly_everything_is_none(models: ModelFolder) -> None:
    area = PhotoBox(0, 0, 1, 0.99)
    cut = cut_out(photo(two_discs()), area, models=models)
    assert cut.models
    assert cut.area == area


@pytest.mark.parametrize("said", ["rectangle", "alpha", "mask"])
def test_what_somebody_has_said_is_not_asked_of_the_model(said: str, unused: ModelFolder) -> None:
    taken, box = photo(two_discs()), BOX if said == "rectangle" else None
    if said == "alpha":
        taken = replace(taken, load_alpha=lambda: np.where(BLUE, 255, 0).astype(np.uint8))
    if said == "mask":
        taken = replace(taken, load_mask=lambda: BLUE)
    cut = cut_out(taken, box, models=unused)
    assert (cut.warnings, cut.models) == ((), ())


def same_as_without(cut: CutOut, rgb: Bytes) -> bool:
    return bool((cut.mask == cut_out(photo(rgb)).mask).all()) and cut.models == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "mask",
    [
        np.zeros((SIDE, SIDE), bool),
        0.6 * disc((0.75, 0.5), 0.15, (SIDE, SIDE)),
        np.ones((SIDE, SIDE), bool),
        disc((0.5, 0.5), 0.02, (SIDE, SIDE)),
        disc((0.5, 0.5), 0.53, (SIDE, SIDE)),
    ],
    ids=["nothing", "unsure", "everything", "a speck", "cut off on all sides"],
)
def test_a_mask_that_is_no_whole_object_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mask: Bools | Floats
) -> None:
    require_onnx()
    models = folder_with(tmp_path / "models", sees(mask), monkeypatch)
    cut = cut_out(photo(two_discs(), name="two.jpg"), None, models=models)
    assert same_as_without(cut, two_discs())
    (warning,) = cut.warnings
    assert warning.startswith("IS-Net, a learned model, is not sure of an object that lies whole in two.jpg")


def not_the_file(folder: Path, patch: pytest.MonkeyPatch) -> ModelFolder:
    return folder_with(folder, b"another", patch, sha256="0" * 64)


def no_folder(folder: Path, _: pytest.MonkeyPatch) -> ModelFolder:
    return ModelFolder(folder)


def no_runtime(folder: Path, patch: pytest.MonkeyPatch) -> ModelFolder:
    patch.setattr("capture2vr.edge.models.graph.find_spec", lambda name: None)
    return folder_with(folder, b"never read", patch)


FAULTS: dict[str, tuple[Callable[[Path, pytest.MonkeyPatch], ModelFolder], str]] = {
    "another file": (not_the_file, "is not the one that is known"),
    "no folder": (no_folder, "EDGE_MODELS"),
    "no runtime": (no_runtime, "capture2vr[models]"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_photo_goes_on_without_a_model_that_cannot_be_used(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, words = FAULTS[name]
    cut = cut_out(photo(two_discs(), name="two.jpg"), None, models=make(tmp_path / "models", monkeypatch))
    assert same_as_without(cut, two_discs())
    (warning,) = cut.warnings
    assert warning.startswith("The object in two.jpg was cut out without a learned model: ")
    assert words in warning


@pytest.mark.slow
def test_a_photo_goes_on_without_a_model_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require_onnx()
    cut = cut_out(photo(two_discs()), None, models=folder_with(tmp_path / "models", not_finite(), monkeypatch))
    assert same_as_without(cut, two_discs())
    assert "numbers that are not finite" in cut.warnings[0]


def test_where_nothing_else_finds_the_object_the_error_says_why_the_model_did_not(unused: ModelFolder) -> None:
    with pytest.raises(CaptureError) as caught:
        cut_out(photo(np.full((H, W, 3), 90, np.uint8)), None, models=unused)
    assert caught.value.code == "CAPTURE_NO_OBJECT"
    assert "without a learned model" in caught.value.hints[-1]


@pytest.mark.slow
def test_who_cancels_is_heard_while_the_model_runs(models: ModelFolder) -> None:
    def stop(_: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        cut_out(photo(two_discs()), models=models, tick=stop)


@pytest.mark.slow
def test_the_outline_before_the_job_is_the_model_s_too(models: ModelFolder, tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    folder.mkdir()
    cv2.imwrite(str(folder / "two.png"), two_discs()[..., ::-1])
    told = inspect(folder, None, models)
    (line,) = told.outline
    assert min(line.xy[::2]) > 0.5  # the blue disc, on the right
    assert "IS-Net" in told.warnings[-1]


@pytest.mark.slow
def test_the_manifest_names_the_model_and_its_version(models: ModelFolder) -> None:
    capture = Capture("image", "photo", photos=(photo(two_discs()),))
    steps = reconstruct(capture, Preset("coarse", resolution=24), resources=JobResources(models=models))
    *_, bundle = (step for step in steps if isinstance(step, Bundle))
    assert bundle.manifest["models"] == [{"name": "isnet", "sha256": card_of(sees(BLUE_SEEN)).sha256}]
    assert any("IS-Net" in warning for warning in bundle.manifest["warnings"])
