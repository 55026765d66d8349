"""Load the weights of the network that guesses a shape from one photo: a file in half precision. Torch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn

from capture2vr.edge.errors import EdgeError
from tests.bench.single_photo_network.network import Pixels

SHIPPED = Path(__file__).with_name("weights")
"""Folder of the weights that the bench and the paper compare: pixels.pt."""

BACKBONE = "backbone."
"""Prefix of the parameters that the file of another head leaves out, because they are in pixels.pt."""


def load_pixels(folder: Path = SHIPPED) -> Pixels:
    """Read the network from `folder`/pixels.pt, ready to be used. Raises EdgeError WEIGHTS_ABSENT."""
    network = Pixels()
    load_weights(network, folder / "pixels.pt")
    return network.eval()


def read_weights(path: Path) -> dict[str, Any]:
    """Read the content of a file of weights. Raises EdgeError WEIGHTS_ABSENT."""
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        hint = "check out the repository again"
        raise EdgeError("WEIGHTS_ABSENT", f"the weights file {path} does not exist", hints=(hint,)) from None
    return content


def load_weights(network: nn.Module, path: Path) -> None:
    """Load a file's weights into a network of the same shape. Raises EdgeError WEIGHTS_ABSENT."""
    missing, unknown = network.load_state_dict(read_weights(path)["head"], strict=False)
    lost = [name for name in missing if not name.startswith(BACKBONE)]
    if lost or unknown:
        named = ", ".join([*lost, *unknown][:3])
        raise EdgeError("WEIGHTS_ABSENT", f"the weights file {path} is of another version of the network: {named}")
