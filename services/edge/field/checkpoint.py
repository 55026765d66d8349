"""The checkpoint file of a fit, from which a killed job resumes.

An atomic write: to a temporary file, synced, then renamed, so a reader sees the old state or the new one, never a torn
one. The fingerprint ties a file to its points, settings and kind of device; the file of another fit is ignored.
"""

from __future__ import annotations

import hashlib
import io
import logging
from pathlib import Path
from typing import Any

import numpy as np
import torch

from capture2vr.edge.arrays import Floats
from capture2vr.process.atomic_write import atomic_write

SECONDS = 5.0  # between two writes: the most that a kill loses; a synced write of some 6 MB takes far less
VERSION = 3  # of the state's layout

State = dict[str, Any]
"""Tensors and plain numbers by name."""

_log = logging.getLogger(__name__)


def fingerprint(config: object, device: torch.device, *arrays: Floats | None) -> str:
    """Hash (SHA-256) the inputs and settings of a fit, to tell whether a checkpoint belongs to it."""
    digest = hashlib.sha256(f"{VERSION} {config!r} {device.type} {torch.__version__}".encode())
    for array in arrays:
        digest.update(
            b"none" if array is None else np.ascontiguousarray(array).tobytes() + bytes(str(array.shape), "ascii")
        )
    return digest.hexdigest()


def save(path: Path, state: State, mark: str) -> None:
    """Write the state to `path`, replacing the file there. Raises OSError.

    mark: the fit's `fingerprint`.
    """
    # An older lease of the job may end right now and remove the folder, if nothing is in it yet.
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    data = saved_bytes({**state, "fingerprint": mark})
    with atomic_write(path) as part:
        part.write_bytes(data)


def saved_bytes(state: State) -> bytes:
    """Return the bytes of a file that torch.load reads.

    Where a disk is full, torch.save raises a RuntimeError about positions in the file; Python's own writing, OSError.
    """
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def load(path: Path, mark: str, device: torch.device) -> State | None:
    """Read the state of the fit with this fingerprint; None where there is none. A broken or foreign file is logged."""
    try:
        state: State = torch.load(path, map_location=device, weights_only=True)
        found = state.pop("fingerprint")
    except FileNotFoundError:
        return None
    except Exception as error:  # noqa: BLE001 - unpickling a torn file may raise anything
        _log.warning("cannot read the checkpoint %s, the fit starts from the beginning: %s", path, error)
        return None
    if found != mark:
        _log.warning("the checkpoint %s belongs to other points or settings, the fit starts from the beginning", path)
        return None
    return state
