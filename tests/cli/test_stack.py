"""`up`, `push`, `pull` as three people would use them, and the demo."""

from __future__ import annotations

import functools
import hashlib
import http.server
import json
import os
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import psutil
import pytest
from PIL import Image

from capture2vr.cli.demonstration.demo import run_demo
from capture2vr.cli.up import free_port, is_free, run_stack
from capture2vr.client.jobs import follow
from capture2vr.errors import BadInput
from tests.cli.local.test_run import capture2vr
from tests.conftest import missing
from tests.support.clouds import write_ply
from tests.support.command_lines import command_of, setting_of
from tests.support.patience import HANG_S

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of `capture2vr up`, as an older version has left it."""
    folder = tmp_path_factory.mktemp("up")
    folder.chmod(0o755)
    return folder


@pytest.fixture(scope="module")
def url(data: Path) -> Iterator[str]:
    """The URL that `capture2vr up` prints."""
    port = free_port()
    command = [sys.executable, "-m", "capture2vr.cli", "up", "--port", str(port), "--data", str(data)]
    environment = {**os.environ, "EDGE_DEVICE": "cpu"}  # a worker that looks for a GPU imports PyTorch
    child = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True, bufsize=1)
    try:
        assert child.stderr is not None
        said = next(line for line in child.stderr if "capture page" in line)
        assert f"http://127.0.0.1:{port}/" in said
        yield f"http://127.0.0.1:{port}"
    finally:
        child.send_signal(signal.SIGINT)
        child.communicate(timeout=HANG_S)
    assert child.returncode == 0


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A long leaf, 1,000 points, slightly bent: a narrow thing covers little of its pictures."""
    rng = np.random.default_rng(2)
    radius, angle = np.sqrt(rng.random(1000)) * 0.1, rng.random(1000) * 2 * np.pi
    x, z = 0.2 * radius * np.cos(angle), radius * np.sin(angle)
    return write_ply(tmp_path_factory.mktemp("disk") / "leaf.ply", np.c_[x, 3 * x**2, z])


@pytest.mark.essential
def test_what_was_pushed_can_be_pulled_by_its_key(url: str, disk: Path, tmp_path: Path) -> None:
    asked = ("--key", "leaf", "--preset", "draft", "--collection", "tree")
    pushed = capture2vr("push", disk, "--gateway", url, *asked)
    assert pushed.returncode == 0, pushed.stderr
    assert f"{url}/view/leaf, in collection tree" in pushed.stderr
    assert pushed.stderr.count(f"preview  {url}/view/leaf") == 1
    assert "leaf" in capture2vr("ls", "--gateway", url, "--collection", "tree").stdout
    hostile = capture2vr("push", disk, "--gateway", url, *asked[:-1], "../wood")
    assert (hostile.returncode, "not a valid collection" in hostile.stderr, "UPLOADING" in hostile.stderr) == (
        2,
        True,
        False,
    )
    elsewhere = capture2vr("push", disk, "--gateway", url, *asked[:-1], "wood")
    assert (elsewhere.returncode, "in collection tree, not in wood" in elsewhere.stderr) == (2, True)

    with urllib.request.urlopen(f"{url}/v1/assets/leaf") as answer:
        entry = json.load(answer)
    pulled = capture2vr("pull", "leaf", "-o", tmp_path / "pulled", "--gateway", url, "--cache", tmp_path / "cache")
    assert pulled.returncode == 0, pulled.stderr
    for lod in entry["lods"]:
        content = (tmp_path / "pulled" / f"lod{lod['level']}.glb").read_bytes()
        assert hashlib.sha256(content).hexdigest() == lod["sha256"]

    # A rotten cache entry is noticed and fetched again; a good one is not fetched twice.
    rotten = tmp_path / "cache" / entry["lods"][0]["sha256"]
    rotten.write_bytes(b"rotten")
    again = capture2vr("pull", "leaf", "-o", tmp_path / "again", "--gateway", url, "--cache", tmp_path / "cache")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "again" / "lod0.glb").read_bytes() == (tmp_path / "pulled" / "lod0.glb").read_bytes()
    assert again.stderr.count("network") == 1


def test_no_other_user_of_the_machine_may_read_what_it_keeps(url: str, disk: Path, data: Path) -> None:
    """The jobs' database has the secret that signs sessions, and captures are everybody's own."""
    pushed = capture2vr("push", disk, "--gateway", url, "--key", "mine", "--preset", "draft")
    assert pushed.returncode == 0, pushed.stderr
    assert data.stat().st_mode & 0o077 == 0
    kept = [path for place in ("gateway", "store", "scratch") for path in (data / place).rglob("*")]
    assert any(path.suffix == ".glb" for path in kept)
    assert [path for path in kept if path.stat().st_mode & 0o077] == []


@pytest.mark.skipif(os.geteuid() != 0, reason="who is not root may not look into a service")
def test_no_other_user_of_the_machine_may_start_jobs(url: str, data: Path) -> None:
    """The worker asks for no token: it listens on no port, but on a socket that its user alone may open."""
    working = [
        each
        for each in psutil.process_iter()
        if "edge" in command_of(each)[-2:] and str(data) in setting_of(each, "EDGE_SCRATCH")
    ]
    assert len(working) == 1
    for each in (*working, *working[0].children(recursive=True)):
        assert [line for line in each.net_connections("tcp") if line.status == "LISTEN"] == []
    (address,) = {line.laddr for line in working[0].net_connections("unix") if line.laddr.endswith("edge.sock")}
    assert Path(address).parent.stat().st_mode & 0o077 == 0


def test_a_second_push_makes_a_second_version(url: str, disk: Path) -> None:
    for version in (1, 2):
        assert capture2vr("push", disk, "--gateway", url, "--key", "twice", "--preset", "draft").returncode == 0
        with urllib.request.urlopen(f"{url}/v1/assets/twice") as answer:
            assert json.load(answer)["version"] == version


def test_a_rectangle_is_pushed_with_its_photo(url: str, disk: Path, tmp_path: Path) -> None:
    rgb = np.full((300, 400, 3), 215, np.uint8)
    rgb[90:210, 60:160], rgb[90:210, 230:350] = (180, 40, 30), (30, 60, 170)
    photo = tmp_path / "squares.png"
    Image.fromarray(rgb).save(photo)
    asked = ("--gateway", url, "--preset", "draft", "--box", "0.55,0.2,0.95,0.8")
    pushed = capture2vr("push", photo, "--key", "square", *asked)
    assert pushed.returncode == 0, pushed.stderr
    with urllib.request.urlopen(f"{url}/v1/assets/square") as answer:
        manifest_url = json.load(answer)["manifest"]["url"]
    with urllib.request.urlopen(manifest_url) as answer:
        red, _, blue = np.array(json.load(answer)["anchors"]["rgb"]).reshape(-1, 3).mean(axis=0)
    assert blue > red + 50
    refused = capture2vr("push", disk, "--key", "leaf-box", *asked)
    assert refused.returncode == 2
    assert "the capture has no photo (ply)" in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["push", "nowhere.ply", "--key", "x"], "nowhere.ply"),
        (["pull", "never-made", "-o", "x"], "never-made"),
        (["pull", "../jobs", "-o", "x"], "not a valid asset key"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_sentence(url: str, arguments: list[str], word: str, tmp_path: Path) -> None:
    result = capture2vr(*arguments, "--gateway", url, cwd=tmp_path)
    assert result.returncode == 2
    assert word in result.stderr
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_bad_key_and_a_bad_preset_are_told_by_the_gateway(url: str, disk: Path) -> None:
    bad_key = capture2vr("push", disk, "--gateway", url, "--key", "a/../b")
    assert bad_key.returncode == 2
    assert "begin with a letter or digit" in bad_key.stderr
    bad_preset = capture2vr("push", disk, "--gateway", url, "--key", "ok", "--preset", "magic")
    assert bad_preset.returncode == 2
    assert "draft" in bad_preset.stderr


def test_no_gateway_is_said_plainly(disk: Path) -> None:
    result = capture2vr("push", disk, "--gateway", f"http://127.0.0.1:{free_port()}", "--key", "x")
    assert result.returncode == 2
    assert "cannot be reached" in result.stderr


def test_a_proxy_may_answer_for_a_gateway_that_restarts_and_a_busy_tenant_have_to_wait() -> None:
    ended = {"state": "SUCCEEDED", "stage": "", "fraction": 1.0}
    answers = iter([*map(httpx.Response, (502, 503, 429)), httpx.Response(200, text="")])

    def serve(request: httpx.Request) -> httpx.Response:
        return next(answers) if request.url.path.endswith("/events") else httpx.Response(200, json=ended)

    with httpx.Client(base_url="http://gateway", transport=httpx.MockTransport(serve)) as client:
        assert list(follow(client, "job_1")) == [ended]


@pytest.mark.parametrize("host", ["::", "::1"])
def test_the_services_listen_on_ipv6(host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not is_free("::1", 0):
        missing("IPv6")
    monkeypatch.setenv("EDGE_DEVICE", "cpu")
    with run_stack(host, 0, tmp_path, everybody=True) as stack:
        assert stack.url.startswith("http://[::1]:")
        assert "there is no collection default" in capture2vr("ls", "--gateway", stack.url).stderr


def test_a_data_folder_in_use_is_said_plainly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_DEVICE", "cpu")
    with run_stack("127.0.0.1", 0, tmp_path):
        second = capture2vr("up", "--port", "0", "--data", tmp_path)
    said = f"capture2vr: the service gateway cannot start: another gateway uses {tmp_path / 'gateway'}: "
    assert (second.returncode, second.stderr.startswith(said)) == (2, True), second.stderr


def test_a_port_that_is_none_is_said_plainly(tmp_path: Path) -> None:
    result = capture2vr("up", "--port", "99999", "--data", tmp_path / "data")
    assert (result.returncode, "Traceback" in result.stderr) == (2, False)
    assert not (tmp_path / "data").exists()


def test_a_taken_port_is_said_plainly(url: str, tmp_path: Path) -> None:
    result = capture2vr("up", "--port", url.rsplit(":", 1)[1], "--data", tmp_path / "data")
    assert result.returncode == 2
    assert "--port" in result.stderr


@pytest.mark.parametrize("wrapper", [["env", "--default-signal=HUP"], ["nohup"]], ids=["terminal", "nohup"])
def test_a_terminal_that_is_closed_ends_the_services_too(tmp_path: Path, wrapper: list[str]) -> None:
    """The tests themselves may run with the signal ignored, which their processes inherit."""
    port = free_port()
    command = [sys.executable, "-m", "capture2vr.cli", "up", "--port", str(port), "--data", str(tmp_path / "data")]
    with subprocess.Popen([*wrapper, *command], stderr=subprocess.PIPE, text=True) as product:
        try:
            assert product.stderr is not None
            assert any("capture page" in line for line in product.stderr)
            product.send_signal(signal.SIGHUP)
            if wrapper == ["nohup"]:
                assert httpx.get(f"http://127.0.0.1:{port}/livez").is_success
                product.send_signal(signal.SIGINT)
            assert product.wait(HANG_S) == 0
        finally:
            if product.poll() is None:
                product.send_signal(signal.SIGINT)
    with pytest.raises(httpx.TransportError):
        httpx.get(f"http://127.0.0.1:{port}/livez")


@pytest.mark.essential
@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's signal at a parent's death is Linux's")
def test_an_up_that_is_killed_leaves_no_service_behind(tmp_path: Path) -> None:
    port = free_port()
    command = [sys.executable, "-m", "capture2vr.cli", "up", "--port", str(port), "--data", str(tmp_path / "data")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as product:
        assert product.stderr is not None
        assert any("capture page" in line for line in product.stderr)
        services = psutil.Process(product.pid).children(recursive=True)
        assert services
        product.kill()
    _, alive = psutil.wait_procs(services, timeout=HANG_S)
    assert not alive
    assert is_free("127.0.0.1", port)


def test_a_start_that_waits_for_its_store_can_be_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = {"STORAGE_KIND": "s3", "STORAGE_ENDPOINT": f"http://127.0.0.1:{free_port()}", "STORAGE_BUCKET": "b"}
    for name, value in {**nowhere, "STORAGE_ACCESS_KEY": "a", "STORAGE_SECRET_KEY": "b" * 9}.items():
        monkeypatch.setenv(name, value)
    port = str(free_port())
    command = [sys.executable, "-m", "capture2vr.cli", "up", "--port", port, "--data", tmp_path]
    child = subprocess.Popen(command, env={**os.environ, "EDGE_DEVICE": "cpu"}, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + HANG_S
    while is_free("127.0.0.1", int(port)):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    child.terminate()
    _, said = child.communicate(timeout=HANG_S)
    assert "were not ready" not in said
    assert child.returncode == 128 + signal.SIGTERM
    assert is_free("127.0.0.1", int(port))


def test_a_mistyped_setting_is_an_error_that_names_it() -> None:
    environment = {**os.environ, "EDGE_SLOT": "4"}
    command = [sys.executable, "-m", "capture2vr.cli", "edge"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert result.returncode == 2
    assert "EDGE_SLOT " in result.stderr
    assert "EDGE_SLOTS" in result.stderr


def test_half_a_pair_of_keys_is_said_in_a_sentence() -> None:
    environment = {**os.environ, "STORAGE_KIND": "s3", "STORAGE_ACCESS_KEY": "one"}
    command = [sys.executable, "-m", "capture2vr.cli", "gateway"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert result.returncode == 2
    assert "STORAGE_SECRET_KEY" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_proxy_for_the_world_is_not_asked_for_this_machine(url: str, tmp_path: Path) -> None:
    nowhere = f"http://127.0.0.1:{free_port()}"
    environment = {**os.environ, "HTTP_PROXY": nowhere, "http_proxy": nowhere, "NO_PROXY": "", "no_proxy": ""}
    command = [
        sys.executable,
        "-m",
        "capture2vr.cli",
        "pull",
        "never-made",
        "-o",
        str(tmp_path / "x"),
        "--gateway",
        url,
    ]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert "never-made" in result.stderr
    assert "cannot be reached" not in result.stderr


def test_what_is_no_gateway_is_said_plainly(tmp_path: Path) -> None:
    page = tmp_path / "v1" / "assets" / "leaf"
    page.parent.mkdir(parents=True)
    page.write_text("<html>some other server</html>")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=tmp_path)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        gateway = f"http://127.0.0.1:{server.server_port}"
        result = capture2vr("pull", "leaf", "-o", tmp_path / "x", "--gateway", gateway)
        server.shutdown()
    assert result.returncode == 2
    assert "not as a gateway does" in result.stderr


def test_doctor_finds_nothing_bad(url: str, tmp_path: Path) -> None:
    result = capture2vr("doctor", "--gateway", url, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert all(package in result.stdout for package in ("fastapi", "torch", "boto3"))
    assert list(tmp_path.iterdir()) == [], "it looks, and makes nothing"


# The demo as it is typed, but for 8 frames of 40, photos of 320 × 240, a coarse mesh, and any free port, because what
# is tested beside it asks for a gateway at the default one. Two minutes of a core become a quarter of one.
DEMO = """
import functools, sys
from capture2vr.cli.demonstration import demo, demo_phone
from capture2vr.cli.main import main
demo._PRESET = "coarse"
demo.DEFAULT_PORT = 0
demo_phone.PHOTO = demo_phone.DEPTH.scaled_to(320, 240)
demo_phone.simulate_capture = functools.partial(demo_phone.simulate_capture, frames=8)
sys.argv[1:] = ["demo", "-o", sys.argv[1], "--stop"]
main()
"""
COARSE = """
resolution = 48
most_points = 5_000
lod_faces = [5_000]
"""


def test_the_demo_ends_with_picture_report_and_viewer(tmp_path: Path) -> None:
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets" / "coarse.toml").write_text(COARSE)
    command = [sys.executable, "-c", DEMO, str(tmp_path / "demo")]
    environment = {**os.environ, "EDGE_PRESETS": str(tmp_path / "presets"), "EDGE_DEVICE": "cpu"}
    result = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "/view/demo-garment" in result.stderr
    report = json.loads((tmp_path / "demo" / "report.json").read_text())
    assert report["job"]["state"] == "SUCCEEDED"
    assert report["asset"]["quality"]["components"] == 1
    assert report["asset"]["scale_confidence"] == "metric"
    stages = [line.split()[0] for line in result.stderr.splitlines() if "%" in line]
    assert [stage for stage in ("UPLOADING", "POINT_CLOUD", "EXTRACTING", "PACKING") if stage in stages] == [
        "UPLOADING",
        "POINT_CLOUD",
        "EXTRACTING",
        "PACKING",
    ]
    assert (tmp_path / "demo" / "asset" / "preview.png").stat().st_size > 10_000


def test_a_demo_does_not_keep_its_services_data_in_the_capture(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="lies in the capture"):
        run_demo(tmp_path, tmp_path / "demo", keep=False)
    assert list(tmp_path.iterdir()) == []
