"""Run a program in a network of its own, with loopback alone.

    python -m tests.support.network.own_network MODULE ARGUMENT…

Ray looks for this machine's address in the world, and asks for it there; here it finds 127.0.0.1.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import struct
import subprocess
import sys

_SIOCSIFFLAGS, _IFF_UP = 0x8914, 1  # of netdevice(7)


def command(module: str, *arguments: str) -> list[str] | None:
    """The command that runs a module so; None where this machine does not let us."""
    for flags in ("-n", "-rn"):
        if shutil.which("unshare") and subprocess.run(["unshare", flags, "true"], capture_output=True).returncode == 0:
            return ["unshare", flags, sys.executable, "-m", "tests.support.network.own_network", module, *arguments]
    return None


if __name__ == "__main__":
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack("16sh14x", b"lo", _IFF_UP))
    os.execv(sys.executable, [sys.executable, "-m", *sys.argv[1:]])
