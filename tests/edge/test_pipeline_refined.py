"""The trained field behind the preview: in order, judged, stopped, and never at the preview's expense."""

from __future__ import annotations

import time
import weakref
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from capture2vr.edge import pipeline
from capture2vr.edge.asset import assemble
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.certificate import Certificate, QualityVerdict
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.field.step import Step
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.paper_field import network_fit as fit_module
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.pipeline import PreviewKept, reconstruct
from capture2vr.edge.preset import Preset, load_preset
from capture2vr.edge.progress import Progress
from capture2vr.edge.training import FieldTraining
from capture2vr.storage.bundle import Bundle
from tests.support.patience import CANCEL_S

pytestmark = [pytest.mark.usefixtures("small_pictures"), pytest.mark.slow]

Said = Progress | Bundle | PreviewKept

TINY = NetworkConfig(warm_start=20, steps=20, warm_up=2, batch=200, pool=5_000, surface=0.1)
TINY_PRESET = Preset("tiny", resolution=32, fit=TINY)


def bowl(points: int = 2000, noise: float = 0.0) -> Capture:
    """The lower half of a unit sphere."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(points, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = -np.abs(direction[:, 2])
    return Capture("points", "ply", Cloud(direction + rng.normal(size=direction.shape) * noise, None))


def bundles(said: list[Said]) -> list[Bundle]:
    return [each for each in said if isinstance(each, Bundle)]


def assert_finished(made: list[Bundle]) -> None:
    """The preview came twice with the same surface, the second time with all that a last bundle has."""
    first, last = made
    assert (first.state, last.state) == ("preview", "preview")
    assert first.files["mesh.ply"] == last.files["mesh.ply"]
    assert last.files.keys() - first.files.keys() == {"turning.webp", "asset.usdz", "points.laz"}


def kept(said: list[Said]) -> PreviewKept:
    (found,) = [each for each in said if isinstance(each, PreviewKept)]
    return found


@pytest.fixture
def perfect(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit that finds the bowl itself."""
    monkeypatch.setattr(fit_module, "fit_network", perfect_fit)


def perfect_fit(xyz_unit: np.ndarray, config: NetworkConfig, **_: Any) -> Iterator[Step]:
    """The field of the sphere that fits the points best (|x|² = 2 c·x + r² − |c|²): for a bowl the exact one."""
    system = np.c_[2 * xyz_unit, np.ones(len(xyz_unit))]
    *centre, rest = np.linalg.lstsq(system, np.square(xyz_unit).sum(axis=1))[0]
    radius = np.sqrt(rest + np.dot(centre, centre))

    def distance(queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        aside = queries - centre
        away = np.linalg.norm(aside, axis=1)
        return np.abs(away - radius), aside / away[:, None] * np.sign(away - radius)[:, None]

    for number in range(1, config.total_steps + 1):
        yield Step(number, config.total_steps, {"total": 1 / number}, distance)


@pytest.fixture(scope="module")
def said() -> list[Said]:
    """All that a reconstruction with a tiny, real training says."""
    inside: list[Said] = []
    for step in reconstruct(bowl(), TINY_PRESET, watch=inside.append):
        inside.append(step)
    return inside


@pytest.mark.essential
def test_a_real_training_goes_through_to_its_verdict(said: list[Said]) -> None:
    assert bundles(said)[0].state == "preview"
    last = [each for each in said if not isinstance(each, Progress)][-1]
    quality = last.manifest["quality"] if isinstance(last, Bundle) else last.quality
    assert quality is not None
    assert quality["verdict"] in {"better", "even", "worse"}
    assert quality["steps"] == TINY.total_steps
    assert quality["preview"] == bundles(said)[0].manifest["quality"]


def test_the_fraction_never_goes_back_and_losses_are_told(said: list[Said]) -> None:
    progress = [each for each in said if isinstance(each, Progress)]
    fractions = [each.fraction for each in progress]
    assert fractions == sorted(fractions)
    assert 0 < fractions[0] < fractions[-1] <= 1
    trained = [each for each in progress if each.losses]
    assert len(trained) >= 2
    assert all(each.stage == "FITTING" for each in trained)
    assert f"step {TINY.total_steps} of {TINY.total_steps}" in trained[-1].message


@pytest.mark.usefixtures("perfect")
def test_the_refined_bundle_follows_the_preview_with_both_certificates() -> None:
    said = list(reconstruct(bowl(noise=0.01), TINY_PRESET))
    preview, refined = bundles(said)
    assert (preview.state, refined.state) == ("preview", "refined")
    assert not [each for each in said if isinstance(each, PreviewKept)]
    quality = refined.manifest["quality"]
    assert quality["verdict"] == "better"
    assert quality["held_out_mean"] < quality["preview"]["held_out_mean"]
    assert quality["preview"] == preview.manifest["quality"]
    assert quality["held_out"] == 40
    assert quality["preset"] == "tiny"
    assert quality["device"] == "cpu"
    assert quality["seconds"] > quality["preview"]["seconds"]
    assert refined.manifest["seconds"]["FITTING"] >= preview.manifest["seconds"]["FITTING"], "rounded to milliseconds"
    # What an engineer's scripts read in the first version of the manifest is there still.
    old = {"resolution", "points_to_mesh_median", "points_to_mesh_p95", "components", "boundary_loops"}
    assert old | {"triangles", "non_manifold_edges"} <= quality.keys()


@pytest.mark.usefixtures("perfect")
def test_held_out_points_are_in_neither_input(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = bowl()
    seen: dict[str, Any] = {}

    def spy(xyz_unit: np.ndarray, config: NetworkConfig, **kwargs: Any) -> Iterator[Step]:
        seen.update(kwargs, xyz=xyz_unit)
        yield from perfect_fit(xyz_unit, config)

    monkeypatch.setattr(fit_module, "fit_network", spy)
    list(reconstruct(capture, replace(TINY_PRESET, fit=replace(TINY, patience=10))))
    assert len(seen["xyz"]) == 2000 - 40 - 40
    assert len(seen["held_out"]) == 40
    together = np.concatenate([seen["xyz"], seen["held_out"]])
    assert len(np.unique(np.round(together, 9), axis=0)) == 2000 - 40


@pytest.mark.parametrize("code", ["FIT_DIVERGED", "FIT_TOO_FEW_POINTS"])
def test_a_failing_fit_keeps_the_preview(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    def fails(*_: Any, **__: Any) -> Iterator[Step]:
        raise EdgeError(code, "the loss is no number", hints=("lower the learning rate",))
        yield

    monkeypatch.setattr(fit_module, "fit_network", fails)
    said = list(reconstruct(bowl(), TINY_PRESET))
    assert_finished(bundles(said))
    assert kept(said).warning == "the preview was kept: the loss is no number (lower the learning rate)"
    assert kept(said).quality is None


def test_a_truly_diverging_fit_keeps_the_preview() -> None:
    said = list(reconstruct(bowl(), replace(TINY_PRESET, fit=replace(TINY, learning_rate=1e6, steps=200))))
    assert_finished(bundles(said))
    assert kept(said).warning.startswith("the preview was kept: ")


def test_memory_that_does_not_suffice_keeps_the_preview(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> Iterator[Step]:
        raise MemoryError
        yield

    monkeypatch.setattr(fit_module, "fit_network", fails)
    said = list(reconstruct(bowl(), TINY_PRESET))
    assert_finished(bundles(said))
    assert "memory" in kept(said).warning


def test_memory_that_does_not_suffice_for_textures_either(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: Any, **__: Any) -> Iterator[Step]:
        raise MemoryError
        yield

    monkeypatch.setattr(fit_module, "fit_network", fails)
    monkeypatch.setattr(assemble, "add_textures", fails_at_once)
    said = list(reconstruct(bowl(), TINY_PRESET))
    assert [bundle.last for bundle in bundles(said)] == [False]
    assert "memory" in kept(said).warning


def fails_at_once(*_: Any, **__: Any) -> None:
    raise MemoryError


def test_a_full_gpu_halves_the_batch_then_trains_on_the_cpu(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    tried = []
    checkpoint = tmp_path / "fit.checkpoint"

    def fails_on_a_gpu(xyz_unit: np.ndarray, config: NetworkConfig, *, device: str, **_: Any) -> Iterator[Step]:
        tried.append((device, config.batch, checkpoint.exists()))
        checkpoint.touch()
        if device != "cpu":
            raise EdgeError("GPU_OOM", "the GPU is full")
        yield from perfect_fit(xyz_unit, config)

    monkeypatch.setattr(fit_module, "fit_network", fails_on_a_gpu)
    said = list(reconstruct(bowl(noise=0.01), TINY_PRESET, resources=JobResources("cuda:0", checkpoint)))
    assert tried == [("cuda:0", 200, False), ("cuda:0", 100, False), ("cpu", 100, False)]
    refined = bundles(said)[-1].manifest
    assert refined["quality"]["device"] == "cpu"
    assert "the GPU is full; the batch was halved" in refined["warnings"]
    assert "the GPU is full; the field was trained on the CPU" in refined["warnings"]
    fractions = [each.fraction for each in said if isinstance(each, Progress)]
    assert fractions == sorted(fractions)


def test_a_step_down_finds_the_memory_of_the_failed_try_free(monkeypatch: pytest.MonkeyPatch) -> None:
    filled: list[weakref.ref[np.ndarray]] = []
    alive: list[int] = []

    def fills_a_gpu(xyz_unit: np.ndarray, config: NetworkConfig, *, device: str, **_: Any) -> Iterator[Step]:
        alive.append(sum(each() is not None for each in filled))
        tensors = np.zeros(1000)
        filled.append(weakref.ref(tensors))
        if device != "cpu":
            raise EdgeError("GPU_OOM", "the GPU is full")
        yield from perfect_fit(xyz_unit, config)

    monkeypatch.setattr(fit_module, "fit_network", fills_a_gpu)
    list(reconstruct(bowl(), TINY_PRESET, resources=JobResources("cuda:0")))
    assert alive == [0, 0, 0]


def test_anchors_know_no_batch_and_step_down_to_the_cpu_at_once() -> None:
    config = AnchorConfig()
    nothing = np.empty((0, 3))
    training = FieldTraining(nothing, None, config, "cuda:0", lambda q: (q[:, 0], q), nothing, nothing)
    smaller = training.with_less_memory()
    assert smaller is not None
    assert (smaller[0].device, smaller[0].config) == ("cpu", config)
    assert smaller[0].with_less_memory() is None


def test_a_full_gpu_halves_the_batch_after_the_densification_too() -> None:
    config = load_preset("cap-udf").fit
    assert isinstance(config, NetworkConfig)
    nothing = np.empty((0, 3))
    training = FieldTraining(nothing, None, config, "cuda:0", lambda q: (q[:, 0], q), nothing, nothing)
    smaller = training.with_less_memory()
    assert smaller is not None
    halved = smaller[0].config
    assert isinstance(halved, NetworkConfig)
    assert halved.densify is not None
    assert (halved.batch, halved.densify.batch) == (2_500, 10_000)


@pytest.mark.usefixtures("perfect")
def test_a_worse_surface_is_refused_with_its_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    def worse(preview: Certificate, refined: Certificate) -> QualityVerdict:
        return QualityVerdict("worse", "it lies farther")

    monkeypatch.setattr(pipeline, "compare", worse)
    said = list(reconstruct(bowl(), TINY_PRESET))
    assert_finished(bundles(said))
    refused = kept(said)
    assert refused.warning == "the preview was kept: it lies farther"
    assert refused.quality is not None
    assert refused.quality["verdict"] == "worse"
    assert refused.quality["held_out"] == 40


def test_a_training_can_be_stopped_at_once() -> None:
    steps = reconstruct(bowl(), replace(TINY_PRESET, fit=replace(TINY, steps=1_000_000)))
    for step in steps:
        if isinstance(step, Progress) and step.losses:
            break
    began = time.monotonic()
    next(steps)
    steps.close()
    assert time.monotonic() - began < CANCEL_S


def test_a_cloud_too_small_to_spare_points_is_judged_by_all_and_says_so() -> None:
    *_, last = reconstruct(bowl(300), replace(TINY_PRESET, fit=replace(TINY, patience=5)))
    quality = last.manifest["quality"] if isinstance(last, Bundle) else last.quality
    assert quality is not None
    assert quality["held_out"] == 0
    assert "input points" in quality["because"]


def test_the_choice_is_told_with_its_reason() -> None:
    (chosen,) = bundles(list(reconstruct(bowl(120), Preset("auto", resolution=24))))
    assert chosen.manifest["preset"] == "draft"
    assert "too few" in chosen.manifest["preset_because"]
    assert chosen.manifest["quality"]["resolution"] == 24


@pytest.mark.usefixtures("perfect")
def test_only_what_nothing_follows_gets_textures() -> None:
    """A preview is looked at at once: it does not wait for a picture that the refined one brings."""
    printed = bowl(8_000)
    assert printed.cloud is not None
    odd = np.floor(printed.cloud.xyz * 6).astype(int).sum(axis=1) % 2 == 1
    rgb = np.where(odd[:, None], 255, 0).repeat(3, axis=1).astype(np.uint8)
    said = list(reconstruct(replace(printed, cloud=replace(printed.cloud, rgb=rgb)), TINY_PRESET))
    preview, refined = bundles(said)
    assert [bundle.manifest["lods"][0]["texture_bytes"] > 0 for bundle in (preview, refined)] == [False, True]


def test_a_method_of_the_literature_publishes_its_own_mesh_whatever_the_verdict(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def beside(xyz_unit: np.ndarray, config: NetworkConfig, **_: Any) -> Iterator[Step]:
        yield from perfect_fit(xyz_unit + np.array([0, 0, 0.04]), config)

    monkeypatch.setattr(fit_module, "fit_network", beside)
    said = list(reconstruct(bowl(), replace(TINY_PRESET, literature=True)))
    preview, refined = bundles(said)
    assert not [each for each in said if isinstance(each, PreviewKept)]
    assert (refined.state, refined.manifest["quality"]["verdict"]) == ("refined", "worse")
    assert refined.files["mesh.ply"] != preview.files["mesh.ply"]
    assert any("this method's mesh is worse than the preview was" in each for each in refined.manifest["warnings"])


@pytest.mark.usefixtures("perfect")
def test_the_published_extraction_goes_through_as_it_comes() -> None:
    said = list(reconstruct(bowl(), replace(TINY_PRESET, literature=True, extraction="published")))
    refined = bundles(said)[-1]
    assert refined.state == "refined"
    mesh = trimesh.load_mesh(BytesIO(refined.files["mesh.ply"]), file_type="ply", process=False)
    assert refined.manifest["quality"]["components"] > 200, "the cells' triangles are not joined"
    assert len(mesh.vertices) > 0.8 * len(mesh.faces)
    assert {"lod0.glb", "lod1.glb", "lod2.glb"} <= refined.files.keys()
