"""The compose file, the Dockerfiles and the edge cache, checked by the programs that will read them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from services.edge.settings import EdgeSettings
from services.gateway.settings import GatewaySettings
from services.storage.settings import StorageSettings
from services.strict_settings import StrictSettings
from tests.conftest import missing

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def compose(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The command that runs compose version 2; the plugin is fetched where Debian has none."""
    if shutil.which("docker") is None:
        missing("the docker command line")
    command = ["docker", "compose", "--project-directory", str(ROOT), "-f", str(ROOT / "docker-compose.yml")]
    if subprocess.run(["docker", "compose", "version"], capture_output=True).returncode == 0:
        return command
    folder = tmp_path_factory.mktemp("docker")
    if subprocess.run(["bash", str(Path(__file__).parent / "compose-plugin.sh"), str(folder)]).returncode != 0:
        missing("docker compose version 2")
    return ["env", f"DOCKER_CONFIG={folder}", *command]


def _config(compose: list[str], *profiles: str, **variables: str) -> dict[str, Any]:
    flags = [flag for profile in profiles for flag in ("--profile", profile)]
    environment = {**os.environ, **variables}
    result = subprocess.run(
        [*compose, *flags, "config", "--format", "json"], capture_output=True, text=True, env=environment
    )
    assert result.returncode == 0, result.stderr
    config: dict[str, Any] = json.loads(result.stdout)
    return config


def _variables(settings: type[StrictSettings]) -> set[str]:
    prefix = str(settings.model_config["env_prefix"])
    return {prefix + field.upper() for field in settings.model_fields}


def test_compose_file_is_valid(compose: list[str]) -> None:
    result = subprocess.run([*compose, "config", "-q"], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")


def test_only_the_cache_is_published_and_only_on_loopback(compose: list[str]) -> None:
    services = _config(compose)["services"]
    published = {name: service["ports"] for name, service in services.items() if service.get("ports")}
    assert set(published) == {"cdn"}
    assert all(port["host_ip"] == "127.0.0.1" for port in published["cdn"])


def test_our_containers_are_read_only_without_capabilities(compose: list[str]) -> None:
    services = _config(compose, "gpu")["services"]
    for name in ("gateway", "edge", "edge-gpu", "bucket", "cdn"):
        assert services[name]["read_only"] is True, name
        assert services[name]["cap_drop"] == ["ALL"], name


def test_the_gpu_worker_exists_only_in_its_profile(compose: list[str]) -> None:
    assert "edge-gpu" not in _config(compose)["services"]
    gpu = _config(compose, "gpu")["services"]["edge-gpu"]
    assert gpu["deploy"]["resources"]["reservations"]["devices"][0]["driver"] == "nvidia"
    assert gpu["environment"]["EDGE_DEVICE"] == "cuda"


def test_each_worker_has_the_torch_of_its_device(compose: list[str]) -> None:
    services = _config(compose, "gpu")["services"]
    assert "args" not in services["edge"]["build"], "the Dockerfile's own default is the CPU build"
    assert services["edge-gpu"]["build"]["args"] == {"TORCH_INDEX": "https://pypi.org/simple"}
    assert services["edge-gpu"]["image"] != services["edge"]["image"]
    assert re.search(r"ARG TORCH_INDEX=\S+/cpu$", (ROOT / "deploy" / "edge.Dockerfile").read_text(), re.MULTILINE)


def test_every_variable_is_one_that_the_services_know(compose: list[str]) -> None:
    known = {*_variables(GatewaySettings), *_variables(EdgeSettings), *_variables(StorageSettings)}
    for name, service in _config(compose, "gpu")["services"].items():
        given = {one for one in service.get("environment", {}) if one.startswith(("GATEWAY_", "EDGE_", "STORAGE_"))}
        assert given <= known, name
    for dockerfile in (ROOT / "deploy").glob("*.Dockerfile"):
        assert set(re.findall(r"\b((?:GATEWAY|EDGE|STORAGE)_[A-Z_]+)=", dockerfile.read_text())) <= known


def test_links_follow_the_port(compose: list[str]) -> None:
    environment = _config(compose, PORT="9999")["services"]["gateway"]["environment"]
    assert environment["GATEWAY_PUBLIC_URL"] == environment["STORAGE_BASE_URL"] == "http://127.0.0.1:9999"


def test_the_store_can_be_another_image(compose: list[str]) -> None:
    assert _config(compose, MINIO_IMAGE="example/store:1")["services"]["minio"]["image"] == "example/store:1"
    assert "@sha256:" in _config(compose)["services"]["minio"]["image"]


@pytest.mark.parametrize("dockerfile", ["edge.Dockerfile", "gateway.Dockerfile"])
def test_dockerfiles_pass_hadolint(dockerfile: str) -> None:
    hadolint = Path(sys.executable).with_name("hadolint")
    result = subprocess.run([hadolint, ROOT / "deploy" / dockerfile], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "USER " in (ROOT / "deploy" / dockerfile).read_text()
