"""Rules, dashboards, the Alertmanager and the log of alerts ask for what there is, and people are told what to do.

Prometheus' own tools check and run the rules where they are installed: `apt-get install prometheus
prometheus-alertmanager`.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker.metrics import WorkerMetrics
from capture2vr.gateway.database.disks import Disk
from capture2vr.gateway.jobs.job import State
from capture2vr.gateway.jobs.job_counts import QueueFigures
from capture2vr.gateway.metrics.metrics import Metrics
from tests.support.patience import PATIENCE_S
from tests.support.repository import ROOT

OBSERVE, MONITORING = ROOT / "deploy" / "observe", ROOT / "deploy" / "chart" / "monitoring"
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
GROUPS = yaml.safe_load((MONITORING / "rules.yml").read_text())["groups"]
RULES = [rule for group in GROUPS for rule in group["rules"]]
ALERTS = [rule for rule in RULES if "alert" in rule]
RECORDED = {rule["record"] for rule in RULES if "record" in rule}
DASHBOARDS = [json.loads((MONITORING / f"{name}.json").read_text()) for name in ("service", "objectives")]
QUERIES = sorted(
    {rule["expr"] for rule in RULES}
    | {target["expr"] for board in DASHBOARDS for panel in board["panels"] for target in panel["targets"]}
)
_SELECTOR = re.compile(r"([A-Za-z_][A-Za-z0-9_:]*)\s*(\{[^}]*\})?(?:\[[^\]]*\])?")
_LABEL = re.compile(r"([a-z_]+)\s*(?:=~|!~|!=|=)")
_GROUPED = re.compile(r"\bby\s*\(([^)]*)\)")
_OF_PROMETHEUS = {
    "up": {"job", "instance"},
    "ALERTS": {"alertstate", "alertname"},
    "alertmanager_notifications_failed_total": set(),
    "prometheus_notifications_dropped_total": set(),
}


@pytest.fixture(scope="module")
def exported() -> dict[str, set[str]]:
    """Names of samples that are exported, and the names of their labels."""
    worker = WorkerMetrics(version="1", device="cpu", slots=1, memory_bytes=1)
    worker.observe_end(pb.Finished(seconds={"FITTING": 1.0}))
    worker.show_expiries({"EDGE_TLS_CERT": 1.0})
    gateway = Metrics()
    gateway.observe_response("GET", "/", 200, 0.1, 0, streamed=False)
    gateway.observe_webhook("failed")
    gateway.observe_damage("file")
    gateway.jobs.show_queue(QueueFigures(dict.fromkeys(State, 0), None))
    gateway.jobs._job_s.labels("FAILED").observe(1.0)
    gateway.vitals.show_checks({"store": (True, 0.1)})
    gateway.vitals.show_disks([Disk("objects", 1, 2)])
    gateway.vitals.show_workers(1, 1)
    gateway.vitals.show_copy("backup", 1.0)
    found: dict[str, set[str]] = defaultdict(set)
    for text in (generate_latest(worker._registry), gateway.render(0)):
        for family in text_string_to_metric_families(text.decode()):
            for sample in family.samples:
                found[sample.name] |= set(sample.labels) | {"job", "instance"}
    return found


@pytest.mark.parametrize("query", QUERIES)
def test_a_query_asks_for_what_there_is(query: str, exported: dict[str, set[str]]) -> None:
    known = {**exported, **_OF_PROMETHEUS, **{key: {"objective"} for key in RECORDED}}
    named = [
        (name, set(_LABEL.findall(re.sub(r'"[^"]*"', "", labels))))
        for name, labels in _SELECTOR.findall(query)
        if name.startswith(("capture2vr", "process_")) or name in _OF_PROMETHEUS
    ]
    assert named or query.startswith("vector(")
    for name, labels in named:
        assert name in known
        assert labels <= known[name]
    grouped = {label.strip() for labels in _GROUPED.findall(query) for label in labels.split(",")}
    assert grouped <= {label for name, _ in named for label in known[name]}


def test_thresholds_are_bounds_of_buckets() -> None:
    """A histogram has no other values of `le`; a query for one finds nothing, and its objective is never missed."""
    metrics = Metrics()
    worker = WorkerMetrics(version="1", device="cpu", slots=1, memory_bytes=1)
    worker.observe_end(pb.Finished(seconds={"PUBLISHING": 1.0}))
    texts = (metrics.render(0).decode(), generate_latest(worker._registry).decode())
    samples = {line.rpartition(" ")[0] for text in texts for line in text.splitlines()}
    asked = {
        (name, le)
        for query in QUERIES
        for name, labels in re.findall(r"(\w+_bucket)\{([^}]*)\}", query)
        for le in re.findall(r'le="([^"]*)"', labels)
    }
    assert len(asked) == 3
    for name, le in asked:
        assert any(sample.startswith(name) and f'le="{le}"' in sample for sample in samples)


def test_every_alert_has_its_row_and_every_row_its_alert() -> None:
    text = (ROOT / "deploy" / "runbook.md").read_text()
    section = re.search(r"\n### Alerts\n(.*?)\n##", text, re.DOTALL)
    assert section is not None
    rows = dict(re.findall(r"^\| `(\w+)` +\|(.*)\|$", section[1], re.MULTILINE))
    assert rows.keys() == {rule["alert"] for rule in ALERTS}
    assert all(len(row.split(" | ")[-1].split()) >= 4 for row in rows.values()), "each says what to do"
    for rule in ALERTS:
        assert rule["annotations"]["runbook"] == "deploy/runbook.md#alerts"


def test_an_alert_says_what_is_wrong_and_how_urgent_it_is() -> None:
    for rule in ALERTS:
        assert rule["annotations"]["summary"].endswith(".")
        assert rule["labels"]["severity"] in ({"none"} if rule["alert"] == "Heartbeat" else {"page", "warn"})
    pairs = [(rule["alert"], rule["labels"]["severity"]) for rule in ALERTS]
    assert len(pairs) == len(set(pairs))


def test_objectives_differ_by_what_they_count_alone() -> None:
    by_objective: dict[str, list[str]] = defaultdict(list)
    for rule in RULES:
        if "record" in rule:
            by_objective[rule["labels"]["objective"]].append(rule["record"])
            window = re.search(r"rate(\w+)$|increase(\w+)$", rule["record"])
            if window:
                assert set(re.findall(r"\[(\w+)\]", rule["expr"])) == {window[1] or window[2]}
    assert set(map(tuple, by_objective.values())) == {tuple(by_objective["queue"])}
    for objective in by_objective:
        own = [rule["expr"] for rule in ALERTS if f'objective="{objective}"' in rule["expr"]]
        assert {expr.replace(objective, "queue") for expr in own} == {
            rule["expr"] for rule in ALERTS if rule["alert"] == "JobsWait"
        }


@pytest.mark.parametrize("board", DASHBOARDS, ids=lambda board: board["uid"])
def test_panels_do_not_lie_on_each_other(board: dict[str, Any]) -> None:
    taken = {(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in board["panels"]}
    assert len(taken) == len(board["panels"])
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])


def test_traces_go_to_a_service_of_the_profile() -> None:
    """The endpoint that the runbook names, by Jaeger's own port for OTLP over HTTP."""
    services = COMPOSE["services"]
    (endpoint,) = set(re.findall(r"OTEL_EXPORTER_OTLP_ENDPOINT=(\S+)", (ROOT / "deploy" / "runbook.md").read_text()))
    assert endpoint == "http://jaeger:4318"
    assert services["jaeger"]["profiles"] == services["grafana"]["profiles"] == ["observe"]
    for name in ("gateway", "edge"):
        assert set(services[name]["networks"]) <= set(services["jaeger"]["networks"])
        assert services[name]["environment"]["OTEL_EXPORTER_OTLP_ENDPOINT"] == "${OTEL_EXPORTER_OTLP_ENDPOINT:-}"


def test_compose_scrapes_what_listens_and_tells_who_hears() -> None:
    services = COMPOSE["services"]
    prometheus = yaml.safe_load((OBSERVE / "prometheus.yml").read_text())
    scraped = {each["job_name"]: each for each in prometheus["scrape_configs"]}
    ports = {
        name: config["port"]
        for each in scraped.values()
        for config in each.get("dns_sd_configs", ())
        for name in config["names"]
    }
    assert set(ports) == {"gateway", "edge", "edge-gpu"}
    assert ports.pop("gateway") == 8080
    for name, port in ports.items():
        assert services[name]["environment"]["EDGE_METRICS_PORT"] == port
    token = services["gateway"]["environment"]["GATEWAY_METRICS_TOKEN_FILE"]
    assert scraped["gateway"]["authorization"]["credentials_file"] == token
    assert any(str(each).startswith("secret:/secret") for each in services["prometheus"]["volumes"])
    ((told,),) = [each["targets"] for each in prometheus["alerting"]["alertmanagers"][0]["static_configs"]]
    assert told.partition(":")[0] in services
    for name in ("prometheus", "grafana", "alertmanager", "alert-log"):
        assert services[name]["profiles"] == ["observe"]
        for volume in services[name]["volumes"]:
            source = str(volume).partition(":")[0]
            assert not source.startswith("./") or (ROOT / source).exists()


# ---- the Alertmanager and the log of alerts ----

_EVERYTHING = {
    "ALERT_WEBHOOK_URL": "https://hooks.example/a'b: {c}",
    "ALERT_SLACK_URL": "https://hooks.slack.example/x",
    "ALERT_SLACK_CHANNEL": "#alerts",
    "ALERT_MAIL_TO": "ada@example.org",
    "ALERT_MAIL_FROM": "alerts@example.org",
    "ALERT_MAIL_HOST": "smtp.example.org:587",
    "ALERT_MAIL_USER": "ada",
    "ALERT_MAIL_PASSWORD": "it's\n'quoted': [1",
    "ALERT_HEARTBEAT_URL": "https://heart.example/1",
}


def configuration(**variables: str) -> str:
    command = ["sh", str(OBSERVE / "alertmanager.sh"), "--print"]
    environment = {"PATH": os.environ["PATH"], **variables}
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout


def test_the_log_hears_alerts_whatever_else_is_set() -> None:
    for variables in ({}, _EVERYTHING):
        people, heartbeat = yaml.safe_load(configuration(**variables))["receivers"]
        assert people["webhook_configs"][0]["url"] == "http://alert-log:9094/"
        assert ("webhook_configs" in heartbeat) == bool(variables)
    assert people["webhook_configs"][1]["url"] == _EVERYTHING["ALERT_WEBHOOK_URL"]
    assert people["slack_configs"][0]["channel"] == "#alerts"
    (mail,) = people["email_configs"]
    assert (mail["to"], mail["smarthost"]) == ("ada@example.org", "smtp.example.org:587")
    assert mail["auth_password"] == "it's'quoted': [1", "a password has no line breaks"
    set_here = set(re.findall(r"ALERT_\w+", (OBSERVE / "alertmanager.sh").read_text())) - {"ALERT_LOG_URL"}
    assert set_here == set(COMPOSE["services"]["alertmanager"]["environment"]) == set(_EVERYTHING)
    names = {rule["alert"] for rule in ALERTS}
    for rule in yaml.safe_load(configuration())["inhibit_rules"]:
        for matcher in (*rule["source_matchers"], *rule["target_matchers"]):
            if matcher.startswith("alertname"):
                assert set(matcher.split('"')[1].split("|")) <= names


def test_alerts_are_written_down_and_what_is_none_is_refused(tmp_path: Path, unused_tcp_port: int) -> None:
    file = tmp_path / "alerts.jsonl"
    alert = {
        "status": "firing",
        "labels": {"alertname": "NoGateway", "severity": "page"},
        "annotations": {"summary": "No gateway\nanswers.", "runbook": "deploy/runbook.md#alerts"},
        "startsAt": "2026-01-01T00:00:00Z",
    }
    command = [sys.executable, str(OBSERVE / "alert_log.py"), str(file), str(unused_tcp_port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert [_post(unused_tcp_port, body) for body in (b"{", b"[]", b"", b'{"alerts": [1]}')] == [
                400,
                400,
                413,
                400,
            ]
            body = json.dumps({"alerts": [alert, {**alert, "status": "resolved", "endsAt": "later"}]}).encode()
            assert _post(unused_tcp_port, body) == 200
        finally:
            server.terminate()
        assert server.stdout is not None
        assert server.stdout.read() == file.read_text()
    first, second = map(json.loads, file.read_text().splitlines())
    assert (first["alert"], first["status"], first["at"]) == ("NoGateway", "firing", alert["startsAt"])
    assert first["summary"] == "No gateway\nanswers."
    assert (second["status"], second["at"], second["severity"]) == ("resolved", "later", "page")


def _post(port: int, body: bytes) -> int:
    """POST to the log, which may just be starting; the status of its answer."""
    import time

    until = time.monotonic() + PATIENCE_S
    while True:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        try:
            connection.request("POST", "/", body)
            return connection.getresponse().status
        except ConnectionRefusedError:
            if time.monotonic() > until:
                raise
            time.sleep(0.05)
        finally:
            connection.close()


# ---- Prometheus' own tools ----


def tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def test_prometheus_takes_configuration_and_rules(tmp_path: Path) -> None:
    text = (OBSERVE / "prometheus.yml").read_text()
    (tmp_path / "prometheus.yml").write_text(
        text.replace("/etc/prometheus", str(MONITORING)).replace("/secret/metrics", str(MONITORING / "rules.yml"))
    )
    done = subprocess.run(
        [tool("promtool"), "check", "config", str(tmp_path / "prometheus.yml")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_alerts_fire_when_they_should_and_not_before(tmp_path: Path) -> None:
    rules = Path(__file__).parent / "rules_test.yml"
    (tmp_path / "rules_test.yml").write_text(rules.read_text().replace("RULES", str(MONITORING / "rules.yml")))
    done = subprocess.run(
        [tool("promtool"), "test", "rules", str(tmp_path / "rules_test.yml")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("variables", [{}, _EVERYTHING], ids=["the log alone", "everything"])
def test_alertmanager_takes_its_configuration(tmp_path: Path, variables: dict[str, str]) -> None:
    path = tmp_path / "alertmanager.yml"
    path.write_text(configuration(**variables).replace("a'b: {c}", "").replace("a''b: {c}", ""))
    done = subprocess.run([tool("amtool"), "check-config", str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
