"""Find the device that fields are trained on.

Torch, which loads for a second, is imported only where there may be a GPU.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture2vr.edge.errors import EdgeError

_NAME = re.compile(r"auto|cuda(:\d+)?", re.ASCII)

_DRIVER_FILES = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")
"""Of CUDA, of ROCm, and of either under WSL; containers that were given a GPU have them too."""

_GPU_SHARE = 0.9
"""Share of a GPU's free memory, at the worker's start, for fits: kernels, context and fragments take the rest."""


@dataclass(frozen=True, slots=True)
class Device:
    """A device. name: torch's, "cpu" or "cuda:0"; description: for people; memory_bytes: for fits, 0: main memory."""

    name: str
    description: str
    memory_bytes: int = 0


def find_device(wanted: str) -> Device:
    """Find the device that "cpu", "cuda", "cuda:N" or "auto" means on this machine; auto takes a GPU if there is one.

    Raises EdgeError DEVICE_ABSENT.
    """
    if wanted == "cpu":
        return _cpu()
    if not _NAME.fullmatch(wanted):
        raise _absent(wanted, "devices are named cpu, cuda, cuda:N and auto")
    if wanted == "auto" and not _may_have_gpu():
        return _cpu()
    try:
        import torch
    except ImportError:
        if wanted == "auto":
            return _cpu()
        raise _absent(wanted, "PyTorch is not installed: pip install 'capture2vr[edge]'") from None
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if wanted == "auto" and count == 0:
        return _cpu()
    number = int(wanted.partition(":")[2] or 0)
    if number >= count:
        raise _absent(wanted, _why(torch, count))
    return _gpu(torch, number)


def _may_have_gpu() -> bool:
    """Return whether a driver that PyTorch can use may be there; on Linux each leaves a file."""
    return sys.platform != "linux" or any(Path(file).exists() for file in _DRIVER_FILES)


def _cpu() -> Device:
    count = len(os.sched_getaffinity(0))
    return Device("cpu", f"cpu, {count} core{'s' if count > 1 else ''}")


def _gpu(torch: Any, number: int) -> Device:
    name = f"cuda:{number}"
    free, _ = torch.cuda.mem_get_info(number)
    return Device(name, f"{name} {torch.cuda.get_device_name(number)}", int(_GPU_SHARE * free))


def _why(torch: Any, count: int) -> str:
    if torch.version.cuda is None:
        return f"the installed PyTorch {torch.__version__} is built without CUDA"
    return f"PyTorch sees {count} CUDA devices; check the driver, and that the GPU is passed to the container"


def _absent(wanted: str, why: str) -> EdgeError:
    return EdgeError("DEVICE_ABSENT", f"there is no {wanted}: {why}", hints=("use cpu, or auto",))
