"""docker-compose.yml in a real engine: captures in, assets out, kills, and more and fewer workers and gateways.

`make test-compose` runs it, and keeps its figures in deploy/README.md. The tests are one stack's acts, in this order.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from tests.cli.local.test_run import capture2vr
from tests.referees.docker import stand_ins
from tests.referees.docker.engine import Engine, running, why_not
from tests.referees.docker.figures import Figures
from tests.referees.docker.stack import Stack, wait_until
from tests.support.clouds import write_ply
from tests.support.patience import PATIENCE_S
from tests.support.repository import ROOT

pytestmark = pytest.mark.compose

_EDGE_BYTES, _GATEWAY_BYTES = 1.2e9, 300e6
_AWAY = {502, 503, 504}
_ENDED = {"SUCCEEDED", "FAILED", "CANCELLED"}
_PASSWORD = "of-a-database-of-tests"


@pytest.fixture(scope="module")
def figures(request: pytest.FixtureRequest) -> Iterator[Figures]:
    """What was measured; it goes into deploy/README.md when all has gone well, but for in CI."""
    noted, began, failed = Figures(), time.monotonic(), request.session.testsfailed
    load = os.getloadavg()[0]
    print()
    yield noted
    noted.note("all of it, without the images", f"{time.monotonic() - began:.0f} s")
    all_ran = request.session.testsfailed == failed and not request.config.getoption("keyword")
    if all_ran and os.environ.get("CI") != "true":
        machine = f"{os.cpu_count()} cores, load average {load:.1f} at the beginning"
        noted.write(ROOT / "deploy" / "README.md", f"Last run: {time.strftime('%Y-%m-%d')}, {machine}.")


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    """An engine with all images. $CAPTURE2VR_COMPOSE names a folder that keeps them for the next run."""
    if reason := why_not():
        pytest.skip(f"no engine: {reason}")
    kept = os.environ.get("CAPTURE2VR_COMPOSE")
    folder = Path(kept or tempfile.mkdtemp(prefix="engine-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with running(folder) as started:
            began = time.monotonic()
            stand_ins.build(started)
            print(f"\nimages built in {time.monotonic() - began:.0f} s")
            yield started
    finally:
        if not kept:
            shutil.rmtree(folder)


@pytest.fixture(scope="module")
def stack(engine: Engine, figures: Figures) -> Iterator[Stack]:
    """The stack, healthy."""
    made = Stack(engine)
    made.down("-v")
    try:
        load = os.getloadavg()[0]
        seconds = made.up()
        figures.note("`docker compose up --wait`, empty volumes", f"{seconds:.1f} s (load average {load:.1f})")
        bucket = made.bucket_after()
        figures.note("… until the store answered and the bucket was made", f"{bucket:.1f} s")
        figures.note("… from then on until all were healthy", f"{seconds - bucket:.1f} s")
        for service in ("edge", "gateway", "cdn"):
            figures.note(f"… container of `{service}` to its first good check", f"{made.healthy_after(service):.1f} s")
        yield made
    finally:
        (engine.folder / "stack.log").write_text(made.compose("logs", "--no-color"))
        made.down("-v")


@pytest.fixture(scope="module")
def dome(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a sphere, 3,000 points."""
    direction = np.random.default_rng(0).normal(size=(3000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 1] = np.abs(direction[:, 1])
    return write_ply(tmp_path_factory.mktemp("dome") / "dome.ply", 0.3 * direction)


class Client:
    """Asks the gateways through the edge cache; one that is away is asked again."""

    def __init__(self, stack: Stack) -> None:
        self._url = stack.url

    def ask(self, method: str, path: str, **request: Any) -> Any:
        """The JSON of an answer."""
        answers: list[httpx.Response] = []

        def is_answered() -> bool:
            answers.append(httpx.request(method, f"{self._url}{path}", timeout=PATIENCE_S, **request))
            return answers[-1].status_code not in _AWAY

        wait_until(is_answered, f"{method} {path}")
        assert answers[-1].is_success, answers[-1].text
        return answers[-1].json()

    def upload(self, file: Path) -> str:
        """Store a capture; its id."""
        files = {"file": (file.name, file.read_bytes())}
        return str(self.ask("POST", "/v1/captures", files=files)["capture"])

    def start(self, capture: str, key: str, preset: str) -> str:
        """Start a job; its id."""
        body = {"capture": capture, "asset_key": key, "preset": preset}
        return str(self.ask("POST", "/v1/jobs", json=body, headers={"Idempotency-Key": key})["id"])

    def job(self, job: str) -> dict[str, Any]:
        return dict(self.ask("GET", f"/v1/jobs/{job}"))

    def await_stage(self, job: str, stage: str) -> None:
        wait_until(lambda: self.job(job)["stage"] == stage, f"{job} in {stage}: {self.job(job)}")

    def await_end(self, job: str) -> dict[str, Any]:
        """Wait until a job has ended, and see that it ended well, and once."""
        wait_until(lambda: self.job(job)["state"] in _ENDED, f"{job} ends: {self.job(job)}")
        self.require_one_end(job)
        return self.job(job)

    def require_one_end(self, job: str) -> None:
        """Of all events of a job one is its end; of all versions of its asset one is the last."""
        lines = httpx.get(f"{self._url}/v1/jobs/{job}/events").raise_for_status().text.splitlines()
        datas = [json.loads(line[5:]) for line in lines if line.startswith("data:") and line[5:].strip()]
        numbers = [data["seq"] for data in datas]
        assert numbers == sorted(set(numbers)), "no event twice"
        assert [data["state"] for data in datas if data.get("state") in _ENDED] == ["SUCCEEDED"], self.job(job)
        found = self.job(job)
        entry = self.ask("GET", f"/v1/assets/{found['asset_key']}")
        assert entry["version"] == found["asset"]["version"]
        lasts = [each for each in entry["versions"] if each.get("last", each["state"] == "refined")]
        assert [each["version"] for each in lasts] == [entry["version"]], entry["versions"]

    def workers(self) -> int:
        """How many workers the gateway has heard of."""
        return len(self.ask("GET", "/v1/service")["workers"])


@pytest.fixture
def client(stack: Stack) -> Client:
    return Client(stack)


def test_images_are_small(stack: Stack, figures: Figures) -> None:
    edge, gateway, base = map(stack.image_bytes, ("capture2vr-edge", "capture2vr-gateway", "python:3.11-slim"))
    figures.note("image of the worker, at most 1.2 GB", f"{edge / 1e6:.0f} MB")
    figures.note("image of the gateway, at most 300 MB", f"{gateway / 1e6:.0f} MB")
    figures.note("… of each the stand-in for python:3.11-slim", f"{base / 1e6:.0f} MB")
    assert edge <= _EDGE_BYTES
    assert gateway <= _GATEWAY_BYTES


@pytest.mark.parametrize("kind", ["cloud", "RGB-D", "photos"])
def test_a_capture_goes_in_and_comes_out_of_the_cache_twice(
    stack: Stack, client: Client, figures: Figures, data_dir: Path, tmp_path: Path, kind: str
) -> None:
    key, source = f"pushed-{kind.lower()}", _capture(kind, data_dir, tmp_path)
    began = time.monotonic()
    pushed = capture2vr("push", source, "--gateway", stack.url, "--key", key, "--preset", "draft")
    assert pushed.returncode == 0, pushed.stderr
    pushed_s = time.monotonic() - began
    for number in (1, 2):
        out, cache = tmp_path / f"pulled{number}", tmp_path / f"cache{number}"
        pulled = capture2vr("pull", key, "-o", out, "--gateway", stack.url, "--cache", cache)
        assert pulled.returncode == 0, pulled.stderr
    first, second = (sorted(path.read_bytes() for path in (tmp_path / f"pulled{n}").rglob("*.glb")) for n in (1, 2))
    assert first == second != []
    entry = client.ask("GET", f"/v1/assets/{key}")
    urls = [file["url"] for file in (*entry["lods"], *entry["files"])]
    assert {httpx.get(url).raise_for_status().headers["X-Cache"] for url in urls} == {"HIT"}
    (job,) = (each["id"] for each in client.ask("GET", "/v1/jobs?limit=200")["jobs"] if each["asset_key"] == key)
    client.require_one_end(job)
    figures.note(
        f"{kind} pushed, reconstructed (`draft`)", f"{pushed_s:.1f} s; pulled twice, then {len(urls)} files HIT"
    )


def _capture(kind: str, data: Path, folder: Path) -> Path:
    """A small real capture: a room of 64,000 points, five depth frames of a living room, six photos of fruit."""
    if kind == "cloud":
        return data / "cloud_room" / "frag_115.ply"
    if kind == "RGB-D":
        return data / "rgbd_livingroom"
    photos = folder / "photos"
    photos.mkdir()
    for photo in sorted((data / "photos_fruit" / "images").glob("*.JPG"))[:6]:
        shutil.copy(photo, photos)
    return photos


@pytest.fixture(scope="module")
def undisturbed(stack: Stack, dome: Path, figures: Figures) -> float:
    """Seconds of a job that trains and that nobody disturbs, the second of its kind."""
    client = Client(stack)
    capture = client.upload(dome)
    for number in (1, 2):
        job = client.await_end(client.start(capture, f"calm-{number}", "standard"))
    seconds = float(job["elapsed_s"])
    figures.note("3,000 points, trained (`standard`), undisturbed", f"{seconds:.1f} s")
    return seconds


@pytest.mark.parametrize("service", ["edge", "gateway", "store"])
def test_a_job_outlives_a_kill(
    stack: Stack, client: Client, dome: Path, figures: Figures, undisturbed: float, service: str
) -> None:
    job = client.start(client.upload(dome), f"killed-{service}", "standard")
    client.await_stage(job, "FITTING")
    (container,) = stack.containers(service)
    stack.kill(container)
    ended = client.await_end(job)
    assert stack.inspect(container)["RestartCount"] == 1, "the engine has started it again"
    cost = ended["elapsed_s"] - undisturbed
    figures.note(f"kill -9 of `{service}` in mid-job", f"{cost:+.1f} s, attempts {ended['attempts']}, ended once")


def test_three_workers_share_twelve_jobs(stack: Stack, client: Client, dome: Path, figures: Figures) -> None:
    seconds = stack.up("--scale", "edge=3", "--no-recreate")
    wait_until(lambda: client.workers() == 3, "three workers")
    before = stack.jobs_of_workers()
    capture = client.upload(dome)
    began = time.monotonic()
    jobs = [client.start(capture, f"shared-{number}", "draft") for number in range(12)]
    for job in jobs:
        client.await_end(job)
    took = time.monotonic() - began
    shares = sorted(len(done) - len(before[worker]) for worker, done in stack.jobs_of_workers().items())
    figures.note("`up --scale edge=3`, until healthy", f"{seconds:.1f} s")
    figures.note("12 jobs at once on three workers", f"{'/'.join(map(str, shares))}, {took:.1f} s")
    assert sum(shares) == 12
    assert min(shares) >= 3, "no worker is left out"


def test_workers_that_go_lose_nothing(stack: Stack, client: Client, dome: Path, figures: Figures) -> None:
    capture = client.upload(dome)
    jobs = [client.start(capture, f"drained-{number}", "standard") for number in range(4)]
    wait_until(lambda: client.ask("GET", "/v1/queue")["running"] == 3, "all three at work")
    began = time.monotonic()
    stack.up("--scale", "edge=1", "--no-recreate")
    drained_s = time.monotonic() - began
    assert len(stack.containers("edge")) == 1
    attempts = [client.await_end(job)["attempts"] for job in jobs]
    figures.note(
        "`up --scale edge=1` while three jobs run", f"{drained_s:.1f} s; 4 of 4 jobs ended once, attempts {attempts}"
    )


def test_two_gateways_share_a_postgres(stack: Stack, dome: Path, figures: Figures) -> None:
    stack.down()
    stack.profiles = ("postgres",)
    url = f"postgresql://capture2vr:{_PASSWORD}@postgres/capture2vr"
    stack.variables = {"POSTGRES_PASSWORD": _PASSWORD, "GATEWAY_DATABASE_URL": url}
    seconds, load = stack.up(), os.getloadavg()[0]
    figures.note("`--profile postgres up --wait`", f"{seconds:.1f} s (load average {load:.1f})")
    figures.note("`up --scale gateway=2`", f"{stack.up('--scale', 'gateway=2', '--no-recreate'):.1f} s")
    client = Client(stack)
    wait_until(lambda: client.workers() == 1, "a worker")
    capture = client.upload(dome)
    jobs = [client.start(capture, f"both-{number}", "draft") for number in range(8)]
    for job in jobs:
        client.await_end(job)
    asked = _shares(stack, "POST /v1/jobs 202")
    figures.note("8 jobs, asked of two gateways", f"{asked}, each ended once")
    assert "0" not in asked.split(" and "), asked


def _shares(stack: Stack, line: str) -> str:
    """How often each gateway has written a line."""
    return " and ".join(str(stack.logs(gateway).count(line)) for gateway in stack.containers("gateway"))


def test_a_gateway_takes_over_the_run_of_one_that_is_gone(stack: Stack, dome: Path, figures: Figures) -> None:
    client = Client(stack)
    job = client.start(client.upload(dome), "taken-over", "standard")
    client.await_stage(job, "FITTING")
    (gone,) = (each for each in stack.containers("gateway") if f"job {job} is given to worker" in stack.logs(each))
    stack.kill_for_good(gone)
    ended = client.await_end(job)
    (survivor,) = stack.containers("gateway")
    assert survivor != gone
    assert f"job {job}: reattaching to its run" in stack.logs(survivor)
    assert ended["attempts"] == 1
    figures.note(
        "kill -9 of the gateway that follows a job, for good",
        f"{ended['elapsed_s']:.1f} s, taken over by the other, attempts 1, ended once",
    )
    stack.up("--scale", "gateway=2", "--no-recreate")


@pytest.mark.parametrize("number", [0, 1])
def test_a_gateway_is_killed_beside_another(stack: Stack, dome: Path, figures: Figures, number: int) -> None:
    """Whichever of the two follows the job: its end comes once."""
    client = Client(stack)
    job = client.start(client.upload(dome), f"gateway-{number}", "standard")
    client.await_stage(job, "FITTING")
    stack.kill(sorted(stack.containers("gateway"))[number])
    ended = client.await_end(job)
    cost = f"{ended['elapsed_s']:.1f} s, attempts {ended['attempts']}, ended once"
    figures.note(f"kill -9 of gateway {number + 1} of 2 in mid-job", cost)


def test_in_the_end_every_job_has_ended_well(stack: Stack, figures: Figures) -> None:
    jobs = Client(stack).ask("GET", "/v1/jobs?limit=200")["jobs"]
    assert {each["state"] for each in jobs} == {"SUCCEEDED"}
    took_over = _shares(stack, "reattaching to its run")
    figures.note("jobs on Postgres", f"{len(jobs)}, all SUCCEEDED; runs taken over after a kill: {took_over}")
