"""Presets: known names, only known keys."""

from __future__ import annotations

import pytest

from services.edge.errors import EdgeError
from services.edge.preset import DEFAULT_PRESET, load_preset, parse_preset, preset_names


def test_every_preset_loads_and_the_default_comes_first() -> None:
    assert preset_names()[0] == DEFAULT_PRESET
    for name in preset_names():
        assert load_preset(name).name == name
    assert load_preset("") == load_preset(DEFAULT_PRESET)


@pytest.mark.parametrize("name", ["magic", "../draft", "DRAFT", "draft.toml"])
def test_an_unknown_name_is_told_with_the_known_ones(name: str) -> None:
    with pytest.raises(EdgeError, match=DEFAULT_PRESET) as told:
        load_preset(name)
    assert told.value.code == "PRESET_UNKNOWN"


@pytest.mark.parametrize("text", ["resolutoin = 128", 'name = "other"'])
def test_an_unknown_key_is_an_error(text: str) -> None:
    with pytest.raises(EdgeError, match="unknown keys") as told:
        parse_preset("mine", text)
    assert told.value.code == "PRESET_INVALID"


def test_a_preset_holds_only_differences() -> None:
    preset = parse_preset("mine", "lod_faces = [1000, 100]")
    assert preset.lod_faces == (1000, 100)
    assert preset.resolution == load_preset("").resolution
