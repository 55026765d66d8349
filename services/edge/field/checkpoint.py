"""A fit's state on disk, so that a killed job goes on where it was.

Written to a temporary file, synced, then renamed: a reader sees the old state or the new one, never a torn one. The
fingerprint ties a file to its points, settings and kind of device; another fit's file is as good as none.
"""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from services.edge.arrays import Floats
from services.edge.field.config import FitConfig

SECONDS = 5.0  # between two writes: what a kill loses at the most, and far more than a synced write of some 6 MB takes
VERSION = 1  # of the state's layout

State = dict[str, Any]
"""Tensors and plain numbers by name."""

_log = logging.getLogger(__name__)


def fingerprint(config: FitConfig, device: torch.device, *arrays: Floats | None) -> str:
    """Of everything that a fit's result depends on."""
    digest = hashlib.sha256(f"{VERSION} {config!r} {device.type} {torch.__version__}".encode())
    for array in arrays:
        digest.update(
            b"none" if array is None else np.ascontiguousarray(array).tobytes() + bytes(str(array.shape), "ascii")
        )
    return digest.hexdigest()


def save(path: Path, state: State, mark: str) -> None:
    """Replace the file at `path`. Raises OSError where the disk will not."""
    # An older lease of the job that ends now removes the folder, if nothing is in it yet.
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    torn = path.with_name(path.name + ".part")
    with torn.open("wb") as file:
        torch.save({**state, "fingerprint": mark}, file)
        file.flush()
        os.fsync(file.fileno())
    # A crash before this line leaves the old state; after it, the new one, once the folder is synced.
    torn.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def load(path: Path, mark: str, device: torch.device) -> State | None:
    """The state of this very fit, or None where there is none; a broken or foreign file is reported and left alone."""
    try:
        state: State = torch.load(path, map_location=device, weights_only=True)
        found = state.pop("fingerprint")
    except FileNotFoundError:
        return None
    except Exception as error:  # noqa: BLE001 - what a torn file makes an unpickler raise is nobody's promise
        _log.warning("the checkpoint %s cannot be read, the fit starts anew: %s", path, error)
        return None
    if found != mark:
        _log.warning("the checkpoint %s is of other points or settings, the fit starts anew", path)
        return None
    return state
