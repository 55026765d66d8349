"""Limits of memory and cores of this process's control group, and its out-of-memory kills (Linux cgroup, version 1, 2).

A container has one. The kernel kills a process of a group that wants more than its limit, and counts these kills.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_MOUNT = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")


@dataclass(frozen=True, slots=True)
class ControlGroup:
    """Folders of the group and of those around it, innermost first, which all limit it; none outside Linux."""

    folders: tuple[Path, ...]

    @property
    def limit_bytes(self) -> int:
        """The smallest memory limit in bytes; 0 where there is none."""
        return min(filter(None, map(_limit_bytes, self.folders)), default=0)

    @property
    def core_limit(self) -> float:
        """The smallest limit of cores, as 1.5; 0 where there is none."""
        return min(filter(None, map(_core_limit, self.folders)), default=0.0)

    @property
    def oom_kills(self) -> int:
        """Count the processes of this control group that the kernel's OOM killer has killed; 0 if unknown."""
        return _oom_kills(self.folders[0]) if self.folders else 0


def own_control_group(mount: Path = _MOUNT, own: Path = _OWN, *, controller: str = "memory") -> ControlGroup:
    """Find the control group of this process that limits memory, or with controller "cpu" the one that limits cores.

    mount  where the control groups are mounted
    own    file of the kernel that names this process's groups, a line each: `4:memory:/a` in version 1, `0::/a` in 2
    """
    try:
        lines = [line.split(":", 2) for line in own.read_text().splitlines()]
    except OSError:
        return ControlGroup(())
    paths = {each: path for _, controllers, path in lines for each in controllers.split(",")}
    # A machine that has both versions gives a controller to one: to version 1 where that has a folder for it.
    first = mount / controller
    root, path = (first, paths[controller]) if controller in paths and first.is_dir() else (mount, paths.get("", "/"))
    return ControlGroup(tuple(_folders(root, path)))


def _folders(root: Path, path: str) -> Iterator[Path]:
    """Yield the folders of a group and of those around it, as far as they are there.

    In a container the path may be the one that the host knows, or lead out of what is mounted (/../..); the container's
    own group is mounted at the root then.
    """
    inner = root if ".." in Path(path).parts else root / path.strip("/")
    for folder in (inner, *inner.parents):
        if folder.is_relative_to(root) and folder.is_dir():
            yield folder


def _limit_bytes(folder: Path) -> int:
    """The limit of one group; 0 where there is none. Version 2 says "max"; version 1 a number beyond all memory."""
    for name in ("memory.max", "memory.limit_in_bytes"):
        text = _read(folder / name).strip()
        if text.isdecimal():
            limit = int(text)
            return limit if limit < 1 << 62 else 0
    return 0


def _core_limit(folder: Path) -> float:
    """The limit of one group; 0 where there is none. Version 2 has "quota period" in a line; version 1 two files."""
    quota, _, period = _read(folder / "cpu.max").strip().partition(" ")
    if not period:
        quota, period = (_read(folder / f"cpu.cfs_{name}_us").strip() for name in ("quota", "period"))
    return int(quota) / int(period) if quota.isdecimal() and period.isdecimal() and int(period) else 0.0


def _oom_kills(folder: Path) -> int:
    for name in ("memory.events", "memory.oom_control"):
        for line in _read(folder / name).splitlines():
            word, _, count = line.partition(" ")
            if word == "oom_kill":
                return int(count)
    return 0


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
