"""docker-compose.yml in a real engine: captures in, assets out, kills, and more and fewer workers and gateways.

`make test-compose` runs it, and keeps its figures in deploy/README.md. The tests are one stack's acts, in this order.
"""

from __future__ import annotations

import os
import shlex
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from capture2vr.cli.deployment.deploy_work import CONTAINER_USER
from capture2vr.storage.catalogue.signing import generate_key
from tests.cli.local.test_run import capture2vr
from tests.referees.docker import stand_ins
from tests.referees.docker.client import Client
from tests.referees.docker.engine import Engine, running, why_not
from tests.referees.docker.figures import Figures
from tests.referees.docker.next_release import CONTRACTED, EXPANDED, releases, take_next, take_ours
from tests.referees.docker.requests import asked_meanwhile
from tests.referees.docker.stack import Stack, wait_until
from tests.support.clouds import write_ply
from tests.support.repository import ROOT

pytestmark = pytest.mark.compose

_EDGE_BYTES, _GATEWAY_BYTES = 1.2e9, 300e6
_RESTORE_S = 60.0  # at most, of the one command after `down -v`
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


@pytest.fixture(scope="module")
def backups(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the backups, as `deploy init` makes it, and beside it one of keys."""
    folder: Path = tmp_path_factory.mktemp("saved") / "backups"
    keys = folder.with_name("keys")
    for each in (folder, keys):
        each.mkdir(mode=0o700)
    generate_key(keys / "signing")
    for each in (folder, keys, *keys.iterdir()):
        os.chown(each, CONTAINER_USER, CONTAINER_USER)
    for parent in folder.parents[:3]:
        parent.chmod(0o755)  # pytest's own are root's alone
    return folder


def _save(stack: Stack, backups: Path, *arguments: str, **variables: str) -> str:
    """Run the service `backup`, as the runbook has it; what it said."""
    stack.variables |= {
        "BACKUPS": str(backups),
        "KEYS": str(backups.with_name("keys")),
        "CAPTURE2VR_BACKUP_PASSPHRASE": "a passphrase of a test",
    } | variables
    try:
        return stack.compose("run", "--rm", "backup", *arguments)
    finally:
        for name in ("BACKUPS", "KEYS", "CAPTURE2VR_BACKUP_PASSPHRASE", *variables):
            del stack.variables[name]


def _saved_lost_and_restored(stack: Stack, figures: Figures, backups: Path, kind: str) -> None:
    """Save all, lose all, and bring it back by one command."""
    client = Client(stack)
    before = {path: client.ask("GET", path) for path in ("/v1/jobs?limit=200", "/v1/assets?limit=100")}
    _save(stack, backups)
    began = time.monotonic()
    _save(stack, backups, "drill", "/backups")
    figures.note(f"{kind}: `run --rm backup drill /backups`", f"{time.monotonic() - began:.1f} s")
    stack.down("-v")
    began = time.monotonic()
    _save(stack, backups, "restore", "/backups")
    restored_s = time.monotonic() - began
    figures.note(f"{kind}: `run --rm backup restore /backups` after `down -v`", f"{restored_s:.1f} s, one command")
    figures.note("… and `up --wait`", f"{stack.up():.1f} s")
    wait_until(lambda: client.workers() == 1, "a worker")
    assert {path: client.ask("GET", path) for path in before} == before
    for asset in before["/v1/assets?limit=100"]["assets"]:
        for file in client.ask("GET", f"/v1/assets/{asset['key']}")["lods"]:
            httpx.get(file["url"]).raise_for_status()
    assert restored_s <= _RESTORE_S


def test_all_comes_back_after_down_v_on_sqlite(
    stack: Stack, client: Client, dome: Path, figures: Figures, backups: Path
) -> None:
    client.await_end(client.start(client.upload(dome), "saved", "draft"))
    _saved_lost_and_restored(stack, figures, backups, "SQLite")


def test_keys_come_back_first_where_they_are_lost(stack: Stack, backups: Path, tmp_path: Path) -> None:
    """By the runbook's own command."""
    (line,) = (
        each for each in (ROOT / "deploy" / "runbook.md").read_text().splitlines() if "--only keys --keys /new/" in each
    )
    (tmp_path / "keys").mkdir(mode=0o700)
    text = line.replace('"$PWD"', str(tmp_path)).replace("=…", "=a passphrase of a test")
    arguments = [
        word.replace("=a", "=a passphrase of a test") if "PASSPHRASE" in word else word
        for word in shlex.split(text.replace("=a passphrase of a test", "=a"))
    ]
    stack.variables["BACKUPS"] = str(backups)
    stack.compose(*arguments[2:])
    del stack.variables["BACKUPS"]
    restored = (tmp_path / "keys" / "containers" / "signing").read_bytes()
    assert restored == (backups.with_name("keys") / "signing").read_bytes()


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


def test_all_comes_back_after_down_v_on_postgres(stack: Stack, figures: Figures, backups: Path) -> None:
    """Before the next release comes: what it leaves in the database is restored by it alone."""
    _saved_lost_and_restored(stack, figures, backups, "Postgres")


def test_the_next_release_comes_and_goes_beside_this_one_while_jobs_run(
    stack: Stack, dome: Path, figures: Figures, upgraded: Engine
) -> None:
    """The runbook's order: the database first, then new gateways beside the old, then the old ones go. And back."""
    client = Client(stack)
    jobs = [client.start(client.upload(dome), f"upgraded-{number}", "standard") for number in range(3)]
    client.await_stage(jobs[0], "FITTING")
    with asked_meanwhile(stack) as load:
        for take, schema in ((take_next, EXPANDED), (take_ours, EXPANDED)):
            take(upgraded)
            stack.compose("run", "--rm", "migrate")
            assert _schema(stack) == schema
            old = stack.containers("gateway")
            stack.up("--no-deps", "--no-recreate", "--scale", "gateway=4", "gateway")
            beside = Client(stack)
            jobs.append(beside.start(beside.upload(dome), f"beside-{len(jobs)}", "draft"))
            for gateway in old:
                upgraded.docker("stop", gateway)
                upgraded.docker("rm", gateway)
            stack.up("--no-deps", "--no-recreate", "--scale", "gateway=2", "gateway")
    assert all("of a newer gateway, with which this one" in stack.logs(each) for each in stack.containers("gateway"))
    for job in jobs:
        client.await_end(job)
    figures.note(
        "next release and back, gateways one pair after the other",
        f"{load}; {len(jobs)} of {len(jobs)} jobs ended once",
    )
    assert load.failed == 0


def test_a_database_that_this_release_cannot_read_makes_no_endless_restart(
    stack: Stack, figures: Figures, backups: Path, upgraded: Engine
) -> None:
    """Its gateway waits, says why, and goes on once the backup of before is restored."""
    before = Client(stack).ask("GET", "/v1/jobs?limit=200")
    _save(stack, backups)
    take_next(upgraded, contracted=True)
    stack.compose("run", "--rm", "migrate")
    assert _schema(stack) == CONTRACTED
    take_ours(upgraded)
    with pytest.raises(RuntimeError, match="restore the backup that was made before the upgrade"):
        stack.compose("run", "--rm", "migrate")
    gateways = stack.containers("gateway")
    for gateway in gateways:
        upgraded.docker("restart", gateway)
    for gateway in gateways:
        wait_until(lambda gateway=gateway: "waiting, and answering 503" in stack.logs(gateway), "it says why")  # type: ignore[misc]
        assert stack.inspect(gateway)["RestartCount"] == 0
        assert stack.inspect(gateway)["State"]["Running"]
    assert httpx.get(f"{stack.url}/readyz").json()["code"] == "SCHEMA_NEWER"
    began = time.monotonic()
    stack.compose("stop", "gateway")
    stack.compose("rm", "-sf", "gateway", "migrate", "backup", "postgres")
    upgraded.docker("volume", "rm", "c2v_database")
    take_next(upgraded)  # the backup is of its schema, as it was made after going back from it
    _save(stack, backups, "restore", "/backups", "--only", "database")
    take_ours(upgraded)
    stack.up("--scale", "gateway=2")
    figures.note("back from a database that it cannot read", f"{time.monotonic() - began:.1f} s")
    assert Client(stack).ask("GET", "/v1/jobs?limit=200") == before


def _schema(stack: Stack) -> str:
    url, query = f"postgresql://capture2vr:{_PASSWORD}@127.0.0.1/capture2vr", "SELECT version_num FROM alembic_version"
    return stack.compose("exec", "-T", "postgres", "psql", url, "-tAc", query).strip()


@pytest.fixture(scope="module")
def upgraded(engine: Engine) -> Iterator[Engine]:
    """The engine, which has this release's image again at the end."""
    with releases(engine):
        yield engine


def test_in_the_end_every_job_has_ended_well(stack: Stack, figures: Figures) -> None:
    jobs = Client(stack).ask("GET", "/v1/jobs?limit=200")["jobs"]
    assert {each["state"] for each in jobs} == {"SUCCEEDED"}
    took_over = _shares(stack, "reattaching to its run")
    figures.note("jobs on Postgres", f"{len(jobs)}, all SUCCEEDED; runs taken over after a kill: {took_over}")
