"""Presets: what a client may choose by name. A file holds only what differs from the defaults, with its reason."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from importlib import resources
from importlib.resources.abc import Traversable
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from services.edge.errors import EdgeError
from services.edge.field.config import FitConfig

AUTOMATIC = "auto"
"""The name under which the pipeline chooses a preset from the points (`choose.py`); so does no name at all."""

_ORDER = ("draft", "standard", "fine", "scene")  # from quick to thorough, as people read them; baselines come behind
_POINT_BYTES = 400  # of a capture: 1,000,000 points take 400 MB on their way to the 200,000 that are kept
_CELL_BYTES = 1_500  # per cell of the surface, some resolution² of them: 384 cells take 220 MB while extracting
_CELLS = (48, 4 / 3)  # the least along a side, and per √points and cell per spacing: folded cloth fills half of it

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Preset:
    """Settings of one reconstruction.

    resolution   grid cells along the longest side; 0 chooses from the spacing of the points, giving each of them
                 `cells_per_spacing`
    finest       the most cells that choice may take: 384 on a room gives some 300,000 triangles, three times LOD 0
    most_points  points that the field is fitted to; more are thinned evenly first. 200,000 points give some 400,000
                 triangles, four times the finest LOD, in about 30 s on two cores
    lod_faces    triangle budgets of the LODs, finest first: what a standalone headset draws at 90 Hz beside a scene
    fit          the training whose refined bundle follows the preview; None: the preview is the result
    denoised     whether the training sees the points with the noise taken off, as the preview does; the baselines
                 see them as they were measured
    """

    name: str
    summary: str = ""
    resolution: int = 0
    cells_per_spacing: float = 1.5
    finest: int = 384
    most_points: int = 200_000
    lod_faces: tuple[int, ...] = (100_000, 25_000, 5_000)
    fit: FitConfig | None = None
    denoised: bool = True


_LEFT_TO_THE_POINTS = Preset(AUTOMATIC, "chosen from the points, their spacing and noise, and the device")


def preset_names() -> tuple[str, ...]:
    """The presets that may be named, the product's from quick to thorough, then the baselines."""
    product = [*_ORDER, *(name for name in _names(_folder()) if name not in _ORDER)]
    return (*product, *_names(_folder() / "baselines"))


def load_preset(name: str) -> Preset:
    """The preset of that name; "" and "auto" leave it to the points. Raises EdgeError PRESET_UNKNOWN, naming all."""
    if name in ("", AUTOMATIC):
        return _LEFT_TO_THE_POINTS
    for folder in (_folder(), _folder() / "baselines"):
        if name in _names(folder):
            return parse_preset(name, (folder / f"{name}.toml").read_text())
    known = ", ".join(preset_names())
    raise EdgeError(
        "PRESET_UNKNOWN", f"there is no preset '{name}'; known are: {known}", hints=(f"use one of: {known}",)
    )


def parse_preset(name: str, text: str) -> Preset:
    """Read a preset's TOML. Raises EdgeError PRESET_INVALID for a key that none has and a value that none takes."""
    values = tomllib.loads(text)
    if "name" in values:
        raise EdgeError("PRESET_INVALID", f"preset '{name}' has unknown keys: name")
    preset = _built(Preset, {"name": name, **values}, name, "")
    if list(preset.lod_faces) != sorted(set(preset.lod_faces), reverse=True) or not preset.lod_faces:
        raise EdgeError("PRESET_INVALID", f"preset '{name}': lod_faces must fall from level to level")
    return preset


def memory_bytes(preset: Preset, points: int, device: str = "cpu") -> int:
    """The most memory that a reconstruction of that many points takes, the interpreter's own 350 MB not counted."""
    filled = max(_CELLS[0], int(_CELLS[1] * preset.cells_per_spacing * points**0.5))
    cells = preset.resolution or min(preset.finest, filled)
    mesh = _POINT_BYTES * points + _CELL_BYTES * cells**2
    if preset.fit is None:
        return mesh
    from services.edge.field.memory import fit_memory_bytes

    return mesh + fit_memory_bytes(min(points, preset.most_points), preset.fit, device)


def _folder() -> Traversable:
    return resources.files("services.edge") / "presets"


def _names(folder: Traversable) -> list[str]:
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def _built(kind: type[T], values: Mapping[str, Any], preset: str, table: str) -> T:
    """A dataclass of a TOML table. Raises EdgeError PRESET_INVALID naming every key it does not have."""
    unknown = values.keys() - {each.name for each in fields(kind)}  # type: ignore[arg-type]
    if unknown:
        named = ", ".join(sorted(f"{table}{key}" for key in unknown))
        raise EdgeError("PRESET_INVALID", f"preset '{preset}' has unknown keys: {named}")
    hints = get_type_hints(kind)
    return kind(**{key: _value(hints[key], value, preset, f"{table}{key}") for key, value in values.items()})


def _value(hint: Any, value: Any, preset: str, key: str) -> Any:
    """A TOML value as the field's type has it. Raises EdgeError PRESET_INVALID."""
    choices = [each for each in get_args(hint) if each is not NoneType] if isinstance(hint, UnionType) else [hint]
    for choice in choices:
        if isinstance(value, dict) and hasattr(choice, "__dataclass_fields__"):
            return _built(choice, value, preset, f"{key}.")
        if isinstance(value, list) and get_origin(choice) is tuple and all(_fits(each, int) for each in value):
            return tuple(value)
        if get_origin(choice) is Literal and value in get_args(choice):
            return value
        if choice is float and _fits(value, int):
            return float(value)
        if isinstance(choice, type) and _fits(value, choice):
            return value
    wanted = " or ".join(_words(hint))
    raise EdgeError("PRESET_INVALID", f"preset '{preset}': {key} = {value!r} is not {wanted}")


def _fits(value: Any, kind: type) -> bool:
    # A bool is an int to Python; to a person who writes `steps = true` it is a mistake.
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _words(hint: Any) -> Iterator[str]:
    if get_origin(hint) is Literal:
        yield from (repr(each) for each in get_args(hint))
    elif isinstance(hint, UnionType):
        for each in get_args(hint):
            yield from _words(each)
    elif hasattr(hint, "__dataclass_fields__"):
        yield "a table"
    elif hint is not NoneType:
        yield {int: "a whole number", float: "a number", str: "text", bool: "true or false"}.get(
            hint, "a list of numbers"
        )
