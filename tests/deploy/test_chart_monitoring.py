"""The chart's monitoring: what Prometheus' operator and Grafana get is what compose has, and finds what it asks."""

from __future__ import annotations

import json
from typing import Any

import pytest
import yaml

from tests.deploy.test_chart import CHART, containers, helm, of_kind, render, values_of

MONITORED = {"enabled": True, "tokenSecret": "metrics", "namespace": "watch", "labels": {"release": "stack"}}


@pytest.fixture(scope="module")
def manifests() -> list[dict[str, Any]]:
    return render({**values_of("small"), "monitoring": MONITORED})


def test_rules_and_dashboards_are_those_of_compose(manifests: list[dict[str, Any]]) -> None:
    (rules,) = of_kind(manifests, "PrometheusRule")
    assert rules["spec"] == yaml.safe_load((CHART / "monitoring" / "rules.yml").read_text())
    assert rules["metadata"]["labels"]["release"] == "stack"
    (boards,) = of_kind(manifests, "ConfigMap")
    assert boards["metadata"]["labels"]["grafana_dashboard"] == "1"
    found = [json.loads(text) for text in boards["data"].values()]
    assert found == [
        json.loads((CHART / "monitoring" / f"{name}.json").read_text()) for name in ("service", "objectives")
    ]


def test_monitors_find_their_ports_and_the_token_of_the_gateways(manifests: list[dict[str, Any]]) -> None:
    (service,) = of_kind(manifests, "ServiceMonitor")
    (endpoint,) = service["spec"]["endpoints"]
    wanted = service["spec"]["selector"]["matchLabels"].items()
    chosen = [each for each in of_kind(manifests, "Service") if wanted <= each["metadata"]["labels"].items()]
    named = [each for each in chosen if endpoint["port"] in {port["name"] for port in each["spec"]["ports"]}]
    assert [each["metadata"]["name"] for each in named] == ["demo-capture2vr-gateway"]
    secret = endpoint["authorization"]["credentials"]
    (gateway,) = [each for each in containers(manifests) if each["name"] == "gateway"]
    (token,) = [each for each in gateway["env"] if each["name"] == "GATEWAY_METRICS_TOKEN"]
    assert token["valueFrom"]["secretKeyRef"] == secret == {"name": "metrics", "key": "token"}
    (pods,) = of_kind(manifests, "PodMonitor")
    (metrics,) = pods["spec"]["podMetricsEndpoints"]
    labels = pods["spec"]["selector"]["matchLabels"].items()
    workers = [
        each["spec"]["template"]
        for each in of_kind(manifests, "Deployment")
        if labels <= each["spec"]["template"]["metadata"]["labels"].items()
    ]
    assert workers
    for worker in workers:
        ports = {port["name"]: port["containerPort"] for port in worker["spec"]["containers"][0]["ports"]}
        assert ports[metrics["port"]] == 9464
    jobs = [endpoint["relabelings"][0]["replacement"], metrics["relabelings"][0]["replacement"]]
    assert jobs == ["gateway", "worker"], "the names that the rules ask for"


def test_prometheus_is_let_in_from_its_namespace_alone(manifests: list[dict[str, Any]]) -> None:
    (policy,) = [each for each in of_kind(manifests, "NetworkPolicy") if each["metadata"]["name"].endswith("-metrics")]
    (rule,) = policy["spec"]["ingress"]
    assert rule["from"] == [{"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": "watch"}}}]
    assert [port["port"] for port in rule["ports"]] == [8080, 9464]


def test_without_monitoring_there_is_none_of_it_and_without_a_token_it_is_refused() -> None:
    kinds = {each["kind"] for each in render(values_of("small"))}
    assert not kinds & {"ServiceMonitor", "PodMonitor", "PrometheusRule", "ConfigMap"}
    with pytest.raises(helm.HelmError, match=r"monitoring\.tokenSecret"):
        render({**values_of("small"), "monitoring": {"enabled": True}})
