"""Images that stand in for those of a registry, made of Debian's packages, and the product's own, built upon them.

Where no registry of images can be reached, nothing else shows what the Dockerfiles and docker-compose.yml do. Python's
stand-in is as large as the official slim image, and like that one without bytecode; its Python is Debian's. Postgres
and nginx are Debian's versions, with the user, the variables and the paths of the official images.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

from tests.referees.docker.engine import Engine, available_memory
from tests.referees.docker.pip_sources import CA_BUNDLE, served_sources
from tests.support.debian import debian_mirror
from tests.support.repository import ROOT

POSTGRES, NGINX = "stand-in-postgres", "stand-in-nginx"
VARIABLES = {"POSTGRES_IMAGE": POSTGRES, "NGINX_IMAGE": NGINX}
"""Variables of docker-compose.yml with which it takes the stand-ins."""

_SUITE = "bookworm"
_PYTHON = ["python3", "python3-venv", "ca-certificates"]
_SERVERS = ["curl", "nginx-core", "postgresql", "wget"]
_NO_TEXTS = ["path-exclude=/usr/share/man/*", "path-exclude=/usr/share/locale/*", "path-exclude=/usr/share/doc/*"]
_MEMORY_BYTES = 8e9  # free memory with which files are unpacked in memory: a third of the time, for dpkg syncs each
_LIB = "/usr/lib/python3.11"
_PYTHON_IMAGE = f"""
FROM stand-in-python
RUN ln -s /usr/bin/python3 /usr/local/bin/python && cd /tmp && apt-get update -qq && \\
    apt-get download -qq libpython3.11-dev && dpkg-deb -x libpython*.deb headers && \\
    cp -r headers/usr/include/. /usr/include && rm -r headers *.deb /var/lib/apt/lists/* /var/cache/apt/*.bin && \\
    find {_LIB} -name __pycache__ -prune -exec rm -r {{}} +
COPY ca.crt {CA_BUNDLE}
COPY pip.conf /etc/pip.conf
"""
_SERVER_IMAGES = {
    POSTGRES: "COPY postgres.sh /\n"
    "RUN ln -s /usr/lib/postgresql/*/bin /programs && install -d -o postgres -m 700 /var/lib/postgresql/data\n"
    'ENV PATH=/programs:$PATH\nENTRYPOINT ["bash", "/postgres.sh"]',
    NGINX: 'RUN install -d -o 101 /var/cache/nginx\nUSER 101\nCMD ["nginx", "-g", "daemon off;"]',
}


def build(engine: Engine) -> None:
    """Make all images that docker-compose.yml names but for the GPU's; what the engine has is not made again."""
    for name, packages in (("python", _PYTHON), ("servers", _SERVERS)):
        _import(engine, name, packages)
    with tempfile.TemporaryDirectory(prefix="images-") as folder, served_sources() as pip:
        _build_servers(engine, Path(folder))
        _build_python(engine, Path(folder), pip)
        override = Path(folder) / "host-network.json"
        services = {name: {"build": {"network": "host"}} for name in ("gateway", "secret", "bucket", "store", "edge")}
        override.write_text(json.dumps({"services": services}))
        files = ["-f", ROOT / "docker-compose.yml", "-f", override]
        engine.docker("compose", *files, "build", "gateway", "store", "edge", TORCH_CPU_INDEX=_torch_index(pip))


def _import(engine: Engine, name: str, packages: list[str]) -> None:
    """Import the files of a small Debian with these packages."""
    archive = engine.folder / f"{name}.tar"
    if not archive.exists():
        with _scratch() as scratch:
            made = scratch / archive.name
            texts = [f"--dpkgopt={line}" for line in [*_NO_TEXTS, "path-include=/usr/share/doc/*/copyright"]]
            hooks = "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr"
            include = f"--include={','.join(['usr-is-merged', *packages])}"
            command = [
                "mmdebstrap",
                "--quiet",
                "--variant=minbase",
                include,
                hooks,
                *texts,
                _SUITE,
                made,
                debian_mirror(),
            ]
            subprocess.run(command, check=True, env={**engine.variables, "TMPDIR": str(scratch)})
            shutil.move(made, archive)
    if not engine.docker("images", "-q", f"stand-in-{name}").strip():
        engine.docker("import", archive, f"stand-in-{name}")


@contextmanager
def _scratch() -> Iterator[Path]:
    memory = Path("/dev/shm")
    within = memory if memory.is_dir() and available_memory() > _MEMORY_BYTES else None
    with tempfile.TemporaryDirectory(prefix="debian-", dir=within) as folder:
        yield Path(folder)


def _build_servers(engine: Engine, folder: Path) -> None:
    shutil.copy(Path(__file__).with_name("postgres.sh"), folder)
    for image, lines in _SERVER_IMAGES.items():
        _build(engine, folder, image, f"FROM stand-in-servers\n{lines}\n")


def _build_python(engine: Engine, folder: Path, pip: str) -> None:
    shutil.copy(CA_BUNDLE, folder / "ca.crt")
    (folder / "pip.conf").write_text(f"{pip}\n")
    _build(engine, folder, "python:3.11-slim", _PYTHON_IMAGE)


def _build(engine: Engine, folder: Path, image: str, dockerfile: str) -> None:
    (folder / "Dockerfile").write_text(dockerfile)
    engine.docker("build", "--network", "host", "-t", image, folder)


def _torch_index(pip: str) -> str:
    """The index of PyTorch's CPU builds: its own, or where that cannot be reached a folder that pip looks into here."""
    dockerfile = (ROOT / "deploy" / "edge.Dockerfile").read_text()
    (own,) = re.findall(r"^ARG TORCH_INDEX=(\S+)$", dockerfile, re.MULTILINE)
    folders = re.findall(r"^find-links = (\S+)", pip, re.MULTILINE)
    try:
        with urlopen(f"{own}/torch/", timeout=20):
            return str(own)
    except (URLError, OSError):
        return folders[0] if folders else str(own)
