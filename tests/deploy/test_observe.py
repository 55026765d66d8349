"""Alerts and the dashboard ask for metrics that gateways and workers give, with labels that they have."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker.metrics import WorkerMetrics
from capture2vr.gateway.jobs.job import State
from capture2vr.gateway.metrics import Metrics
from tests.support.repository import ROOT

OBSERVE = ROOT / "deploy" / "observe"
RULES = yaml.safe_load((OBSERVE / "alerts.yml").read_text())["groups"][0]["rules"]
DASHBOARD = json.loads((OBSERVE / "grafana" / "capture2vr.json").read_text())
QUERIES = [rule["expr"] for rule in RULES] + [
    target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]
]
_OF_PROMETHEUS = {"up", "job", "instance"}
_WORDS = re.compile(r"[a-z_][a-z0-9_]*")
_FUNCTIONS = {
    *("absent", "and", "or", "on", "by", "sum", "max", "rate", "increase", "histogram_quantile"),
}


@pytest.fixture(scope="module")
def exported() -> dict[str, set[str]]:
    """Names of samples that are exported, and the names of their labels."""
    worker = WorkerMetrics(version="1", device="cpu", slots=1, memory_bytes=1)
    worker.observe_end(pb.Finished(seconds={"FITTING": 1.0}))
    gateway = Metrics()
    gateway.observe_response("GET", "/", 200, 0.1, 0, streamed=False)
    gateway.observe_webhook("failed")
    gateway.observe_damage("file")
    gateway._job_s.labels("FAILED").observe(1.0)
    texts = generate_latest(worker._registry), gateway.render(dict.fromkeys(State, 0), 0)
    return {
        sample.name: set(sample.labels)
        for text in texts
        for family in text_string_to_metric_families(text.decode())
        for sample in family.samples
    }


def test_traces_go_to_a_service_of_the_profile() -> None:
    """The endpoint that the runbook names, by Jaeger's own port for OTLP over HTTP."""
    services = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    (endpoint,) = set(re.findall(r"OTEL_EXPORTER_OTLP_ENDPOINT=(\S+)", (ROOT / "deploy" / "runbook.md").read_text()))
    assert endpoint == "http://jaeger:4318"
    assert services["jaeger"]["profiles"] == services["grafana"]["profiles"] == ["observe"]
    for name in ("gateway", "edge"):
        assert set(services[name]["networks"]) <= set(services["jaeger"]["networks"])
        assert services[name]["environment"]["OTEL_EXPORTER_OTLP_ENDPOINT"] == "${OTEL_EXPORTER_OTLP_ENDPOINT:-}"


def test_prometheus_can_be_given_its_key() -> None:
    """Compose refuses a secret that is no file to a service whose file system is read-only."""
    compose = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    assert compose["services"]["prometheus"]["secrets"] == ["operator_key"]
    for service in compose["services"].values():
        for secret in service.get("secrets", ()):
            assert "file" in compose["secrets"][secret] or not service["read_only"]


@pytest.mark.parametrize("query", QUERIES)
def test_a_query_asks_for_what_there_is(query: str, exported: dict[str, set[str]]) -> None:
    bare = re.sub(r'"[^"]*"|\[[^\]]*\]', "", query)
    words = set(_WORDS.findall(bare)) - _FUNCTIONS - _OF_PROMETHEUS
    metrics = {word for word in words if word.startswith(("capture2vr_", "process_"))}
    assert metrics or "up" in _WORDS.findall(bare)
    assert metrics <= exported.keys()
    labels = {label for name in metrics for label in exported[name]}
    assert words - metrics <= labels, "labels that no metric of the query has"


def test_every_alert_says_what_to_do() -> None:
    assert len({rule["alert"] for rule in RULES}) == len(RULES) >= 6
    for rule in RULES:
        assert rule["annotations"]["summary"].endswith((".", "last ones."))
        assert rule["labels"]["severity"] in {"page", "warn"}


def test_panels_do_not_lie_on_each_other() -> None:
    taken = {(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in DASHBOARD["panels"]}
    assert len(taken) == len(DASHBOARD["panels"])
    assert len({panel["id"] for panel in DASHBOARD["panels"]}) == len(DASHBOARD["panels"])


def test_compose_scrapes_what_listens() -> None:
    compose: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    scraped = yaml.safe_load((OBSERVE / "prometheus.yml").read_text())["scrape_configs"]
    ports = {name: config["port"] for each in scraped for config in each["dns_sd_configs"] for name in config["names"]}
    assert set(ports) == {"gateway", "edge", "edge-gpu"}
    assert ports.pop("gateway") == 8080
    for name, port in ports.items():
        assert compose[name]["environment"]["EDGE_METRICS_PORT"] == port
    for name in ("prometheus", "grafana"):
        assert compose[name]["profiles"] == ["observe"]
        for volume in compose[name]["volumes"]:
            source = str(volume).partition(":")[0]
            if source.startswith("./"):
                assert Path(ROOT, source).exists()
