"""The encoder of KTX2, installed once per lock file into a cache outside the checkout, and the viewer's transcoder,
which shows what it made."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.export.ktx2 import Ktx2Encoder
from tests.support.npm_packages import installed
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

_HERE = Path(__file__).parent
_VENDOR = ROOT / "services" / "web" / "vendor"


def encoder_folder() -> Path:
    """What an operator names in EDGE_KTX2. Skips (fails in CI) where node or the package cannot be had."""
    return installed("ktx2", _HERE, what="the KTX2 encoder")


@pytest.fixture(scope="session")
def ktx2() -> Ktx2Encoder:
    """The encoder."""
    return Ktx2Encoder.at(encoder_folder())


@dataclass(frozen=True)
class Unpacked:
    """A KTX2 file as the viewer sees it: levels (H,W,3) uint8, the largest first; what it says of itself."""

    levels: tuple[np.ndarray, ...]
    alpha: bool
    etc1s: bool


def unpacked(content: bytes, scratch: Path) -> Unpacked:
    """Through the page's own transcoder, under Node."""
    (transcoder,) = _VENDOR.glob("three-*.basis-transcoder.wasm")
    file, out = scratch / "in.ktx2", scratch / "out.rgba"
    file.write_bytes(content)
    command = ["node", _HERE / "decode.mjs", transcoder.with_suffix(""), file, out]
    told = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=HANG_S).stdout)
    texels, levels = np.fromfile(out, np.uint8).reshape(-1, 4), []
    for width, height in told.pop("sizes"):
        levels.append(texels[: width * height, :3].reshape(height, width, 3))
        texels = texels[width * height :]
    return Unpacked(tuple(levels), **told)
