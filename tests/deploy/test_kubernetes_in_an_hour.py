"""The runbook's "Kubernetes in an hour", run as it stands, with recorders in the place of the programs of a cluster.

What they were called with is held against what the chart makes of the values that were written.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from tests.support.chart import Manifest, containers, named, of_kind, render
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

pytestmark = pytest.mark.slow

RECORDER = """#!/bin/bash
(printf '%s\\t' "$(basename "$0")" "$@"; echo) >>"$RECORD"
[[ "$1" != save ]] || echo "$2"
[[ "$1" != ctr ]] || cat >>"$RECORD"
"""
CLUSTER_WIDE = (["create", "namespace"], ["apply", "-f", "deploy/k3s-traefik.yaml"])


@dataclass(frozen=True, slots=True)
class Hour:
    """What was called, in order, and the manifests of the release that it ends with."""

    calls: list[list[str]]
    folder: Path

    def of(self, program: str) -> list[list[str]]:
        return [call[1:] for call in self.calls if call[0] == program]

    @property
    def helm(self) -> list[str]:
        (call,) = self.of("helm")
        return call

    @property
    def manifests(self) -> list[Manifest]:
        verb, install, release, chart, *_ = self.helm
        assert (verb, install) == ("upgrade", "--install")
        assert (self.folder / chart / "Chart.yaml").is_file()
        return render(yaml.safe_load((self.folder / option(self.helm, "-f")).read_text()), release=release)


def option(call: list[str], name: str) -> str:
    return call[call.index(name) + 1] if name in call else ""


def commands_of(name: str) -> str:
    """The commands below a comment of the runbook."""
    text = (ROOT / "deploy" / "runbook.md").read_text()
    (found,) = re.findall(rf"<!-- kubernetes: {name} -->\n\n```\n(.*?)```", text, re.DOTALL)
    return str(found)


@pytest.fixture(params=["k3s", "kind"], scope="module")
def hour(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Hour:
    tmp_path = tmp_path_factory.mktemp(request.param)
    programs, record = tmp_path / "programs", tmp_path / "record"
    programs.mkdir()
    (tmp_path / "deploy").symlink_to(ROOT / "deploy")
    for name in ("curl", "docker", "helm", "k3s", "kind", "kubectl"):
        (programs / name).write_text(RECORDER)
    (programs / "capture2vr").write_text(f'#!/bin/bash\nexec {sys.executable} -m capture2vr.cli "$@"\n')
    for program in programs.iterdir():
        program.chmod(0o755)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("STORAGE_")}
    environment |= {"PATH": f"{programs}:{os.environ['PATH']}", "RECORD": str(record)}
    environment["PYTHONPATH"] = os.pathsep.join([*filter(None, sys.path)])
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", commands_of(request.param) + "\nwait\n"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert ended.returncode == 0, ended.stderr
    return Hour([line.rstrip("\t").split("\t") for line in record.read_text().splitlines()], tmp_path)


def test_all_is_in_one_namespace(hour: Hour) -> None:
    inside = [call for call in hour.of("kubectl") if not any(call[: len(wide)] == wide for wide in CLUSTER_WIDE)]
    assert len(inside) >= 3
    (namespace,) = {option(call, "--namespace") for call in (*inside, hour.helm)}
    made = [call[2] for call in hour.of("kubectl") if call[:2] == ["create", "namespace"]]
    assert made == ([namespace] if namespace else [])


def test_all_secrets_are_made_before_the_release(hour: Hour) -> None:
    applied = [option(call, "-f") for call in hour.of("kubectl") if "apply" in call]
    listed = json.loads((hour.folder / applied[-1]).read_text())["items"]
    made = {each["metadata"]["name"] for each in listed}
    made |= {call[call.index("tls") + 1] for call in hour.of("kubectl") if "tls" in call}
    wanted = {each["secretName"] for one in of_kind(hour.manifests, "Ingress") for each in one["spec"].get("tls", ())}
    for container in containers(hour.manifests):
        references = [each.get("valueFrom", {}).get("secretKeyRef") for each in container["env"]]
        wanted |= {each["name"] for each in references if each}
    assert wanted <= made
    programs = [call[0] for call in hour.calls]
    assert max(place for place, call in enumerate(hour.calls) if "apply" in call or "tls" in call) < programs.index(
        "helm"
    )


def test_kubernetes_takes_what_is_applied(hour: Hour) -> None:
    import kubernetes_validate  # here: it loads a library that compiles grammars for seconds

    for call in hour.of("kubectl"):
        if "apply" in call:
            for applied in yaml.safe_load_all((hour.folder / option(call, "-f")).read_text()):
                for each in applied.get("items", [applied]):
                    if not each["apiVersion"].startswith("helm.cattle.io"):
                        kubernetes_validate.validate(each, "1.31", strict=True)


def test_every_image_of_the_release_is_built_and_brought(hour: Hour) -> None:
    wanted = {each["image"] for each in containers(hour.manifests)}
    assert wanted == {option(call, "--tag") for call in hour.of("docker") if call[0] == "build"}
    brought = {call[-1] for call in hour.of("kind") if call[:2] == ["load", "docker-image"]}
    brought |= {call[1] for call in hour.of("docker") if call[0] == "save" and hour.of("k3s")}
    assert wanted == brought


def test_what_is_asked_of_the_release_is_there(hour: Hour) -> None:
    manifests = hour.manifests
    for call in hour.of("kubectl"):
        if "port-forward" in call:
            service = named(manifests, "Service", call[-2].removeprefix("service/"))
            here, there = call[-1].split(":")
            assert int(there) in {each["port"] for each in service["spec"]["ports"]}
            assert f"http://127.0.0.1:{here}" in (hour.folder / "kubernetes" / "values.yaml").read_text()
        if "get" in call:
            assert call[call.index("secret") + 1] in str(manifests)


def test_the_longest_wait_is_longer_than_a_gateway_may_take_to_start(hour: Hour) -> None:
    assert "--wait" in hour.helm
    assert int(option(hour.helm, "--timeout").removesuffix("m")) >= 5
