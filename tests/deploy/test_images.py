"""deploy/images.sh: images are built and brought into a cluster. Recorders are docker, k3s, ctr and kind."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

import capture2vr
from tests.support.chart import containers, render, values_of
from tests.support.repository import ROOT

VERSION = capture2vr.__version__
DIGEST = "sha256:" + "0a" * 32
RECORDER = f"""#!/bin/bash
echo "$(basename "$0") $*" >>"$RECORD"
case "$1" in
  save) echo "image $2" ;;
  images | ctr | --namespace) cat >>"$RECORD" ;;
  inspect) echo "elsewhere.example/x@sha256:{"ff" * 32}"; echo "${{4%:*}}@{DIGEST}" ;;
esac
[[ "$1" != "${{FAILS:-}}" ]]
"""

Images = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def record(tmp_path: Path) -> Path:
    return tmp_path / "record"


@pytest.fixture
def images(tmp_path: Path, record: Path) -> Images:
    """The script, with recorders in the place of all programs that it calls."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name in ("docker", "k3s", "ctr", "kind"):
        (programs / name).write_text(RECORDER)
        (programs / name).chmod(0o755)

    def call(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "RECORD": str(record), **variables}
        command = ["bash", str(ROOT / "deploy" / "images.sh"), *arguments]
        return subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)

    return call


@pytest.mark.parametrize(
    ("target", "into"),
    [("k3s", "k3s ctr images import -"), ("containerd", "ctr --namespace k8s.io images import -")],
)
def test_the_images_of_the_chart_are_built_and_imported(images: Images, record: Path, target: str, into: str) -> None:
    assert images(target).returncode == 0
    lines = record.read_text().splitlines()
    built = [line.split()[5] for line in lines if line.startswith("docker build")]
    assert {f"{name}:{VERSION}" for name in ("capture2vr-gateway", "capture2vr-edge", "capture2vr-store")} == set(built)
    assert set(built) == {each["image"] for each in containers(render({**values_of("gpu"), "workers": {}}))}
    for image in built:
        assert f"docker save {image}" in lines
        assert lines.count(into) == len(built)
        assert f"image {image}" in lines, "what is saved is what is imported"


def test_dockerfiles_are_those_that_there_are_and_a_gpus_worker_has_the_torch_of_its_device(
    images: Images, record: Path
) -> None:
    images("kind", IMAGES="gateway edge edge-gpu store", CLUSTER="mine", TAG="7", BUILD_ARGS="--build-arg A=b")
    lines = record.read_text().splitlines()
    for line in lines:
        if line.startswith("docker build"):
            assert (ROOT / line.split()[3]).is_file()
            assert ("--build-arg TORCH_INDEX= " in line) == ("edge-gpu" in line)
            assert line.endswith("--build-arg A=b .")
    assert "kind load docker-image --name mine capture2vr-edge-gpu:7" in lines


def test_a_registry_gives_digests_that_the_chart_takes(images: Images, record: Path) -> None:
    ended = images("registry.example/team/")
    assert f"docker push --quiet registry.example/team/capture2vr-edge:{VERSION}" in record.read_text().splitlines()
    printed = ended.stdout[ended.stdout.index("image:") :]
    values = values_of("gpu")
    values = {**values, "workers": {}, **yaml.safe_load(printed)}
    values["store"]["enabled"] = True
    used = {each["image"] for each in containers(render(values))}
    assert used == {f"registry.example/team/capture2vr-{name}@{DIGEST}" for name in ("gateway", "edge", "store")}


@pytest.mark.parametrize("arguments", [(), ("registry.example/team",), ("k4s",)])
def test_a_target_that_is_none_is_refused_before_anything_is_built(
    images: Images, record: Path, arguments: tuple[str, ...]
) -> None:
    ended = images(*arguments)
    assert ended.returncode != 0
    assert "k3s, kind, containerd" in ended.stderr
    assert not record.exists()


@pytest.mark.parametrize("step", ["build", "save", "push"])
def test_what_fails_ends_it(images: Images, step: str) -> None:
    assert images("registry.example/team/" if step == "push" else "k3s", FAILS=step).returncode != 0
