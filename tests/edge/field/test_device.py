from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field import device
from capture2vr.edge.field.device import find_device

_FIND = """
import sys
from capture2vr.edge.field.device import find_device
find_device("auto")
print("torch" in sys.modules)
"""


@pytest.mark.skipif(
    any(Path(file).exists() for file in device._DRIVER_FILES), reason="there is a GPU's driver, which torch has to see"
)
def test_auto_loads_no_torch_where_no_driver_is() -> None:
    done = subprocess.run([sys.executable, "-c", _FIND], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_auto_asks_torch_where_a_driver_may_be(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: asked.append(True) or False)
    monkeypatch.setattr(device, "_DRIVER_FILES", (str(tmp_path / "none"), str(tmp_path)))
    assert find_device("auto").name == "cpu"
    assert asked


@pytest.mark.parametrize("wanted", ["cuda:99", "gpu", "cuda:"])
def test_absent_device(wanted: str) -> None:
    with pytest.raises(EdgeError, match=wanted):
        find_device(wanted)
