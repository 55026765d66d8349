"""The memory limit and the kills of a control group, read from folders as kernels write them, and of this process."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture2vr.edge.worker.control_group import own_control_group

GIB = 1 << 30
NONE_IN_VERSION_1 = (1 << 63) - 4096
VERSION_1 = "9:name=systemd:/docker/c0ffee\n4:memory:/docker/c0ffee\n3:cpuset:/docker/c0ffee\n"


class Kernel:
    """Folders of control groups, and the file that names the group of a process."""

    def __init__(self, folder: Path) -> None:
        self.mount, self.own = folder / "cgroup", folder / "own"
        self.mount.mkdir()

    def write(self, name: str, text: object) -> None:
        path = self.mount / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")

    def limit(self, names: str) -> int:
        self.own.write_text(names)
        return own_control_group(self.mount, self.own).limit_bytes

    def kills(self, names: str) -> int:
        self.own.write_text(names)
        return own_control_group(self.mount, self.own).oom_kills

    def cores(self, names: str) -> float:
        self.own.write_text(names)
        return own_control_group(self.mount, self.own, controller="cpu").core_limit


@pytest.fixture
def kernel(tmp_path: Path) -> Kernel:
    return Kernel(tmp_path)


def test_a_container_of_version_2_sees_its_group_at_the_root(kernel: Kernel) -> None:
    kernel.write("memory.max", 2 * GIB)
    kernel.write("memory.events", "low 0\nhigh 0\nmax 7\noom 2\noom_kill 1\noom_group_kill 0")
    assert (kernel.limit("0::/\n"), kernel.kills("0::/\n")) == (2 * GIB, 1)


def test_a_container_of_version_1_sees_its_group_at_the_root_under_the_hosts_name(kernel: Kernel) -> None:
    kernel.write("memory/memory.limit_in_bytes", 3 * GIB)
    kernel.write("memory/memory.oom_control", "oom_kill_disable 0\nunder_oom 0\noom_kill 4")
    assert (kernel.limit(VERSION_1), kernel.kills(VERSION_1)) == (3 * GIB, 4)


@pytest.mark.parametrize(
    ("prefix", "file", "none", "names"),
    [
        ("", "memory.max", "max", "0::/system.slice/edge.service\n"),
        ("memory/", "memory.limit_in_bytes", NONE_IN_VERSION_1, "4:cpu,memory:/system.slice/edge.service\n0::/\n"),
    ],
)
def test_the_groups_around_limit_too(kernel: Kernel, prefix: str, file: str, none: object, names: str) -> None:
    kernel.write(f"{prefix}system.slice/edge.service/{file}", none)
    kernel.write(f"{prefix}system.slice/{file}", none)
    assert kernel.limit(names) == 0
    kernel.write(f"{prefix}system.slice/{file}", 5 * GIB)
    assert kernel.limit(names) == 5 * GIB
    kernel.write(f"{prefix}system.slice/edge.service/{file}", GIB)
    assert kernel.limit(names) == GIB


def test_a_machine_with_both_versions_has_its_memory_in_the_first(kernel: Kernel) -> None:
    names = VERSION_1 + "0::/system.slice/docker.service\n"
    kernel.write("memory/docker/c0ffee/memory.limit_in_bytes", GIB)
    kernel.write("unified/system.slice/docker.service/cgroup.procs", "1")
    assert kernel.limit(names) == GIB


def test_a_memory_controller_without_a_folder_is_that_of_version_2(kernel: Kernel) -> None:
    kernel.write("memory.max", GIB)
    assert kernel.limit("0::/\n") == GIB


def test_a_container_may_use_some_of_the_cores(kernel: Kernel) -> None:
    kernel.write("cpu.max", "150000 100000")
    assert kernel.cores("0::/\n") == 1.5
    kernel.write("cpu.max", "max 100000")
    assert kernel.cores("0::/\n") == 0
    kernel.write("cpu/docker/c0ffee/cpu.cfs_quota_us", 200_000)
    kernel.write("cpu/docker/c0ffee/cpu.cfs_period_us", 50_000)
    assert kernel.cores("4:cpu,cpuacct:/docker/c0ffee\n") == 4
    kernel.write("cpu/docker/c0ffee/cpu.cfs_quota_us", -1)
    assert kernel.cores("4:cpu,cpuacct:/docker/c0ffee\n") == 0


def test_where_nothing_is_told_there_is_no_limit(kernel: Kernel) -> None:
    missing = own_control_group(kernel.mount, kernel.own)
    assert (missing.folders, missing.limit_bytes, missing.oom_kills) == ((), 0, 0)
    assert kernel.limit("0::/\n") == kernel.kills("0::/\n") == 0
    kernel.write("memory.max", "rubbish")
    assert kernel.limit("0::/\n") == 0


def test_a_path_does_not_lead_out_of_the_mount(kernel: Kernel) -> None:
    kernel.write("../memory.max", GIB)
    assert kernel.limit("0::/../..\n") == 0


def test_this_process_has_one() -> None:
    group = own_control_group()
    assert all(folder.is_dir() for folder in group.folders)
    assert group.limit_bytes >= 0
    assert group.oom_kills >= 0
