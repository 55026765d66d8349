"""The stack of docker-compose.yml in an engine of the tests' own, as an operator drives it: up, scale, kill, look."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import httpx

from capture2vr.cli.up import free_port
from tests.referees.docker.engine import Engine
from tests.referees.docker.stand_ins import VARIABLES
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

_POLL_S = 0.3
_STARTED_JOB = re.compile(r"job (\w+) starts")


@dataclass(slots=True)
class Stack:
    """The services of one compose project. variables: those of docker-compose.yml, beside the stand-ins'"""

    engine: Engine
    port: int = field(default_factory=free_port)
    variables: dict[str, str] = field(default_factory=dict)
    profiles: tuple[str, ...] = ()

    @property
    def url(self) -> str:
        """Where the edge cache is published."""
        return f"http://127.0.0.1:{self.port}"

    def compose(self, *arguments: str) -> str:
        """Run docker compose; what it printed. A user's own .env is not read."""
        profiles = [word for profile in self.profiles for word in ("--profile", profile)]
        command = ["compose", "--project-directory", ROOT, "--env-file", os.devnull, "-p", "c2v", *profiles, *arguments]
        return self.engine.docker(*command, **VARIABLES, PORT=str(self.port), **self.variables)

    def up(self, *arguments: str) -> float:
        """Bring the services up, and wait until all are healthy; seconds."""
        began = time.monotonic()
        self.compose("up", "-d", "--wait", "--no-build", *arguments)
        return time.monotonic() - began

    def down(self, *arguments: str) -> None:
        self.compose("down", "--remove-orphans", "-t", "5", *arguments)

    def bucket_after(self) -> float:
        """Seconds from the start of the store's container until the bucket was made in it."""
        store, bucket = (self.inspect(self.compose("ps", "-aq", name).strip())["State"] for name in ("store", "bucket"))
        return (_moment(bucket["FinishedAt"]) - _moment(store["StartedAt"])).total_seconds()

    def containers(self, service: str) -> list[str]:
        """Ids of the running containers of a service."""
        return self.compose("ps", "-q", service).split()

    def inspect(self, container: str) -> dict[str, Any]:
        """What the engine knows of a container."""
        (found,) = json.loads(self.engine.docker("inspect", container))
        return dict(found)

    def kill(self, container: str) -> None:
        """End a container's first process as `kill -9` does: the engine starts the container again by its policy."""
        os.kill(int(self.inspect(container)["State"]["Pid"]), signal.SIGKILL)

    def kill_for_good(self, container: str) -> None:
        """End a container's first process as `kill -9` does, and have the engine not start it again until `up`."""
        policy = self.inspect(container)["HostConfig"]["RestartPolicy"]["Name"]
        self.engine.docker("update", "--restart=no", container)
        self.kill(container)
        wait_until(lambda: not self.inspect(container)["State"]["Running"], f"{container} has ended")
        self.engine.docker("update", f"--restart={policy}", container)

    def healthy_after(self, service: str) -> float:
        """Seconds from the start of a service's container until its first good health check."""
        state = self.inspect(self.containers(service)[0])["State"]
        ends = [check["End"] for check in state["Health"]["Log"] if check["ExitCode"] == 0]
        return (_moment(ends[0]) - _moment(state["StartedAt"])).total_seconds()

    def jobs_of_workers(self) -> dict[str, list[str]]:
        """The jobs that each running worker has begun, by container."""
        return {each: _STARTED_JOB.findall(self.logs(each)) for each in self.containers("edge")}

    def logs(self, container: str) -> str:
        """All that a container has written."""
        command = ["docker", "logs", container]
        done = subprocess.run(
            command, env=self.engine.variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True
        )
        return done.stdout

    def image_bytes(self, image: str) -> int:
        """Size of an image with all its layers, as `docker images` counts it."""
        return int(self.engine.docker("image", "inspect", "-f", "{{.Size}}", image))


def wait_until(holds: Callable[[], bool], what: str) -> None:
    """Wait until something is so. An engine or a service that is away meanwhile is asked again."""
    deadline = time.monotonic() + HANG_S
    while True:
        try:
            if holds():
                return
        except httpx.TransportError:
            pass
        assert time.monotonic() < deadline, f"timed out: {what}"
        time.sleep(_POLL_S)


def _moment(text: str) -> datetime:
    """A time of the engine's, which counts nanoseconds."""
    return datetime.fromisoformat(re.sub(r"(\.\d{6})\d*", r"\1", text).replace("Z", "+00:00"))
