"""A Docker engine of the tests' own: a daemon on a socket in a folder, which holds its images and containers too.

The engine of whoever works on this machine is left alone: its images would be replaced by stand-ins of the same name.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.support.repository import ROOT

_PACKAGES = ("docker.io", "iptables", "mmdebstrap")
_PROGRAMS = ("dockerd", "docker", "iptables", "mmdebstrap")
_ADDRESSES = "base=10.213.0.0/16,size=24"  # of the networks of containers
_START_S = 60.0
_STOP_S = 60.0
_FREE_DISK_BYTES = 15e9  # 9 GB were used: stand-ins 1 GB, images with their layers 5 GB, volumes
_FREE_MEMORY_BYTES = 6e9  # the stack takes 3 GB, with three workers at work


@dataclass(frozen=True, slots=True)
class Engine:
    """A running engine and the folder that holds all it has."""

    folder: Path

    @property
    def variables(self) -> dict[str, str]:
        """Environment of the docker command line."""
        return {
            "PATH": os.environ["PATH"],
            "HOME": str(self.folder),
            "DOCKER_HOST": f"unix://{self.folder}/docker.sock",
            "DOCKER_CONFIG": str(self.folder / "config"),
        }

    def docker(self, *arguments: str | Path, **variables: str) -> str:
        """Run the docker command line; what it printed. Raises RuntimeError with its own words."""
        command = ["docker", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, env=self.variables | variables)
        if done.returncode:
            raise RuntimeError(
                f"docker {' '.join(map(str, arguments[:9]))}: {done.stdout[-1000:]}{done.stderr[-3000:]}"
            )
        return done.stdout


def why_not() -> str | None:
    """Why no engine can be started here; None: one can."""
    if os.geteuid() != 0:
        return "a Docker engine needs root"
    if not shutil.which("apt-get"):
        return "its packages need Debian's apt-get"
    if any(_is_daemon(process) for process in Path("/proc").glob("[0-9]*/comm")):
        return "another Docker engine runs on this machine: both would use the same rules of iptables"
    if (free := shutil.disk_usage("/").free) < _FREE_DISK_BYTES:
        return f"{free / 1e9:.0f} GB of disk are free, and {_FREE_DISK_BYTES / 1e9:.0f} are needed"
    if (free := available_memory()) < _FREE_MEMORY_BYTES:
        return f"{free / 1e9:.0f} GB of memory are free, and {_FREE_MEMORY_BYTES / 1e9:.0f} are needed"
    return None if _install() else f"{', '.join(_PACKAGES)} cannot be installed"


def available_memory() -> int:
    """Bytes of memory that programs may still take."""
    line = next(line for line in Path("/proc/meminfo").read_text().splitlines() if line.startswith("MemAvailable"))
    return int(line.split()[1]) * 1024


@contextmanager
def running(folder: Path) -> Iterator[Engine]:
    """The engine, until the block ends. What the folder holds of an earlier one is used. Raises RuntimeError."""
    engine = Engine(folder)
    subprocess.run(["bash", ROOT / "tests" / "deploy" / "compose-plugin.sh", folder / "config"], check=True)
    command = ["dockerd", "--bridge", "none", "--default-address-pool", _ADDRESSES]
    command += ["--data-root", f"{folder}/data", "--exec-root", f"{folder}/exec", "--pidfile", f"{folder}/docker.pid"]
    command += ["-H", f"unix://{folder}/docker.sock", "--default-ulimit", "nofile=20000:20000"]
    command += ["--exec-opt", "native.cgroupdriver=cgroupfs"]
    with (folder / "dockerd.log").open("wb") as log:
        daemon = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
    try:
        _wait(engine, daemon)
        yield engine
    finally:
        daemon.send_signal(signal.SIGTERM)
        daemon.wait(_STOP_S)
        _unmount(folder)


def _wait(engine: Engine, daemon: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + _START_S
    while subprocess.run(["docker", "info"], env=engine.variables, capture_output=True).returncode:
        if daemon.poll() is not None or time.monotonic() > deadline:
            raise RuntimeError(f"the engine did not start: {(engine.folder / 'dockerd.log').read_text()[-1000:]}")
        time.sleep(0.1)


def _unmount(folder: Path) -> None:
    """Unmount what the engine leaves mounted below its folder, such as network namespaces."""
    mounted = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
    for target in reversed([target for target in mounted if target.startswith(f"{folder}/")]):
        subprocess.run(["umount", "-l", target], check=True)


def _is_daemon(comm: Path) -> bool:
    try:
        return comm.read_text().strip() == "dockerd"
    except OSError:  # it has ended meanwhile
        return False


def _install() -> bool:
    if all(map(shutil.which, _PROGRAMS)):
        return True
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for command in (("update",), ("install", "-y", "--no-install-recommends", *_PACKAGES)):
        if subprocess.run(("apt-get", *command), env=environment, capture_output=True).returncode:
            return False
    return True
