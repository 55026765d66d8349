"""The presets that a worker offers: the product's and the operator's own, without those that its memory cannot fit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import get_args

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.device import Device
from capture2vr.edge.preset import AUTOMATIC, Preset, PresetName, load_preset, memory_bytes, parse_preset, preset_names
from capture2vr.edge.worker.capabilities import POINTS_VERSION, Capabilities
from capture2vr.sentences.documents import codes_as_json

CHOICES: tuple[str, ...] = get_args(PresetName)
"""Names of the presets that the automatic choice may choose."""


def known_presets(folder: Path | None) -> Mapping[str, Preset]:
    """Load all presets by name: the automatic choice (the default), the product's, and those of an operator's folder.

    folder  TOML files, one per preset, or None
    Raises EdgeError PRESET_INVALID where there is no such folder, and for a file that cannot be read as a preset.
    """
    known = {name: load_preset(name) for name in (AUTOMATIC, *preset_names())}
    if folder is None:
        return known
    if not folder.is_dir():
        raise EdgeError("PRESET_INVALID", f"there is no folder {folder}; create it, or correct EDGE_PRESETS")
    for path in sorted(folder.glob("*.toml")):
        if path.stem in known:
            raise EdgeError(
                "PRESET_INVALID", f"the product has a preset '{path.stem}' already; give {path.name} another name"
            )
        try:
            known[path.stem] = parse_preset(path.stem, path.read_text(encoding="utf-8"))
        except ValueError as error:  # not TOML, or not UTF-8
            raise EdgeError("PRESET_INVALID", f"preset '{path.stem}' cannot be read: {error}") from None
    return known


def capabilities_of(presets: Mapping[str, Preset], device: Device, total_bytes: int) -> Capabilities:
    """Split presets into those that can be offered on a device with that much memory, and those withheld."""
    messages = [_to_message(preset, presets, device) for preset in presets.values()]
    withheld = [each for each in messages if least_bytes(presets[each.name], device) > total_bytes]
    offered = tuple(each for each in messages if each not in withheld)
    return Capabilities(device.description, offered, total_bytes, tuple(withheld), points_version=POINTS_VERSION)


def least_bytes(preset: Preset, device: Device) -> int:
    """Memory that a preset's fit or tiles take even for the smallest capture; 0 for a preset of previews alone."""
    return memory_bytes(preset, 0, device.name) if preset.refines else 0


def _to_message(preset: Preset, known: Mapping[str, Preset], device: Device) -> pb.Preset:
    """The wire's message for a preset; for the automatic choice, with the most that any of its choices takes."""
    choices = [known[name] for name in CHOICES] if preset.name == AUTOMATIC else [preset]
    return pb.Preset(
        name=preset.name,
        summary=preset.summary,
        trained=any(each.refines for each in choices),
        memory_bytes=max(memory_bytes(each, each.most_points, device.name) for each in choices),
        literature=preset.literature,
        takes=preset.takes,
        i18n=codes_as_json(summary=preset.summary, takes=preset.takes),
    )
