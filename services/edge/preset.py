"""Presets: settings of a reconstruction that a client chooses by name.

A preset's TOML file holds only what differs from the defaults, with its reason.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib import resources
from importlib.resources.abc import Traversable
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.paper_field.network_config import UNUSED_KEYS, NetworkConfig
from capture2vr.order.option_table import GENERATE
from capture2vr.sentences.sentence import say, sentence_or_text

AUTOMATIC = "auto"
"""Name of the automatic choice: the pipeline then chooses a preset from the points (`preset_choice.py`). An empty name
means the same."""

PresetName = Literal["draft", "standard", "fine", "scene", "scene-tiles"]
"""Presets that the automatic choice chooses from."""

_ORDER = ("draft", "standard", "fine", "splats", "scene", "scene-tiles", GENERATE)
"""Order of the product's presets in lists, from quick to thorough; the literature's come after them."""
_POINT_BYTES = 400  # of a capture: 1,000,000 points take 400 MB on their way to the 200,000 that are kept
_CELL_BYTES = 1_500  # per cell of the surface, some resolution² of them: 384 cells take 220 MB while extracting
_TILE_BYTES = 1_400_000_000  # of one tile at a time: 1.49 GB measured, interpreter included, for rooms of 3 m at 1 cm
_SPLATS_BYTES = 1_500_000_000  # of a training of splats, PyTorch included: a whole process took 1.8 GB
_CELLS = (48, 4 / 3)  # least cells along a side; and cells per √points at one cell per spacing: cloth fills half a box

Extraction = Literal["dual", "published"]
"""How a field becomes a mesh: by the product's dual surfaces, cleaned, or by CAP-UDF's published code."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Preset:
    """Settings of one reconstruction.

    resolution   grid cells along the longest side; 0: from the spacing of the points, `cells_per_spacing` to each
    finest       most cells with resolution 0: 384 on a room gives some 300,000 triangles, three times LOD 0
    most_points  most points that the field is fitted to; more are downsampled evenly first. 200,000 points give some
                 400,000 triangles, four times the finest LOD, in about 30 s on two cores
    lod_faces    triangle budgets of the LODs, finest first: what a standalone headset draws at 90 Hz beside a scene
    fit          configuration of the training whose refined bundle follows the preview; None: the preview is the result
    denoised     whether the training gets the denoised points, as the preview does; the methods of the literature get
                 them as measured
    literature   whether it is a published method, to compare with: its own mesh is published even where the verdict
                 prefers the preview, which is then a warning
    extraction   how the trained field becomes a mesh
    tiled        whether the refined bundle is meshed tile by tile, from all points of the capture rather than
                 `most_points`, at the finest cells that they bear
    splat_steps  steps of a training of Gaussian splats on the photos, which the last bundle then has beside its mesh
    summary      what it is for, for people: in a file, a code of `sentences/english.json`, or an operator's own words
    takes        time that the training takes, for people, as `summary`; "" where it is minutes or less
    """

    name: str
    summary: str = ""
    resolution: int = 0
    cells_per_spacing: float = 1.5
    finest: int = 384
    most_points: int = 200_000
    lod_faces: tuple[int, ...] = (100_000, 25_000, 5_000)
    fit: AnchorConfig | NetworkConfig | None = None
    denoised: bool = True
    literature: bool = False
    extraction: Extraction = "dual"
    tiled: bool = False
    splat_steps: int = 0
    takes: str = ""

    @property
    def refines(self) -> bool:
        """Whether a refined bundle follows the preview, from a training or from tiles."""
        return self.fit is not None or self.tiled

    @property
    def generates(self) -> bool:
        """Whether a generator makes the points of it, from a capture of one photo."""
        return self.name == GENERATE


_AUTOMATIC_PRESET = Preset(AUTOMATIC, say("preset_auto"))


def preset_names() -> tuple[str, ...]:
    """List the presets that a client may name: the product's from quick to thorough, then those of the literature."""
    product = [*_ORDER, *(name for name in _names(_folder()) if name not in _ORDER)]
    return (*product, *_names(_folder() / "literature"))


def load_preset(name: str) -> Preset:
    """Load a preset by name; "" and "auto": the automatic choice. Raises EdgeError PRESET_UNKNOWN, which names all."""
    if name in ("", AUTOMATIC):
        return _AUTOMATIC_PRESET
    for folder in (_folder(), _folder() / "literature"):
        if name in _names(folder):
            return parse_preset(name, (folder / f"{name}.toml").read_text())
    known = ", ".join(preset_names())
    raise EdgeError(
        "PRESET_UNKNOWN", say("no_preset_presets", preset=name, names=known), hints=(say("use_one", names=known),)
    )


def parse_preset(name: str, text: str) -> Preset:
    """Parse a preset's TOML. Raises EdgeError PRESET_INVALID for an unknown key and for a value that does not fit."""
    values = tomllib.loads(text)
    if "name" in values:
        raise EdgeError("PRESET_INVALID", f"preset '{name}' has unknown keys: name")
    preset = _build(Preset, {"name": name, **values}, name, "")
    preset = replace(preset, summary=sentence_or_text(preset.summary), takes=sentence_or_text(preset.takes))
    if list(preset.lod_faces) != sorted(set(preset.lod_faces), reverse=True) or not preset.lod_faces:
        raise EdgeError("PRESET_INVALID", f"preset '{name}': lod_faces must decrease from level to level")
    if preset.splat_steps < 0:
        raise EdgeError("PRESET_INVALID", f"preset '{name}': splat_steps must not be negative")
    if preset.tiled and preset.fit:
        raise EdgeError("PRESET_INVALID", f"preset '{name}': tiled cannot be combined with a fit")
    return preset


def memory_bytes(preset: Preset, points: int, device: str = "cpu") -> int:
    """Estimate the most memory that a reconstruction of that many points takes, without the interpreter's 350 MB."""
    filled = max(_CELLS[0], int(_CELLS[1] * preset.cells_per_spacing * points**0.5))
    cells = preset.resolution or min(preset.finest, filled)
    mesh = _POINT_BYTES * points + _CELL_BYTES * cells**2
    if preset.tiled:  # its preview is made from some of the points, and each tile from its own
        return _POINT_BYTES * min(points, preset.most_points) + _TILE_BYTES
    fit = 0
    if preset.fit is not None:
        from capture2vr.edge.paper_field.memory_estimate import fit_memory_bytes

        fit = fit_memory_bytes(min(points, preset.most_points), preset.fit, device)
    return mesh + max(fit, _SPLATS_BYTES if preset.splat_steps else 0)


def _folder() -> Traversable:
    return resources.files("capture2vr.edge") / "presets"


def _names(folder: Traversable) -> list[str]:
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def _build(kind: type[T], values: Mapping[str, Any], preset: str, table: str) -> T:
    """Build a dataclass from a TOML table. Raises EdgeError PRESET_INVALID naming every unknown key, or what does not
    fit."""
    unknown = values.keys() - {each.name for each in fields(kind)}  # type: ignore[arg-type]
    if unknown:
        named = ", ".join(sorted(f"{table}{key}" for key in unknown))
        raise EdgeError("PRESET_INVALID", f"preset '{preset}' has unknown keys: {named}")
    hints = get_type_hints(kind)
    checked = {key: _value(hints[key], value, preset, f"{table}{key}") for key, value in values.items()}
    try:
        return kind(**checked)
    except ValueError as error:  # values that do not fit together
        raise EdgeError("PRESET_INVALID", f"preset '{preset}': {table}{error}") from None


def _value(hint: Any, value: Any, preset: str, key: str) -> Any:
    """Convert a TOML value to the type of its field. Raises EdgeError PRESET_INVALID where it does not fit."""
    choices = [each for each in get_args(hint) if each is not NoneType] if isinstance(hint, UnionType) else [hint]
    if isinstance(value, dict) and (
        tables := [each for each in choices if isinstance(each, type) and is_dataclass(each)]
    ):
        return _table(tables, value, preset, key)
    for choice in choices:
        if (converted := _as_type(choice, value)) is not None:
            return converted
    expected = " or ".join(_type_names(hint))
    raise EdgeError("PRESET_INVALID", f"preset '{preset}': {key} = {value!r} is not {expected}")


def _as_type(choice: Any, value: Any) -> Any:
    """Return a TOML value as one of the types that its field accepts; None where it is of another."""
    if get_origin(choice) is tuple:
        return tuple(value) if isinstance(value, list) and all(_is_a(each, int) for each in value) else None
    if get_origin(choice) is Literal:
        return value if value in get_args(choice) else None
    if choice is float and _is_a(value, int):
        return float(value)
    return value if isinstance(choice, type) and _is_a(value, choice) else None


def _table(kinds: Sequence[type[Any]], values: Mapping[str, Any], preset: str, key: str) -> Any:
    """Build a dataclass from a TOML table. Of several kinds, the table's `model` decides; its default is the last's.

    Raises EdgeError PRESET_INVALID for an unknown model, and for a key that the model does not use.
    """
    if len(kinds) == 1:
        return _build(kinds[0], values, preset, f"{key}.")
    models = {model: kind for kind in kinds for model in get_args(get_type_hints(kind)["model"])}
    model = values.get("model", kinds[-1]().model)
    if model not in models:
        choices = " or ".join(map(repr, models))
        raise EdgeError("PRESET_INVALID", f"preset '{preset}': {key}.model = {model!r} is not {choices}")
    known = {each.name for kind in kinds for each in fields(kind)}
    used = {each.name for each in fields(models[model])} - set(UNUSED_KEYS.get(model, ()))
    unused = ", ".join(sorted(f"{key}.{name}" for name in values.keys() & known - used))
    if unused:
        raise EdgeError("PRESET_INVALID", f"preset '{preset}' has keys that the model '{model}' does not use: {unused}")
    return _build(models[model], values, preset, f"{key}.")


def _is_a(value: Any, kind: type) -> bool:
    """Whether a TOML value has this type. Python counts a bool as an int; here `steps = true` is a mistake."""
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _type_names(hint: Any) -> Iterator[str]:
    """The names for people of the types and values that a field accepts."""
    if get_origin(hint) is Literal:
        yield from (repr(each) for each in get_args(hint))
    elif isinstance(hint, UnionType):
        for each in get_args(hint):
            yield from _type_names(each)
    elif hasattr(hint, "__dataclass_fields__"):
        yield "a table"
    elif hint is not NoneType:
        yield {int: "a whole number", float: "a number", str: "text", bool: "true or false"}.get(
            hint, "a list of numbers"
        )
