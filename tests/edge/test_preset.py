"""Presets: known names, only known keys, and what they say of themselves."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture2vr.edge import preset as presets
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from capture2vr.edge.preset import AUTOMATIC, Preset, load_preset, memory_bytes, parse_preset, preset_names

LITERATURE = ("cap-udf", "levelset-udf", "paper", "paper-no-self", "paper-scene", "paper-variant")
LOSSES = ("chamfer", "projection", "surface", "orthogonality", "self_consistency")
FOLDER = Path(presets.__file__).parent / "presets"


def test_every_preset_loads_and_the_literature_comes_last() -> None:
    assert preset_names() == ("draft", "standard", "fine", "splats", "scene", "scene-tiles", "generate", *LITERATURE)
    for name in preset_names():
        preset = load_preset(name)
        assert preset.name == name
        assert preset.summary
        assert (preset.fit is None) == (name in ("draft", "scene-tiles", "generate"))
        assert preset.generates == (name == "generate")
        assert preset.literature == (name in LITERATURE)
        assert bool(preset.takes) == preset.literature


@pytest.mark.parametrize("path", sorted(FOLDER.rglob("*.toml")), ids=lambda path: path.stem)
def test_every_file_states_its_reasons(path: Path) -> None:
    assert path.stem in preset_names()
    assert "#" in path.read_text()


def test_no_name_leaves_the_choice_to_the_points() -> None:
    assert load_preset("") == load_preset(AUTOMATIC)
    assert load_preset("").name == AUTOMATIC
    assert AUTOMATIC not in preset_names()


@pytest.mark.parametrize("name", ["magic", "../draft", "DRAFT", "draft.toml", "literature/cap-udf"])
def test_an_unknown_name_is_told_with_the_known_ones(name: str) -> None:
    with pytest.raises(EdgeError, match="draft") as told:
        load_preset(name)
    assert told.value.code == "PRESET_UNKNOWN"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("resolutoin = 128", "resolutoin"),
        ('name = "other"', "name"),
        ("[fit]\nstepz = 3", "fit.stepz"),
        ("splats = 3", "splats"),
        ("[fit.densify]\nmore = 3", "fit.densify.more"),
    ],
)
def test_an_unknown_key_is_an_error_that_names_it(text: str, named: str) -> None:
    with pytest.raises(EdgeError, match=f"unknown keys: {named}$") as told:
        parse_preset("mine", text)
    assert told.value.code == "PRESET_INVALID"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("resolution = 1.5", "resolution = 1.5 is not a whole number"),
        ("summary = 3", "summary = 3 is not text"),
        ("lod_faces = [1.5]", "is not a list of numbers"),
        ("lod_faces = [100, 1000]", "must decrease"),
        ("lod_faces = []", "must decrease"),
        ("splat_steps = -1", "splat_steps must not be negative"),
        ("denoised = 1", "is not true or false"),
        ("fit = 3", "fit = 3 is not a table"),
        ("[fit]\nsteps = true", "fit.steps = True is not a whole number"),
        ('[fit]\nmodel = "larger"', "fit.model = 'larger' is not 'anchors' or 'separable' or 'mlp'"),
        ("[fit]\ndensify = 3", "fit.densify = 3 is not a table"),
        ("[fit]\nwidths = [128, 256]", "'mine': fit.widths = .128, 256.: the network has 6 layers"),
        ("[fit]\nsteps = 0", "'mine': fit.steps = 0: it must be at least 1"),
        ("[fit]\nbatch = -1", "fit.batch = -1: it must be at least 1"),
        ("[fit]\npool = 0", "fit.pool = 0: it must be at least 1"),
        ("[fit]\nseed = -1", "fit.seed = -1: it must be at least 0"),
        ("[fit]\nchamfer = -1", "fit.chamfer = -1: it must be at least 0"),
        ("[fit]\nlearning_rate = nan", "fit.learning_rate = nan: it must be above 0"),
        ("[fit]\nmemory = 2", "fit.memory = 2: it must be from 0 to below 1"),
        ("[fit]\nstrong_per_m2 = inf\nweak_per_m2 = inf", "fit.weak_per_m2 = inf: it must be finite"),
        ("[fit.densify]\nbatch = 0", "fit.densify.batch = 0: it must be at least 1"),
        ("[fit.densify]\ngrowth = 0", "fit.densify.growth = 0: it must be above 0"),
        (
            "[fit]\n" + "".join(f"{loss} = 0\n" for loss in LOSSES),
            "no loss has a weight above 0",
        ),
        ('[fit]\nsign = "up"', "fit.sign = 'up' is not 'printed' or 'decaying'"),
    ],
)
def test_a_value_of_another_kind_is_an_error_that_says_which(text: str, said: str) -> None:
    with pytest.raises(EdgeError, match=said) as told:
        parse_preset("mine", text)
    assert told.value.code == "PRESET_INVALID"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('model = "anchors"\nbatch = 5\npool = 3', "'anchors' does not use: fit.batch, fit.pool"),
        ('model = "anchors"\n[fit.densify]\nsteps = 5', "'anchors' does not use: fit.densify"),
        ('model = "mlp"\nwidths = [128]', "'mlp' does not use: fit.widths"),
    ],
)
def test_a_key_that_the_model_does_not_use_is_an_error_that_names_it(text: str, named: str) -> None:
    with pytest.raises(EdgeError, match=named) as told:
        parse_preset("mine", f"[fit]\n{text}")
    assert told.value.code == "PRESET_INVALID"


def test_a_preset_holds_only_differences() -> None:
    preset = parse_preset("mine", "lod_faces = [1000, 100]")
    assert preset == Preset("mine", lod_faces=(1000, 100))
    trained = parse_preset("mine", "[fit]\nlearning_rate = 1\n[fit.densify]\nsteps = 5").fit
    assert trained == NetworkConfig(learning_rate=1.0, densify=Densify(steps=5))


def test_the_literature_is_as_published() -> None:
    fits = {name: load_preset(name).fit for name in LITERATURE}
    paper = NetworkConfig()
    assert fits["paper"] == paper
    assert (paper.projection, paper.surface, paper.orthogonality, paper.self_consistency) == (1e-3, 1e-3, 1e-4, 1e-2)
    assert (paper.steps, paper.warm_up, paper.learning_rate, paper.warm_start) == (40_000, 1_000, 1e-3, 0)
    assert (paper.strong_per_m2, paper.weak_per_m2, paper.far_share, paper.pairs) == (1_000, 500, 0, "pull")
    assert fits["paper-no-self"] == NetworkConfig(self_consistency=0.0)
    assert fits["paper-variant"] != paper
    pull, levels = fits["cap-udf"], fits["levelset-udf"]
    assert pull is not None
    assert levels is not None
    assert (pull.model, pull.projection, pull.orthogonality, pull.surface, pull.self_consistency) == ("mlp", 0, 0, 0, 0)
    assert (pull.total_steps, levels.total_steps) == (60_000, 40_000)
    assert (levels.projection, levels.surface, levels.orthogonality) == (0.002, 0.1, 0.01)
    assert not any(load_preset(name).denoised for name in LITERATURE), "they see the points as measured"


def test_the_product_trains_anchors_and_scenes_take_fewer_steps() -> None:
    steps = {}
    for name in ("scene", "standard", "fine"):
        preset = load_preset(name)
        assert preset.fit is not None
        assert preset.fit.model == "anchors"
        steps[name] = preset.fit.steps
    assert steps["scene"] < steps["standard"] < steps["fine"]


def test_the_papers_scene_weighs_as_the_paper_says() -> None:
    scene = load_preset("paper-scene").fit
    assert isinstance(scene, NetworkConfig)
    assert (scene.projection, scene.orthogonality, scene.self_consistency) == (2e-3, 1e-2, 1e-1)
    assert (scene.surface, scene.weak_per_m2) == (2e-3, 100)
    assert scene.steps == 100_000


def test_memory_grows_with_the_points_and_with_training() -> None:
    draft, standard = load_preset("draft"), load_preset("standard")
    assert 0 < memory_bytes(draft, 10_000) < memory_bytes(draft, 200_000) < 1e9
    assert memory_bytes(standard, 10_000) > memory_bytes(draft, 10_000)
    assert memory_bytes(standard, 10_000, "cuda:0") > memory_bytes(standard, 10_000)
