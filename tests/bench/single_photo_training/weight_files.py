"""Write and read trained heads, in half precision: pixels.pt, and the fields that use it as backbone. Torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn

from capture2vr.edge.field.checkpoint import saved_bytes
from capture2vr.process.atomic_write import atomic_write
from tests.bench.single_photo_network.network import Pixels
from tests.bench.single_photo_network.weights import BACKBONE, SHIPPED, load_pixels, load_weights, read_weights
from tests.bench.single_photo_training.field_heads import AnchorUdf, Field, Implicit

HEADS = ("pixels", "anchor-udf", "implicit")
FIELDS = Path(__file__).with_name("weights")
"""Folder of the trained fields that the bench compares; the product reads only pixels.pt."""


@dataclass(frozen=True, slots=True)
class TrainingRecord:
    """How long the head in a file was trained."""

    steps: int
    seconds: float


def save_half(head: nn.Module, trained: TrainingRecord, path: Path) -> None:
    """Write a head in half precision; a field is saved without its backbone. Raises OSError."""
    state = {
        name: value.half() if value.is_floating_point() else value
        for name, value in head.state_dict().items()
        if not name.startswith(BACKBONE)
    }
    data = saved_bytes({"head": state, "steps": trained.steps, "seconds": trained.seconds})
    with atomic_write(path) as part:
        part.write_bytes(data)


def new_head(name: str, folder: Path) -> nn.Module:
    """Make an untrained head; a field gets the backbone in `folder`, or else the shipped one."""
    return Pixels() if name == "pixels" else _field_with(_backbone(folder), name)


def load_field(name: str, folder: Path = FIELDS) -> Field:
    """Read the field "anchor-udf" or "implicit", with the backbone in `folder`, or else the shipped one.

    Raises EdgeError WEIGHTS_ABSENT.
    """
    field = _field_with(_backbone(folder), name)
    load_weights(field, folder / f"{name}.pt")
    return field.eval()


def training_of(name: str, folder: Path | None = None) -> TrainingRecord:
    """Read how long a head was trained; folder None: the shipped one. Raises EdgeError WEIGHTS_ABSENT."""
    content = read_weights((folder or (SHIPPED if name == "pixels" else FIELDS)) / f"{name}.pt")
    return TrainingRecord(content["steps"], content["seconds"])


def _backbone(folder: Path) -> Pixels:
    return load_pixels(folder if (folder / "pixels.pt").exists() else SHIPPED)


def _field_with(backbone: Pixels, name: str) -> Field:
    return AnchorUdf(backbone) if name == "anchor-udf" else Implicit(backbone)
