"""The presets that a worker has: the product's, an operator's own, and which of them its memory lets it offer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import get_args

from services.edge import choose
from services.edge.api import edge_pb2 as pb
from services.edge.errors import EdgeError
from services.edge.field.device import Device
from services.edge.offer import Offer
from services.edge.prepared import VERSION
from services.edge.preset import AUTOMATIC, Preset, load_preset, memory_bytes, parse_preset, preset_names

CHOICES: tuple[str, ...] = get_args(choose.Preset)
"""What the automatic choice may choose."""


def known_presets(folder: Path | None) -> Mapping[str, Preset]:
    """The automatic choice, which is the default, the product's presets, and those of an operator's folder of TOML.

    Raises EdgeError PRESET_INVALID for a folder that is none and a file that cannot be read as a preset.
    """
    known = {name: load_preset(name) for name in (AUTOMATIC, *preset_names())}
    if folder is None:
        return known
    if not folder.is_dir():
        raise EdgeError("PRESET_INVALID", f"there is no folder {folder}")
    for path in sorted(folder.glob("*.toml")):
        if path.stem in known:
            raise EdgeError(
                "PRESET_INVALID", f"'{path.stem}' is the product's own preset; give {path.name} another name"
            )
        try:
            known[path.stem] = parse_preset(path.stem, path.read_text(encoding="utf-8"))
        except ValueError as error:  # no TOML, or no text at all
            raise EdgeError("PRESET_INVALID", f"preset '{path.stem}' cannot be read: {error}") from None
    return known


def offer_of(presets: Mapping[str, Preset], device: Device, total_bytes: int) -> Offer:
    """What can be offered of these presets on that device with that much memory."""
    told = [_told(preset, presets, device) for preset in presets.values()]
    withheld = [each for each in told if least_bytes(presets[each.name], device) > total_bytes]
    offered = tuple(each for each in told if each not in withheld)
    return Offer(device.description, offered, total_bytes, tuple(withheld), points_version=VERSION)


def least_bytes(preset: Preset, device: Device) -> int:
    """What even the smallest capture takes; nothing that matters where nothing is trained."""
    return memory_bytes(preset, 0, device.name) if preset.fit else 0


def _told(preset: Preset, known: Mapping[str, Preset], device: Device) -> pb.Preset:
    choices = [known[name] for name in CHOICES] if preset.name == AUTOMATIC else [preset]
    return pb.Preset(
        name=preset.name,
        summary=preset.summary,
        trained=any(each.fit is not None for each in choices),
        memory_bytes=max(memory_bytes(each, each.most_points, device.name) for each in choices),
    )
