"""A service's secrets are its own: no process that it starts may read them, though it is of the same user."""

from __future__ import annotations

import subprocess
import sys

import pytest

SERVICE = """
import ctypes, os, subprocess, sys
from capture2vr.process.private_files import hide_secrets
if os.geteuid() == 0:  # root may read everything
    os.setgid(65534)
    os.setuid(65534)
    ctypes.CDLL(None).prctl(4, 1)  # as a process of this user has it from its start
if sys.argv[1] == "hidden":
    hide_secrets()
read = subprocess.run(["cat", f"/proc/{os.getpid()}/environ"], capture_output=True).stdout
print("SECRET=yes" in read.decode())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other kernels have other ways")
@pytest.mark.parametrize(("way", "is_read"), [("hidden", "False"), ("shown", "True")])
def test_a_child_does_not_read_its_parents_variables(way: str, is_read: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", "yes")
    done = subprocess.run([sys.executable, "-c", SERVICE, way], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == is_read
