"""The whole method on closed-form surfaces: it stands at the other end, in the right frame, and can be stopped."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from PIL import Image

from capture2vr.edge.arrays import Tick
from capture2vr.edge.asset.target import TARGETS, Target
from capture2vr.edge.capture.nouns import Capture, Cloud, Frame, Intrinsics
from capture2vr.edge.capture_to_points import STARTS
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.export.ktx2 import Ktx2Encoder, Ktx2Error, Ktx2Header
from capture2vr.edge.export.ply import stored_origin
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.origin import FILLED
from capture2vr.edge.pipeline import PREVIEW_STARTS, reconstruct
from capture2vr.edge.preset import Preset, load_preset
from capture2vr.edge.progress import Progress
from capture2vr.edge.splats.spz import from_spz
from capture2vr.edge.splats.surface_splats import Splats
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.bundle import Bundle
from tests.referees.glb_reader import Glb
from tests.referees.ktx2.encoder import ktx2  # noqa: F401 - a fixture is used by its name

pytestmark = [pytest.mark.usefixtures("small_pictures"), pytest.mark.slow]

COARSE = Preset("coarse", resolution=32)


def _bowl(points: int = 5000, *, radius: float = 1.0, centre: float = 0.0) -> Capture:
    direction = np.random.default_rng(0).normal(size=(points, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = -np.abs(direction[:, 2])
    rgb = ((direction * 0.5 + 0.5) * 255).astype(np.uint8)
    up = np.array([0.0, 0.0, 1.0])
    return Capture("points", "ply", Cloud(direction * radius + centre, rgb), scale_confidence="metric", up=up)


@pytest.fixture(scope="module")
def steps() -> list[Progress | Bundle]:
    """All that one reconstruction says."""
    inside: list[Progress | Bundle] = []
    for step in reconstruct(_bowl(), load_preset("draft"), JobOptions(names=AssetNames("Bowl")), watch=inside.append):
        inside.append(step)
    return inside


def test_the_fraction_never_goes_back(steps: list[Progress | Bundle]) -> None:
    fractions = [step.fraction for step in steps if isinstance(step, Progress)]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] < fractions[-1] <= 1


def test_stages_come_in_order_and_say_what_they_do(steps: list[Progress | Bundle]) -> None:
    stages = list(dict.fromkeys(step.stage for step in steps if isinstance(step, Progress)))
    assert stages == [stage for stage in {**STARTS, **PREVIEW_STARTS} if stage in stages]
    assert {"POINT_CLOUD", "FITTING", "EXTRACTING", "PACKING"} <= set(stages)


@pytest.mark.essential
def test_the_bundle_holds_an_open_bowl_standing_upright(steps: list[Progress | Bundle]) -> None:
    (bundle,) = [step for step in steps if isinstance(step, Bundle)]
    assert bundle.state == "preview"
    manifest = bundle.manifest
    assert manifest["label"] == "Bowl"
    assert manifest["quality"]["components"] == 1
    assert manifest["quality"]["boundary_loops"] == 1
    assert manifest["quality"]["non_manifold_edges"] == 0
    assert manifest["size_m"] == pytest.approx([2, 1, 2], abs=0.08)
    glb = Glb.of(bundle.files["lod0.glb"])
    assert len(glb.faces) == manifest["lods"][0]["triangles"]
    # The bowl's bottom touches the floor, its rim is up.
    assert np.linalg.norm(glb.positions - [0, 1, 0], axis=1) == pytest.approx(1, abs=0.05)


def test_an_asset_proves_that_it_keeps_within_its_target() -> None:
    *_, bundle = reconstruct(_bowl(), load_preset("draft"), JobOptions(target="quest3"))
    assert bundle.manifest["target"] == "quest3"
    for level, most in zip(bundle.manifest["lods"], (100_000, 25_000, 5_000), strict=True):
        assert level["bytes"] == len(bundle.files[level["file"]])
        assert (level["draw_calls"], level["texture_bytes"]) == (1, 0)
        assert 0 < level["triangles"] <= most
        assert 0 < level["vertices"] < level["unpacked_bytes"] < 40 << 20
    assert bundle.manifest["lods"][2]["bytes"] <= 300_000


def _printed(points: int = 15_000) -> Capture:
    """The bowl with a checkerboard finer than a coarse mesh."""
    bowl = _bowl(points)
    assert bowl.cloud is not None
    odd = np.floor(bowl.cloud.xyz * 6).astype(int).sum(axis=1) % 2 == 1
    rgb = np.where(odd[:, None], (210, 40, 40), (40, 60, 200)).astype(np.uint8)
    return replace(bowl, cloud=Cloud(bowl.cloud.xyz, rgb))


def test_what_the_points_know_more_of_than_the_vertices_comes_as_a_texture() -> None:
    *_, bundle = reconstruct(_printed(), COARSE, JobOptions(target="quest3"))
    levels = bundle.manifest["lods"]
    assert all(level["texture_bytes"] > 0 for level in levels)
    assert levels[2]["bytes"] <= 300_000
    assert bundle.manifest["warnings"] == []
    glb = Glb.of(bundle.files["lod0.glb"])
    picture = np.asarray(Image.open(io.BytesIO(glb.image))).astype(int)
    at = np.floor(glb.uv * len(picture)).astype(int).clip(0, len(picture) - 1)
    # The asset stands on the floor, Y up: x stays, the capture's z is y - 1, and its y is -z.
    capture = np.stack([glb.positions[:, 0], -glb.positions[:, 2], glb.positions[:, 1] - 1], axis=1)
    inner = (np.abs((capture * 6 + 0.5) % 1 - 0.5) > 0.2).all(axis=1)
    odd = np.floor(capture * 6).astype(int).sum(axis=1) % 2 == 1
    red = picture[at[:, 1], at[:, 0], 0] > 125
    assert inner.sum() > 100
    assert (red == odd)[inner].mean() > 0.95


def test_textures_come_as_ktx2_where_that_is_asked_for(
    ktx2: Ktx2Encoder,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(TARGETS, "web", replace(TARGETS["web"], texture_px=128))
    preset, options = Preset("coarse", resolution=16), JobOptions(target="web-ktx2")
    *_, bundle = reconstruct(_printed(5_000), preset, options, JobResources(encode=ktx2))
    assert bundle.manifest["target"] == "web-ktx2"
    assert bundle.manifest["lods"][2]["bytes"] <= 150_000
    for level in bundle.manifest["lods"]:
        header = Ktx2Header.of(Glb.of(bundle.files[level["file"]]).image)
        assert level["texture_bytes"] == header.device_bytes
        assert header.width**2 < level["texture_bytes"] < 1.4 * header.width**2
    assert b"colour.jpg" in bundle.files["asset.usdz"]


def test_ktx2_without_an_encoder_is_refused_before_any_work() -> None:
    steps = reconstruct(_printed(5_000), Preset("coarse", resolution=16), JobOptions(target="quest3-ktx2"))
    with pytest.raises(EdgeError) as caught:
        next(steps)
    assert caught.value.code == "KTX2_UNAVAILABLE"


def test_an_encoder_alone_changes_nothing() -> None:
    def fails(picture: np.ndarray, tick: Tick) -> bytes:
        raise AssertionError("nothing is encoded here")

    *_, bundle = reconstruct(_printed(5_000), Preset("coarse", resolution=16), resources=JobResources(encode=fails))
    assert bundle.state == "preview"


def test_ktx2_that_cannot_be_made_is_an_error_behind_the_preview() -> None:
    def fails(picture: np.ndarray, tick: Tick) -> bytes:
        raise Ktx2Error("ktx2-encoder ended with status 1")

    preset, options = Preset("coarse", resolution=16), JobOptions(target="quest3-ktx2")
    steps = reconstruct(_printed(5_000), preset, options, JobResources(encode=fails))
    bundle = next(step for step in steps if isinstance(step, Bundle))
    assert bundle.state == "preview"
    assert [level["texture_bytes"] for level in bundle.manifest["lods"]] == [0, 0, 0]
    assert "COLOR_0" in Glb.of(bundle.files["lod0.glb"]).primitive["attributes"]
    with pytest.raises(Ktx2Error, match="status 1"):
        next(steps)


def test_a_budget_out_of_reach_is_an_error_behind_the_preview(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TARGETS, "watch", Target("watch", "", (2_000, 1_000), last_bytes=99))
    steps = reconstruct(_bowl(), COARSE, JobOptions(target="watch"))
    bundle = next(step for step in steps if isinstance(step, Bundle))
    assert bundle.state == "preview"
    with pytest.raises(EdgeError, match="LOD 1 has") as caught:
        next(steps)
    assert caught.value.code == "BUDGET_UNREACHABLE"


def test_an_archive_is_for_any_program_and_leaves_no_triangle_out() -> None:
    *_, bundle = reconstruct(_bowl(), COARSE, JobOptions(target="archive"))
    glb = trimesh.load(io.BytesIO(bundle.files["lod0.glb"]), file_type="glb", force="mesh")
    full = trimesh.load(io.BytesIO(bundle.files["mesh.ply"]), file_type="ply")
    assert len(glb.faces) >= 0.99 * len(full.faces)
    assert "extensionsUsed" not in Glb.of(bundle.files["lod0.glb"]).document


def test_a_georeferenced_cloud_keeps_its_place_and_precision() -> None:
    capture = _bowl(radius=2.0, centre=1e6)
    *_, bundle = reconstruct(capture, load_preset("draft"))
    mesh = trimesh.load(io.BytesIO(bundle.files["mesh.ply"]), file_type="ply")
    assert np.linalg.norm(mesh.vertices - 1e6, axis=1) == pytest.approx(2, abs=0.2)


def test_the_resolution_of_a_preset_is_obeyed() -> None:
    *_, coarse = reconstruct(_bowl(), COARSE)
    *_, fine = reconstruct(_bowl(), Preset("fine", resolution=72))
    assert coarse.manifest["quality"]["resolution"] == 32
    assert fine.manifest["quality"]["triangles"] > 4 * coarse.manifest["quality"]["triangles"]


@pytest.mark.parametrize("stage", ["POINT_CLOUD", "EXTRACTING", "TEXTURING", "PACKING"])
def test_it_stops_where_it_is_told_to(stage: str) -> None:
    def stop(progress: Progress) -> None:
        if progress.stage == stage:
            raise Cancelled

    with pytest.raises(Cancelled):
        list(reconstruct(_bowl(), COARSE, watch=stop))


def _striped_sheet(hole: str, frames: int = 20) -> Capture:
    """Depth images of a striped sheet, 0.9 m wide, from above and a little from the sides; beyond it nothing is known.

    hole: what is seen in a circle of 6 cm in its middle: "dark", its stripes without depth; "open", a wall 60 cm behind
    it; "sky", a colour that is all around the sheet too, without depth.
    """
    side, away = 96, 1.0
    camera = Intrinsics(side, side, side / 2 - 0.5, side / 2 - 0.5, side, side)
    made = []
    for shift in np.linspace(-0.2, 0.2, frames):
        x, y = np.meshgrid((np.arange(side) - camera.cx) / side + shift, (np.arange(side) - camera.cy) / side)
        on = (np.abs(x) < 0.45) & (np.abs(y) < 0.45)
        depth = np.where(on, away, 0).astype(np.float32)
        depth[np.hypot(x, y) < 0.03] = 1.6 if hole == "open" else 0
        fine = (np.arange(4 * side) + 0.5) / (4 * side) - 0.5 + shift
        stripes = np.where((np.sin(40 * fine) > 0)[:, None], (230, 60, 40), (40, 60, 200)).astype(np.uint8)
        rgb = np.tile(stripes, (4 * side, 1, 1))
        x, y = np.meshgrid(fine, fine - shift)
        if hole == "sky":
            rgb[(np.hypot(x, y) < 0.03) | (np.maximum(abs(x), abs(y)) > 0.45)] = 170, 225, 140
        pose = np.eye(4)
        pose[0, 3] = shift
        made.append(Frame(f"{len(made)}.png", camera, pose, partial(np.copy, depth), None, partial(np.copy, rgb)))
    return Capture("rgbd", "frames", frames=tuple(made), scale_confidence="metric", up=np.array([0.0, -1.0, 0.0]))


@pytest.fixture(scope="module")
def sheet_bundles() -> list[Bundle]:
    made = reconstruct(_striped_sheet("dark"), Preset("coarse", resolution=96, splat_steps=3))
    return [step for step in made if isinstance(step, Bundle)]


def test_a_mesh_without_textures_is_there_before_the_one_with_photos(sheet_bundles: list[Bundle]) -> None:
    plain, textured = sheet_bundles
    assert plain.state == textured.state == "preview"
    assert [level["texture_bytes"] for level in plain.manifest["lods"]] == [0, 0, 0]
    assert textured.manifest["lods"][0]["texture_bytes"] > 0
    assert plain.files["mesh.ply"] == textured.files["mesh.ply"]


def test_held_out_pictures_stand_in_the_certificate_and_never_among_the_files(sheet_bundles: list[Bundle]) -> None:
    plain, textured = (bundle.manifest["quality"]["photos"] for bundle in sheet_bundles)
    assert (plain["cover"], plain["psnr"]) == (textured["cover"], None)  # the textures come later
    first, last = (bundle.manifest["quality"]["grade"] for bundle in sheet_bundles)
    assert first == last is not None, "what is held back is so from the draft on"
    assert textured["photos"] == 2
    assert textured["cover"] > 0.85
    assert textured["lace"] < 0.02
    assert textured["psnr"] > 15
    assert list(sheet_bundles[-1].private) == ["photo-1.jpg", "photo-2.jpg", "origin.png"]
    assert not set(sheet_bundles[-1].files) & set(sheet_bundles[-1].private)


def test_what_no_depth_shows_is_filled_and_marked_unless_that_is_not_wanted(sheet_bundles: list[Bundle]) -> None:
    shares = sheet_bundles[-1].manifest["quality"]["origins"]
    assert shares["filled"] == pytest.approx(np.pi * 0.03**2 / 0.9**2, rel=0.8)
    assert sum(shares.values()) == pytest.approx(1)
    mesh = trimesh.load(io.BytesIO(sheet_bundles[-1].files["mesh.ply"]), file_type="ply", process=False)
    marked = stored_origin(mesh) == FILLED
    assert marked.any()
    off = np.linalg.norm(mesh.vertices[marked] - [0, 0, 1], axis=1)
    assert off.max() < 0.06
    *_, kept = reconstruct(_striped_sheet("dark"), Preset("coarse", resolution=96), JobOptions(fill="none"))
    assert isinstance(kept, Bundle)
    assert kept.manifest["quality"]["origins"]["filled"] == 0
    assert b"property uchar origin" not in kept.files["mesh.ply"][:400]


def test_splats_are_trained_on_the_photos_where_the_preset_says_so(sheet_bundles: list[Bundle]) -> None:
    plain, textured = (bundle.files for bundle in sheet_bundles)
    assert "splats.spz" not in plain, "the mesh does not wait for them"
    splats = from_spz(textured["splats.spz"])
    assert len(splats) == pytest.approx(100_000, rel=0.01)
    low, high = splats.xyz.min(axis=0), splats.xyz.max(axis=0)
    np.testing.assert_allclose(np.sort(high - low)[1:], 0.9, atol=0.05)
    red, blue = (np.abs(splats.rgb.astype(int) - colour).max(axis=1) < 60 for colour in ((230, 60, 40), (40, 60, 200)))
    assert (red | blue).mean() > 0.8
    assert min(red.mean(), blue.mean()) > 0.3


def test_splats_for_which_a_gpu_is_too_full_are_trained_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def fails_on_a_gpu(splats: Splats, *_: object, device: str, **__: object) -> Splats:
        tried.append(device)
        if device != "cpu":
            raise EdgeError("GPU_OOM", "the GPU is full")
        return splats

    monkeypatch.setattr("capture2vr.edge.splat_training.train_splats.train_splats", fails_on_a_gpu)
    preset = Preset("coarse", resolution=96, splat_steps=3)
    *_, bundle = reconstruct(_striped_sheet("dark"), preset, resources=JobResources("cuda:0"))
    assert isinstance(bundle, Bundle)
    assert tried == ["cuda:0", "cpu"]
    assert "splats.spz" in bundle.files
    assert "the GPU is full; the splats were trained on the CPU" in bundle.manifest["warnings"]


def test_a_capture_without_photos_gets_no_splats_and_a_warning() -> None:
    *_, bundle = reconstruct(_bowl(), replace(COARSE, splat_steps=3))
    assert isinstance(bundle, Bundle)
    assert "splats.spz" not in bundle.files
    assert "no splats were trained: the capture has no photos" in bundle.manifest["warnings"]


@pytest.mark.parametrize("hole", ["open", "sky"])
def test_a_true_opening_stays_open(hole: str) -> None:
    *_, bundle = reconstruct(_striped_sheet(hole), Preset("coarse", resolution=96))
    assert isinstance(bundle, Bundle)
    mesh = trimesh.load(io.BytesIO(bundle.files["mesh.ply"]), file_type="ply", process=False)
    near = mesh.triangles_center[np.abs(mesh.triangles_center[:, 2] - 1) < 0.1]
    assert np.hypot(near[:, 0], near[:, 1]).min() > 0.015
    assert bundle.manifest["quality"]["origins"]["filled"] < 0.001


def test_the_same_capture_gives_the_same_bytes() -> None:
    first, second = ([*reconstruct(_bowl(), COARSE)][-1] for _ in range(2))
    assert first.files["mesh.ply"] == second.files["mesh.ply"]
    assert first.files["lod2.glb"] == second.files["lod2.glb"]


def test_too_few_points_are_refused_with_a_name() -> None:
    with pytest.raises(EdgeError) as told:
        list(reconstruct(_bowl(12), load_preset("draft")))
    assert told.value.code == "CAPTURE_TOO_FEW_POINTS"
    assert "12" in told.value.message
