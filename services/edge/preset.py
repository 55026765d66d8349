"""Presets: what a client may choose by name. A file holds only what differs from the defaults, with its reason."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from importlib import resources

from services.edge.errors import EdgeError

DEFAULT_PRESET = "draft"


@dataclass(frozen=True, slots=True)
class Preset:
    """Settings of one reconstruction.

    resolution   grid cells along the longest side; 0 chooses from the spacing of the points
    finest       the most cells that choice may take: 384 on a room gives some 300,000 triangles, three times LOD 0
    most_points  points that the field is fitted to; more are thinned evenly first. 200,000 points give some 400,000
                 triangles, four times the finest LOD, in about 30 s on two cores
    lod_faces    triangle budgets of the LODs, finest first: what a standalone headset draws at 90 Hz beside a scene
    """

    name: str
    summary: str = ""
    resolution: int = 0
    finest: int = 384
    most_points: int = 200_000
    lod_faces: tuple[int, ...] = (100_000, 25_000, 5_000)


def preset_names() -> tuple[str, ...]:
    """The presets that this worker offers, the default first."""
    folder = resources.files("services.edge") / "presets"
    names = sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))
    return tuple(sorted(names, key=lambda name: name != DEFAULT_PRESET))


def load_preset(name: str) -> Preset:
    """The preset of that name, the default for "". Raises EdgeError PRESET_UNKNOWN, naming those there are."""
    name = name or DEFAULT_PRESET
    if name not in preset_names():
        known = ", ".join(preset_names())
        raise EdgeError(
            "PRESET_UNKNOWN", f"there is no preset '{name}'; known are: {known}", hints=(f"use one of: {known}",)
        )
    text = (resources.files("services.edge") / "presets" / f"{name}.toml").read_text()
    return parse_preset(name, text)


def parse_preset(name: str, text: str) -> Preset:
    """Read a preset's TOML. Raises EdgeError PRESET_INVALID for a key that no preset has."""
    values = tomllib.loads(text)
    unknown = values.keys() - {field.name for field in fields(Preset)} | values.keys() & {"name"}
    if unknown:
        raise EdgeError("PRESET_INVALID", f"preset '{name}' has unknown keys: {', '.join(sorted(unknown))}")
    if "lod_faces" in values:
        values["lod_faces"] = tuple(values["lod_faces"])
        if list(values["lod_faces"]) != sorted(set(values["lod_faces"]), reverse=True):
            raise EdgeError("PRESET_INVALID", f"preset '{name}': lod_faces must fall from level to level")
    return Preset(name=name, **values)
