"""The trained heads as files, in half precision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import nn

from services.edge.errors import EdgeError
from services.edge.guess.heads import AnchorUdf, Field, Implicit
from services.edge.guess.network import Pixels

HEADS = ("pixels", "anchor-udf", "implicit")
SHIPPED = Path(__file__).with_name("weights")
_BACKBONE = "backbone."


@dataclass(frozen=True, slots=True)
class Trained:
    """What a file says about its training."""

    steps: int
    seconds: float


def save_half(head: nn.Module, trained: Trained, path: Path) -> None:
    """A field is saved without the backbone that it stands on."""
    state = {
        name: value.half() if value.is_floating_point() else value
        for name, value in head.state_dict().items()
        if not name.startswith(_BACKBONE)
    }
    part = path.with_name(path.name + ".part")
    torch.save({"head": state, "steps": trained.steps, "seconds": trained.seconds}, part)
    part.replace(path)


def new_head(name: str, folder: Path) -> nn.Module:
    """Untrained; a field on the backbone that is in `folder`, or else on the one that is shipped."""
    if name == "pixels":
        return Pixels()
    backbone = load_pixels(folder if (folder / "pixels.pt").exists() else SHIPPED)
    return AnchorUdf(backbone) if name == "anchor-udf" else Implicit(backbone)


def load_pixels(folder: Path = SHIPPED) -> Pixels:
    """The backbone, ready to be used. Raises EdgeError WEIGHTS_ABSENT."""
    head = Pixels()
    _fill(head, folder / "pixels.pt")
    return head.eval()


def load_field(name: str, folder: Path = SHIPPED) -> Field:
    """Of the name "anchor-udf" or "implicit". Raises EdgeError WEIGHTS_ABSENT."""
    backbone = load_pixels(folder)
    field = AnchorUdf(backbone) if name == "anchor-udf" else Implicit(backbone)
    _fill(field, folder / f"{name}.pt")
    return field.eval()


def trained(name: str, folder: Path = SHIPPED) -> Trained:
    """How long that head was trained. Raises EdgeError WEIGHTS_ABSENT."""
    kept = _read(folder / f"{name}.pt")
    return Trained(kept["steps"], kept["seconds"])


@cache
def shipped_pixels() -> Pixels:
    """Read once per process; nobody may train it."""
    return load_pixels().requires_grad_(False)


def _read(path: Path) -> dict[str, Any]:
    try:
        kept: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        hint = "install the package again, or train them: python -m services.edge.guess"
        raise EdgeError("WEIGHTS_ABSENT", f"there is no {path}", hints=(hint,)) from None
    return kept


def _fill(head: nn.Module, path: Path) -> None:
    missing, unknown = head.load_state_dict(_read(path)["head"], strict=False)
    lost = [name for name in missing if not name.startswith(_BACKBONE)]
    if lost or unknown:
        raise EdgeError("WEIGHTS_ABSENT", f"{path} is of another version: {', '.join([*lost, *unknown][:3])}")
