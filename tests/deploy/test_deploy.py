"""The compose file, the Dockerfiles and the edge cache, checked by the programs that will read them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from capture2vr.cli.deployment.deploy_work import Address, initialise
from capture2vr.edge.worker.settings import EdgeSettings, central_credentials, server_security
from capture2vr.gateway.languages import LANGUAGES
from capture2vr.gateway.settings import GatewaySettings, worker_credentials
from capture2vr.process.grpc_security import NO_CREDENTIALS
from capture2vr.process.strict_settings import StrictSettings
from capture2vr.storage.settings import StorageSettings, open_keys
from tests.conftest import missing
from tests.support.repository import ROOT


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


@pytest.mark.essential
@pytest.mark.slow
@pytest.mark.docker
def test_compose_file_is_valid(compose: list[str]) -> None:
    result = subprocess.run([*compose, "config", "-q"], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.docker
def test_only_the_cache_is_published_and_only_on_loopback(compose: list[str]) -> None:
    services = _config(compose)["services"]
    published = {name: service["ports"] for name, service in services.items() if service.get("ports")}
    assert set(published) == {"cdn"}
    assert all(port["host_ip"] == "127.0.0.1" for port in published["cdn"])


@pytest.mark.docker
def test_what_a_restore_needs_is_started_with_it(compose: list[str]) -> None:
    """After `down -v` nothing runs: the bucket waits for the store, and Postgres is started where its profile is on."""
    assert "backup" not in _config(compose)["services"], "it ends, and is not one of those that go on"
    needed = _config(compose, "backup", "postgres")["services"]["backup"]["depends_on"]
    assert needed["bucket"]["condition"] == "service_completed_successfully"
    assert (needed["postgres"]["condition"], needed["postgres"]["required"]) == ("service_healthy", False)


@pytest.mark.docker
def test_containers_are_read_only_without_capabilities(compose: list[str]) -> None:
    services = _config(compose, "gpu", "postgres", "backup")["services"]
    assert services.keys() >= {"gateway", "edge", "edge-gpu", "store", "secret", "bucket", "cdn"}
    for name, service in services.items():
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name


@pytest.mark.docker
def test_no_container_takes_the_whole_machine_or_disk(compose: list[str]) -> None:
    """CPUs have a limit only where one is set: more than a machine has is an error of Docker's."""
    for name, service in _config(compose, "gpu", "postgres", "backup")["services"].items():
        assert 0 < int(service["mem_limit"]) <= 16 << 30, name
        assert 0 < service["pids_limit"] <= 4096, name
        assert float(service.get("cpus", 0)) == 0, name
        assert service["logging"]["driver"] == "json-file", name
        assert service["logging"]["options"] == {"max-size": "10m", "max-file": "5"}, name
    limits = {"LIMIT_EDGE_MEMORY": "3g", "LIMIT_EDGE_CPUS": "1.5", "LIMIT_PIDS": "99", "LOG_SIZE": "1m"}
    edge = _config(compose, **limits)["services"]["edge"]
    assert (int(edge["mem_limit"]), float(edge["cpus"]), edge["pids_limit"]) == (3 << 30, 1.5, 99)
    assert edge["logging"]["options"]["max-size"] == "1m"


@pytest.mark.docker
def test_the_gpu_worker_exists_only_in_its_profile(compose: list[str]) -> None:
    assert "edge-gpu" not in _config(compose)["services"]
    gpu = _config(compose, "gpu")["services"]["edge-gpu"]
    assert gpu["deploy"]["resources"]["reservations"]["devices"][0]["driver"] == "nvidia"
    assert gpu["environment"]["EDGE_DEVICE"] == "cuda"


@pytest.mark.docker
def test_postgres_exists_only_in_its_profile_and_is_reached_by_gateways_alone(compose: list[str]) -> None:
    plain = _config(compose)["services"]
    assert "postgres" not in plain
    assert plain["gateway"]["environment"]["GATEWAY_DATABASE_URL"] == ""
    url = "postgresql://capture2vr:hush@postgres/capture2vr"
    named = {"POSTGRES_PASSWORD": "hush", "GATEWAY_DATABASE_URL": url}
    services = _config(compose, "postgres", **named)["services"]
    assert services["gateway"]["environment"]["GATEWAY_DATABASE_URL"] == url
    database = services["postgres"]
    assert (database["read_only"], database["cap_drop"], list(database["networks"])) == (True, ["ALL"], ["inside"])
    assert "ports" not in database
    told = [name for name, service in services.items() if "hush" in json.dumps(service)]
    assert told == ["gateway", "migrate", "postgres"]


@pytest.mark.docker
def test_each_worker_has_the_torch_of_its_device(compose: list[str]) -> None:
    services = _config(compose, "gpu")["services"]
    (default,) = re.findall(r"^ARG TORCH_INDEX=(\S+)$", _edge_stages()[1], re.MULTILINE)
    assert services["edge"]["build"]["args"]["TORCH_INDEX"] == default, "the CPU build"
    assert services["edge-gpu"]["build"]["args"]["TORCH_INDEX"] == "", "empty, not absent: it replaces that default"
    assert services["edge-gpu"]["image"] != services["edge"]["image"]
    indexes = {"TORCH_INDEX": "https://example.org/cuda", "TORCH_CPU_INDEX": "https://example.org/cpu"}
    named = _config(compose, "gpu", **indexes)["services"]
    assert named["edge-gpu"]["build"]["args"]["TORCH_INDEX"] == "https://example.org/cuda"
    assert named["edge"]["build"]["args"]["TORCH_INDEX"] == "https://example.org/cpu"


@pytest.mark.docker
def test_workers_may_be_built_for_a_cluster_and_sent_to_it(compose: list[str]) -> None:
    plain = _config(compose, "gpu")["services"]
    named = _config(compose, "gpu", EDGE_EXTRAS="ray", EDGE_ENGINE="ray://head:10001")["services"]
    for worker in ("edge", "edge-gpu"):
        assert plain[worker]["build"]["args"]["EXTRAS"] == ""
        assert plain[worker]["environment"]["EDGE_ENGINE"] == "local"
        assert named[worker]["build"]["args"]["EXTRAS"] == "ray"
        assert named[worker]["environment"]["EDGE_ENGINE"] == "ray://head:10001"


@pytest.mark.docker
def test_a_worker_has_the_cores_that_are_named(compose: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    plain = _config(compose, "gpu")["services"]
    named = _config(compose, "gpu", OMP_NUM_THREADS="2")["services"]
    for worker in ("edge", "edge-gpu"):
        assert plain[worker]["environment"].get("OMP_NUM_THREADS") is None
        assert named[worker]["environment"]["OMP_NUM_THREADS"] == "2"


@pytest.mark.parametrize("index", [None, "", "https://example.org/cuda"])
def test_the_worker_image_takes_torch_from_the_index_that_is_named(index: str | None) -> None:
    """None: nobody names one. pip's place is taken by a program that prints what it is asked for."""
    (default,) = re.findall(r"^ARG TORCH_INDEX=(\S+)$", _edge_stages()[1], re.MULTILINE)
    named = default if index is None else index
    ended = _install_in_edge_image("printf '%s ' \"$@\"; echo", named)
    tools, torch, others, own, installed, checked = (line.split() for line in ended.stdout.splitlines())
    assert torch[-2:] == ([named, "torch"] if named else ["-r", "cuda.txt"])
    assert ("--require-hashes" in torch) == (not named)
    assert (tools[-2:], others[-2:]) == (["-r", "build.txt"], ["-r", "edge.txt"])
    assert all("--require-hashes" in line for line in (tools, others))
    assert all("--no-deps" in line for line in (tools, torch, others, own, installed))
    assert all("--no-build-isolation" in line for line in (others, own)), "else pip fetches build tools by itself"
    assert checked == ["check"]


def test_further_extras_come_by_the_versions_of_the_constraints() -> None:
    *_, last = _install_in_edge_image("printf '%s ' \"$@\"; echo", "", EXTRAS="ray").stdout.splitlines()
    assert last.split() == ["install", "--no-cache-dir", "-c", "constraints.txt", "/wheels/capture2vr-*.whl[ray]"]


def test_an_index_without_torch_ends_the_build_at_once_with_a_sentence() -> None:
    ended = _install_in_edge_image('case "$*" in *--index-url*) false ;; esac', "https://example.org/none")
    assert ended.returncode == 1
    assert "PyTorch cannot be had from TORCH_INDEX=https://example.org/none" in ended.stderr
    assert "TORCH_CPU_INDEX" in ended.stderr


def _install_in_edge_image(pip: str, index: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the build's pip instructions one after the other, with a shell function in the place of pip."""
    steps = [step for step in re.findall(r"^RUN (.*)$", _edge_stages()[1], re.MULTILINE) if "/bin/pip" in step]
    named = (re.sub(r"/(build|venv)/bin/pip", "pip", step).replace("python -m venv", ":") for step in steps)
    script = "\n".join([f"pip() {{ {pip}; }}", *named])
    environment = {"PATH": os.environ["PATH"], "TORCH_INDEX": index, "EXTRAS": ""} | variables
    return subprocess.run(["sh", "-euc", script], capture_output=True, text=True, env=environment)


def test_the_images_share_their_base() -> None:
    texts = [path.read_text() for path in (ROOT / "deploy").glob("*.Dockerfile")]
    assert {base for text in texts for base in re.findall(r"^FROM (\S+)", text, re.MULTILINE)} == {"${PYTHON_IMAGE}"}
    assert {base for text in texts for base in re.findall(r"^ARG PYTHON_IMAGE=(.+)", text)} == {"python:3.11-slim"}


def test_what_the_images_leave_out_is_no_part_of_the_product(tmp_path: Path) -> None:
    """slim.sh on a small tree: tests, headers, bytecode and pip go, code and its data stay."""
    site = tmp_path / "lib" / "python3.11" / "site-packages"
    gone = [
        "numpy/tests/test_a.py",
        "torch/include/a.h",
        "torch/bin/protoc",
        "pip/a.py",
        "a/b.pxd",
        "botocore/data/ec2/1/service.json",
        "numpy/__pycache__/a.pyc",
        "torch/_VF.pyi",
        "torch/_inductor/a.py",
        "sympy/core/a.py",
        "sympy-1.14.0.dist-info/METADATA",
        "pygments/lexers/ruby.py",
        "skimage/data/coins.png",
        "babel/locale-data/uk.dat",
    ]
    kept = [
        "numpy/testing/a.py",
        "skimage/a.pyi",
        "skimage/data/__init__.py",
        "pygments/lexers/python.py",
        "torch/lib/a.py",
        "botocore/data/s3/1/service.json",
        "botocore/data/endpoints.json",
        *(f"babel/locale-data/{language}.dat" for language in ("root", *LANGUAGES)),
    ]
    for name in (*gone, *kept):
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text("")
    subprocess.run(["sh", ROOT / "deploy" / "slim.sh", tmp_path], check=True)
    assert sorted(path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()) == sorted(kept)


@pytest.mark.slow
def test_an_encoder_that_the_images_leave_out_does_nothing(tmp_path: Path) -> None:
    """What is linked to it loads, with the versions of its names, and gets 0 for an answer."""
    if not (shutil.which("gcc") and shutil.which("strip")):
        pytest.skip("a C compiler is missing")
    folder = tmp_path / "lib" / "python3.11" / "site-packages" / "av.libs"
    folder.mkdir(parents=True)
    (folder / "x265.map").write_text("X265_1 { global: *; };")
    build = ["gcc", "-xc", "-", "-shared", "-fPIC", "-Wl,-rpath,$ORIGIN", "-o"]
    encoder, decoder = "libx265-1a2b.so.216", "libavcodec-1a2b.so.62"
    for name, source, *flags in (
        (encoder, "int encode(void) { return 7; }", f"-Wl,-soname,{encoder}", "-Wl,--version-script=x265.map"),
        (decoder, "int encode(void); int ask(void) { return encode(); }", "-L.", f"-l:{encoder}"),
    ):
        subprocess.run([*build, name, *flags], input=source, text=True, cwd=folder, check=True)
    ask = f"import ctypes; print(ctypes.CDLL('{folder / decoder}').ask())"
    for answer in (7, 0):
        asked = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True)
        assert (asked.stdout, asked.stderr) == (f"{answer}\n", "")
        subprocess.run(["sh", ROOT / "deploy" / "slim.sh", tmp_path], check=True)


def test_the_worker_image_has_a_compiler_only_while_it_is_built() -> None:
    _, build, shipped = _edge_stages()
    assert "g++" in build
    assert "apt-get" not in shipped
    assert "COPY --from=build /venv /venv" in shipped


def _edge_stages() -> list[str]:
    """The instructions of the worker's Dockerfile by stage, each on one line; first those before all stages."""
    text = (ROOT / "deploy" / "edge.Dockerfile").read_text().replace("\\\n", "")
    return re.split(r"^FROM .*$", text, flags=re.MULTILINE)


@pytest.mark.docker
def test_every_variable_is_one_that_the_services_know(compose: list[str]) -> None:
    known = {*_variables(GatewaySettings), *_variables(EdgeSettings), *_variables(StorageSettings)}
    for name, service in _config(compose, "gpu")["services"].items():
        given = {one for one in service.get("environment", {}) if one.startswith(("GATEWAY_", "EDGE_", "STORAGE_"))}
        assert given <= known, name
    for dockerfile in (ROOT / "deploy").glob("*.Dockerfile"):
        assert set(re.findall(r"\b((?:GATEWAY|EDGE|STORAGE)_[A-Z_]+)=", dockerfile.read_text())) <= known


# Folders of the image, what needs a folder of its own mounted, a drain that compose has a limit for, and what a store
# that is a folder has.
_NOT_OF_COMPOSE = {
    *("EDGE_HOST", "EDGE_SCRATCH", "EDGE_KTX2", "EDGE_MODELS", "EDGE_PRESETS", "EDGE_DRAIN_S"),
    "GATEWAY_SCRUB_DAYS",
}


def test_a_setting_of_the_runbook_reaches_its_service() -> None:
    """A variable in .env that compose does not hand on changes nothing, and nobody is told."""
    told = (ROOT / "deploy" / "runbook.md").read_text()
    services = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    for names, settings in ((("gateway",), GatewaySettings), (("edge", "edge-gpu"), EdgeSettings)):
        named = {name for name in _variables(settings) if re.search(rf"\b{name}\b", told)}
        limits = {name for name in _variables(settings) if "_LIMIT_" in name}
        given = {variable for name in names for variable in services[name]["environment"]}
        assert (named | limits) - _NOT_OF_COMPOSE <= given


KEYED = ("gateway", "edge", "edge-gpu")


def _keys_of(service: dict[str, Any]) -> dict[str, Any]:
    (mount,) = [each for each in service["volumes"] if each["target"] == "/keys"]
    return dict(mount)


@pytest.mark.docker
def test_keys_come_from_a_folder_that_is_named_and_only_to_those_who_need_them(compose: list[str]) -> None:
    named = {"KEYS": "/srv/keys", "STORAGE_SIGNING_KEY": "/keys/2026", "STORAGE_COLLECTION": "ada"}
    services = _config(compose, "gpu", **named)["services"]
    for name in KEYED:
        mount, environment = _keys_of(services[name]), services[name]["environment"]
        assert (mount["type"], mount["source"], mount["read_only"]) == ("bind", "/srv/keys", True), name
        assert (environment["STORAGE_SIGNING_KEY"], environment["STORAGE_COLLECTION"]) == ("/keys/2026", "ada"), name
    for name in services.keys() - set(KEYED):
        assert "/keys" not in json.dumps(services[name]), name


@pytest.mark.docker
def test_without_keys_nothing_is_signed_and_no_folder_is_made(compose: list[str]) -> None:
    services = _config(compose, "gpu")["services"]
    for name in KEYED:
        assert (_keys_of(services[name])["type"], _keys_of(services[name])["read_only"]) == ("volume", True)
        assert services[name]["environment"]["STORAGE_SIGNING_KEY"] == ""


@pytest.mark.docker
def test_gateway_and_workers_share_the_token(compose: list[str]) -> None:
    services = _config(compose, "gpu", EDGE_TOKEN="secret", GATEWAY_EDGE_CA="/keys/ca.pem")["services"]
    assert services["gateway"]["environment"]["GATEWAY_EDGE_TOKEN"] == "secret"
    assert services["gateway"]["environment"]["GATEWAY_EDGE_CA"] == "/keys/ca.pem"
    assert {services[name]["environment"]["EDGE_TOKEN"] for name in ("edge", "edge-gpu")} == {"secret"}


@pytest.mark.docker
def test_empty_variables_are_none(compose: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Compose passes what nobody has set as an empty text."""
    for name in KEYED:
        for variable, value in _config(compose, "gpu")["services"][name]["environment"].items():
            monkeypatch.setenv(variable, value)
    assert open_keys(StorageSettings()).verification_keys == ()
    assert StorageSettings().collection == "default"
    assert server_security(EdgeSettings()).credentials is None
    assert worker_credentials(GatewaySettings()) == central_credentials(EdgeSettings()) == NO_CREDENTIALS


def content_of(path: Path) -> bytes:
    """What a file holds; nothing where it is a folder, or has gone since it was listed, as compiled files do."""
    with suppress(FileNotFoundError, IsADirectoryError):
        return path.read_bytes()
    return b""


def test_no_private_key_is_in_the_repository_or_can_get_into_an_image() -> None:
    key = re.compile(rb"-----BEGIN [A-Z ]*PRIVATE KEY-----\s+[A-Za-z0-9+/=]{16}")
    # Not a constant, which the compiled test beside this one would hold.
    assert key.search("-----BEGIN {} KEY-----\nMC4CAQAwBQYDK2VwBCIEIA==".format("PRIVATE").encode())
    folders = [ROOT / name for name in ("services", "tests", "deploy", "docs", "clients", "proto", ".ci")]
    files = [*ROOT.glob("*"), *(path for folder in folders for path in folder.rglob("*"))]
    assert [path for path in files if key.search(content_of(path))] == []
    ignored, *kept = (ROOT / ".dockerignore").read_text().splitlines()
    assert ignored == "**"
    assert {line for line in kept if line.startswith("!")} == {
        "!pyproject.toml",
        "!constraints.txt",
        "!README.md",
        "!LICENSE",
        "!services",
        "!deploy/locks",
        "!deploy/slim.sh",
        "!deploy/store.py",
        "!deploy/check_image.py",
    }


@pytest.mark.docker
def test_compose_reads_the_env_of_deploy_init(compose: list[str], tmp_path: Path) -> None:
    shutil.copy(ROOT / "docker-compose.yml", tmp_path)
    initialise(tmp_path, Address("0.0.0.0", 9090, "https://capture.example"), force=False)
    there = [word.replace(str(ROOT), str(tmp_path)) for word in compose]
    services = _config(there, "gpu")["services"]
    assert services["cdn"]["ports"][0]["host_ip"] == "0.0.0.0"
    gateway, store = services["gateway"]["environment"], services["store"]["environment"]
    assert gateway["STORAGE_BASE_URL"] == gateway["GATEWAY_PUBLIC_URL"] == "https://capture.example"
    assert gateway["STORAGE_SECRET_KEY"] == store["STORAGE_SECRET_KEY"] != ""
    for name in ("edge", "edge-gpu"):
        worker = services[name]["environment"]
        assert worker["EDGE_TOKEN"] == gateway["GATEWAY_EDGE_TOKEN"] != ""
        if "EDGE_CENTRAL" in worker:  # which may be the other one
            assert worker["EDGE_CENTRAL_TOKEN"] == worker["EDGE_TOKEN"]
            assert worker["EDGE_CENTRAL_CA"] == gateway["GATEWAY_EDGE_CA"] != ""
        assert worker["STORAGE_SIGNING_KEY"] == gateway["STORAGE_SIGNING_KEY"] != ""
        mounted = Path(_keys_of(services[name])["source"])
        for file in (worker["EDGE_TLS_CERT"], worker["EDGE_TLS_KEY"], gateway["GATEWAY_EDGE_CA"]):
            assert (mounted / Path(file).relative_to("/keys")).is_file()


def test_secrets_are_ignored_by_git() -> None:
    assert {".env", ".env.*", "/keys/"} <= set((ROOT / ".gitignore").read_text().splitlines())


@pytest.mark.docker
def test_links_follow_the_port(compose: list[str]) -> None:
    environment = _config(compose, PORT="9999")["services"]["gateway"]["environment"]
    assert environment["GATEWAY_PUBLIC_URL"] == environment["STORAGE_BASE_URL"] == "http://127.0.0.1:9999"


@pytest.mark.docker
def test_the_workers_are_all_that_have_the_name_of_the_service(compose: list[str]) -> None:
    services = _config(compose)["services"]
    assert services["gateway"]["environment"]["GATEWAY_WORKERS"] == "dns:///edge:50051"
    for name in ("gateway", "edge"):  # either would keep a service from being scaled
        assert not {"container_name", "ports"} & services[name].keys()


@pytest.mark.docker
def test_the_store_can_be_another_service(compose: list[str]) -> None:
    endpoint = "https://s3.example"
    named = {
        "STORE_REPLICAS": "0",
        "STORAGE_ENDPOINT": endpoint,
        "STORAGE_PRESIGN_S": "300",
        "STORAGE_BUCKET": "things",
    }
    config = _config(compose, "gpu", NETWORK_INTERNAL="false", **named)
    assert config["services"]["store"]["deploy"]["replicas"] == 0
    assert not config["networks"]["inside"].get("internal", False)
    for name in ("gateway", "edge", "edge-gpu", "bucket"):
        given = config["services"][name]["environment"]
        assert (given["STORAGE_ENDPOINT"], given["STORAGE_PRESIGN_S"], given["STORAGE_BUCKET"]) == (
            endpoint,
            "300",
            "things",
        )
    assert _config(compose)["networks"]["inside"]["internal"] is True


@pytest.mark.docker
def test_nothing_waits_for_the_stores_own_health_check(compose: list[str]) -> None:
    services = _config(compose)["services"]
    assert services["bucket"]["depends_on"]["store"]["condition"] == "service_started"
    assert services["cdn"]["depends_on"]["bucket"]["condition"] == "service_completed_successfully"


@pytest.mark.docker
def test_workers_and_gateways_start_at_once(compose: list[str]) -> None:
    """What they need they look for when they are asked: a chain of healthy services would start in twice the time."""
    services = _config(compose, "gpu", "postgres")["services"]
    waiting = {name: set(service["depends_on"]) for name, service in services.items() if service.get("depends_on")}
    made = {name for name, others in waiting.items() if "secret" in others}
    assert made == {"gateway", "edge", "edge-gpu", "store", "bucket"}, "within a second, by a shell"
    others = {name: names - {"secret"} for name, names in waiting.items() if names - {"secret"}}
    # The database is brought up to date first, in two seconds.
    gateway = {"gateway": {"migrate", "postgres"}, "migrate": {"postgres"}}
    assert others == {**gateway, "cdn": {"bucket"}, "bucket": {"store"}}


@pytest.mark.docker
def test_minio_can_stay_in_its_own_volume_and_with_a_secret_of_ones_own(compose: list[str]) -> None:
    there = [*compose, "-f", str(ROOT / "deploy" / "compose.minio.yml")]
    plain, named = _config(compose)["services"]["store"], {"STORAGE_SECRET_KEY": "secret"}
    store = _config(there, **named)["services"]["store"]
    assert "@sha256:" in store["image"]
    assert _config(there, MINIO_IMAGE="example/store:1", **named)["services"]["store"]["image"] == "example/store:1"
    assert store["environment"]["MINIO_ROOT_PASSWORD"] == "secret"
    assert "build" not in store
    (old,), (new,) = (
        [each["source"] for each in service["volumes"] if each["target"] == "/data"] for service in (store, plain)
    )
    assert (old, new) == ("objects", "store"), "neither writes into what the other has filled"
    assert "STORAGE_SECRET_KEY" in _refusal(there)


def _refusal(compose: list[str]) -> str:
    ended = subprocess.run(
        [*compose, "--env-file", os.devnull, "config", "-q"], capture_output=True, text=True, env={**os.environ}
    )
    assert ended.returncode != 0
    return ended.stderr


@pytest.mark.parametrize("dockerfile", ["edge.Dockerfile", "gateway.Dockerfile", "store.Dockerfile"])
def test_dockerfiles_pass_hadolint(dockerfile: str) -> None:
    hadolint = Path(sys.executable).with_name("hadolint")
    result = subprocess.run([hadolint, ROOT / "deploy" / dockerfile], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "USER " in (ROOT / "deploy" / dockerfile).read_text()
