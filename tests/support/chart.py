"""The Helm chart as a cluster would see it: rendered without one, by Helm's own library."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
import yaml

from tests.support.repository import ROOT

helm = pytest.importorskip("helm_python", reason="Helm's library has no wheel for this machine")

CHART = ROOT / "deploy" / "chart"
EXAMPLES = sorted(path.stem for path in (CHART / "examples").glob("*.yaml"))
OF_OTHERS = ("keda.sh/", "gateway.networking.k8s.io/")
"""API groups that Kubernetes itself does not have."""

Manifest = dict[str, Any]


@cache
def values_of(example: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((CHART / "examples" / f"{example}.yaml").read_text())
    return found


def render(values: dict[str, Any], release: str = "demo") -> list[Manifest]:
    """Render the chart's manifests for these values. Raises helm.HelmError."""
    return [each for text in _files(json.dumps(values), release) for each in yaml.safe_load_all(text) if each]


@cache  # a rendering takes a while, and the same examples are looked at from many sides
def _files(values: str, release: str) -> list[str]:
    with helm.Chart.load(CHART) as chart:
        files = chart.render(json.loads(values), name=release, namespace="vr")
    return [text for name, text in files.items() if name.endswith(".yaml")]


def of_kind(manifests: list[Manifest], kind: str) -> list[Manifest]:
    return [each for each in manifests if each["kind"] == kind]


def pods(manifests: list[Manifest]) -> list[Manifest]:
    """The deployments and jobs, each of which has a template of a pod."""
    return [*of_kind(manifests, "Deployment"), *of_kind(manifests, "Job")]


def containers(manifests: list[Manifest]) -> Iterator[Manifest]:
    for each in pods(manifests):
        yield from each["spec"]["template"]["spec"]["containers"]


def named(manifests: list[Manifest], kind: str, name: str) -> Manifest:
    (found,) = [each for each in of_kind(manifests, kind) if each["metadata"]["name"] == name]
    return found


def inner(manifest: Manifest, *path: str) -> Any:
    for name in path:
        manifest = manifest[name]
    return manifest


def plain_variables(container: Manifest) -> dict[str, str]:
    """The variables of a container whose values stand in the manifest."""
    return {each["name"]: each["value"] for each in container["env"] if "value" in each}
