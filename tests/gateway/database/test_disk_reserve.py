"""On a full disk the service starts, reads and deletes; what wants space is refused with 507."""

from __future__ import annotations

import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from capture2vr.gateway.database import disk_reserve
from capture2vr.gateway.database.disk_reserve import RESERVE_BYTES, DiskReserve
from tests.support.patience import HANG_S

_MOUNT = (
    "mount -t tmpfs -o size=120m none {folder} && exec {python} -m tests.gateway.database.full_disk_journey {folder}"
)
_Usage = namedtuple("_Usage", ["free"])


@pytest.mark.slow
def test_a_full_disk_is_read_and_emptied(tmp_path: Path) -> None:
    """It did not start, and deletions failed with 503. The disk is one of memory, which goes with its process."""
    if subprocess.run(["unshare", "-rm", "mount", "-t", "tmpfs", "none", tmp_path], check=False).returncode:
        pytest.skip("this machine lets nobody mount a disk of memory")
    script = _MOUNT.format(folder=tmp_path, python=sys.executable)
    ended = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, timeout=HANG_S)
    assert ended.returncode == 0, ended.stderr
    assert [line for line in ended.stdout.splitlines() if line[:1].isdigit()] == ["200 507 200"] * 2, ended.stdout
    assert ended.stdout.splitlines()[-1].endswith("is full, so that its database cannot be opened: free some space")


@pytest.mark.parametrize(("free", "is_held"), [(10**9, True), (RESERVE_BYTES, False)])
def test_the_reserve_is_taken_where_there_is_space(
    free: int, is_held: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk_reserve.shutil, "disk_usage", lambda _: _Usage(free))
    DiskReserve(tmp_path).hold()
    assert [file.stat().st_blocks * 512 >= RESERVE_BYTES for file in tmp_path.iterdir()] == [True] * is_held


def test_the_reserve_is_given_up_when_the_disk_is_full_and_no_earlier(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reserve = DiskReserve(tmp_path)
    reserve.hold()
    (held,) = tmp_path.iterdir()
    reserve.give_up_if_full()
    assert held.exists()
    monkeypatch.setattr(disk_reserve.shutil, "disk_usage", lambda _: _Usage(1000))
    reserve.give_up_if_full()
    assert not held.exists()
    reserve.give_up_if_full()
    reserve.hold()
    assert not held.exists()
