"""The Helm chart: linted, rendered for a laptop, a GPU, a small cluster and a fleet, checked against Kubernetes' own
schemas, and its settings against what the services take."""

from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from pydantic import SecretStr

import capture2vr
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.gateway.access.api_key import new_secret
from capture2vr.gateway.server import refuse_without_keys
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.process.strict_settings import SettingsError, StrictSettings
from capture2vr.storage.settings import StorageSettings
from tests.support.chart import (
    CHART,
    EXAMPLES,
    OF_OTHERS,
    Manifest,
    containers,
    helm,
    inner,
    of_kind,
    plain_variables,
    render,
    values_of,
)
from tests.support.in_process_gateway import gateway, memory
from tests.support.repository import ROOT

KUBERNETES = ("1.27", "1.31", "1.35")
KEYED, S3 = {"gateway": {"operatorKeySecret": "key"}}, {"existingSecret": "s3"}
TOO_FEW = {"enabled": True, "by": "cpu", "minReplicas": 3, "maxReplicas": 2}
_SELECTS = {"Service": ("spec", "selector"), "PodDisruptionBudget": ("spec", "selector", "matchLabels")}


@pytest.fixture(params=EXAMPLES)
def example(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def manifests(example: str) -> list[Manifest]:
    return render(values_of(example))


def test_there_are_four_examples() -> None:
    assert EXAMPLES == ["fleet", "gpu", "laptop", "small"]


def test_helm_has_nothing_against_it(example: str) -> None:
    found = helm.lint(CHART, values=values_of(example))
    assert found["errors"] == []
    assert [each["error"] for each in found["messages"]] == ["icon is recommended"]


@pytest.mark.slow
def test_kubernetes_takes_every_manifest(manifests: list[Manifest]) -> None:
    import kubernetes_validate  # here: it loads a library that compiles grammars for seconds

    own = [each for each in manifests if not each["apiVersion"].startswith(OF_OTHERS)]
    assert len(own) >= 6
    for version in KUBERNETES:
        for manifest in own:
            kubernetes_validate.validate(manifest, version, strict=True)
    names = [(each["kind"], each["metadata"]["name"]) for each in manifests]
    assert len(names) == len(set(names))


def test_services_budgets_and_scalers_find_what_they_are_for(manifests: list[Manifest]) -> None:
    deployments = of_kind(manifests, "Deployment")
    labels = [inner(each, "spec", "template", "metadata", "labels") for each in deployments]
    for kind, path in _SELECTS.items():
        for manifest in of_kind(manifests, kind):
            wanted = inner(manifest, *path)
            found = [each for each in labels if wanted.items() <= each.items()]
            assert len(found) == 1, f"{kind} {manifest['metadata']['name']} selects {len(found)} deployments"
    for policy in of_kind(manifests, "NetworkPolicy"):
        wanted = inner(policy, "spec", "podSelector", "matchLabels")
        assert any(wanted.items() <= each.items() for each in labels)
    names = {each["metadata"]["name"] for each in deployments}
    for scaler in (*of_kind(manifests, "ScaledObject"), *of_kind(manifests, "HorizontalPodAutoscaler")):
        assert inner(scaler, "spec", "scaleTargetRef", "name") in names


def test_gateways_call_the_workers_by_their_services(manifests: list[Manifest], example: str) -> None:
    workers = {
        name
        for each in containers(manifests)
        for name in plain_variables(each).get("GATEWAY_WORKERS", "").split(",")
        if name
    }
    headless = {
        f"dns:///{each['metadata']['name']}:{each['spec']['ports'][0]['port']}"
        for each in of_kind(manifests, "Service")
        if each["spec"].get("clusterIP") == "None"
    }
    idle = {"dns:///demo-capture2vr-gpu:50051"} if example == "fleet" else set()
    assert workers == headless - idle
    for container in containers(manifests):
        if central := plain_variables(container).get("EDGE_CENTRAL"):
            assert f"dns:///{central}" in headless


def test_every_setting_is_one_that_the_services_take(
    manifests: list[Manifest], monkeypatch: pytest.MonkeyPatch
) -> None:
    secrets = {"GATEWAY_OPERATOR_KEY": new_secret("default"), "GATEWAY_DATABASE_URL": "postgresql+psycopg://u:p@h/d"}
    kinds: dict[str, tuple[type[StrictSettings], ...]] = {
        "gateway": (GatewaySettings, StorageSettings),
        "edge": (EdgeSettings, StorageSettings),
        "bucket": (StorageSettings,),
        "migration": (GatewaySettings,),
        "store": (StorageSettings,),
    }
    for container in containers(manifests):
        with monkeypatch.context() as patch:
            for each in container["env"]:
                patch.setenv(each["name"], each.get("value") or secrets.get(each["name"], "a-long-enough-secret"))
            for settings in kinds[container["name"]]:
                settings()


def test_files_that_are_named_are_mounted(manifests: list[Manifest]) -> None:
    for manifest in of_kind(manifests, "Deployment"):
        pod = manifest["spec"]["template"]["spec"]
        volumes = {each["name"]: each for each in pod["volumes"]}
        for container in pod["containers"]:
            mounts = {each["mountPath"]: volumes[each["name"]] for each in container["volumeMounts"]}
            for value in plain_variables(container).values():
                if value.startswith("/keys/"):
                    folder, _, name = value.rpartition("/")
                    assert name in {item["path"] for item in mounts[folder]["secret"]["items"]}


def test_a_grace_is_longer_than_the_drain(manifests: list[Manifest]) -> None:
    for manifest in of_kind(manifests, "Deployment"):
        pod = manifest["spec"]["template"]["spec"]
        drain = plain_variables(pod["containers"][0]).get("EDGE_DRAIN_S", "0")
        assert pod["terminationGracePeriodSeconds"] > float(drain)


def test_a_gateway_answers_to_the_ingress_name_whatever_the_public_url_is() -> None:
    manifests = render({**values_of("small"), "publicUrl": ""})
    (ingress,) = of_kind(manifests, "Ingress")
    (container,) = [each for each in containers(manifests) if each["name"] == "gateway"]
    allowed = plain_variables(container)["GATEWAY_ALLOWED_HOSTS"].split(",")
    assert {rule["host"] for rule in ingress["spec"]["rules"]} <= set(allowed)


@pytest.mark.parametrize("scrape", [True, False])
def test_what_is_to_be_scraped_can_be_reached(scrape: bool) -> None:
    """Prometheus stands in a namespace of its own: the policies let it in where the pods are annotated."""
    manifests = render({**values_of("small"), "monitoring": {"scrape": scrape}})
    for each in of_kind(manifests, "Deployment"):
        template = each["spec"]["template"]["metadata"]
        port = template.get("annotations", {}).get("prometheus.io/port")
        assert (port is not None) == scrape
        (policy,) = [
            each["spec"]
            for each in of_kind(manifests, "NetworkPolicy")
            if inner(each, "spec", "podSelector", "matchLabels").items() <= template["labels"].items()
        ]
        open_ports = [
            opened["port"]
            for rule in policy["ingress"]
            if {"namespaceSelector": {}} in rule["from"]
            for opened in rule["ports"]
        ]
        assert open_ports == ([int(port)] if port else [])


async def test_probes_and_scalers_ask_what_a_gateway_answers(tmp_path: Path) -> None:
    manifests = render(values_of("small"))
    (scaler,) = of_kind(manifests, "ScaledObject")
    (trigger,) = scaler["spec"]["triggers"]
    assert trigger["metadata"]["authMode"] == "bearer"
    url = httpx.URL(trigger["metadata"]["url"])
    (service,) = [each for each in of_kind(manifests, "Service") if each["metadata"]["name"].endswith("-gateway")]
    assert (url.host, url.port) == (f"{service['metadata']['name']}.vr", service["spec"]["ports"][0]["port"])
    (container,) = [each for each in containers(manifests) if each["name"] == "gateway"]
    allowed = tuple(plain_variables(container)["GATEWAY_ALLOWED_HOSTS"].split(","))
    secret = new_secret("default")
    told = {"operator_key": SecretStr(secret), "host": "0.0.0.0", "allowed_hosts": allowed}
    (tmp_path / "gw").mkdir()
    refuse_without_keys(GatewaySettings(data_dir=tmp_path / "gw", **told))
    with pytest.raises(SettingsError, match="GATEWAY_OPERATOR_KEY: this is no access key"):
        refuse_without_keys(GatewaySettings(data_dir=tmp_path / "gw", operator_key=SecretStr("c2v_short")))
    async with gateway(tmp_path / "gw", memory(), **told) as client:
        for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
            assert (await client.get(container[probe]["httpGet"]["path"])).status_code == 200
        asked = {"Authorization": f"Bearer {secret}", "Host": f"{url.host}:{url.port}"}
        answer = await client.get(url.path, headers=asked)
        assert answer.json()[trigger["metadata"]["valueLocation"]] == 0
        assert (await client.get(url.path)).status_code == 401
    for each in containers(manifests):
        for probe in ("startupProbe", "readinessProbe"):
            if command := each.get(probe, {}).get("exec", {}).get("command"):
                assert importlib.util.find_spec(command[2])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"gatway": {}}, "gatway"),
        ({"workers": {"cpu": {"slotz": 2}}}, "slotz"),
        ({"workers": {"cpu": {"slots": 0}}}, "slots"),
        ({"workers": {"Big_One": {}}}, "Big_One"),
        ({"gateway": {"env": {"EDGE_SLOTS": "1"}}}, "EDGE_SLOTS"),
        ({"storage": {"endpoint": "s3.example"}}, "endpoint"),
        ({"workers": {"cpu": {"scratch": {"accessMode": "ReadWriteOften"}}}}, "accessMode"),
        ({"workers": {"cpu": {"maxUnavailable": "130%"}}}, "maxUnavailable"),
        ({"image": {"edge": "capture2vr-edge@sha256:12"}}, "edge"),
        ({"autoscaling": {"enabled": True}}, "enabled"),
    ],
)
def test_an_unknown_or_wrong_value_is_named(wrong: dict[str, Any], said: str) -> None:
    with helm.Chart.load(CHART) as chart, pytest.raises(helm.HelmError, match=said):
        chart.validate_schema(wrong)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"gateway": {"replicas": 2, "operatorKeySecret": "key"}}, "gateway.replicas is 2: several gateways share a"),
        ({}, "gateway.operatorKeySecret: a gateway that others can reach"),
        ({**KEYED, "ingress": {"enabled": True}}, "ingress.enabled: name the host"),
        ({**KEYED, "gatewayApi": {"enabled": True}}, "gatewayApi.enabled: name the host"),
        ({**KEYED, "gatewayApi": {"enabled": True, "host": "a.example"}}, "as gatewayApi.className"),
        ({**KEYED, "store": {"enabled": True}}, "as storage.existingSecret"),
        ({**KEYED, "store": {"enabled": True}, "storage": {"existingSecret": "s3"}}, "clients read at publicUrl"),
        ({**KEYED, "store": {"enabled": True}, "storage": {**S3, "endpoint": "http://s3"}}, "leave storage.endpoint"),
        ({**KEYED, "workers": {"cpu": {"autoscaling": {"enabled": True}}}}, "KEDA asks the gateway with an access key"),
        ({**KEYED, "workers": {"cpu": {"autoscaling": TOO_FEW}}}, "minReplicas is more than maxReplicas"),
        ({**KEYED, "storage": {"presignSeconds": 0}}, "name the CDN"),
        ({**KEYED, "workers": {"cpu": {"central": "gpu"}}}, "central is gpu"),
        ({**KEYED, "workers": {"cpu": {"central": "cpu"}}}, "a central of its own"),
        ({**KEYED, "workers": {"gateway": {}}}, "the gateways have that name"),
        ({**KEYED, "workers": {"store": {}}}, "the store has that name"),
        ({**KEYED, "workers": {"cpu": {"takesJobs": False}}}, "no pool has takesJobs"),
    ],
)  # fmt: skip
def test_values_that_contradict_each_other_are_named(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(helm.HelmError, match=said):
        render(wrong)


def test_the_chart_is_of_the_products_version() -> None:
    chart = yaml.safe_load((CHART / "Chart.yaml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert chart["version"] == chart["appVersion"] == capture2vr.__version__ == project["version"]


def test_the_schema_knows_every_value() -> None:
    with helm.Chart.load(CHART) as chart:
        chart.validate_schema({"gateway": {"operatorKeySecret": "key"}})
        schema = chart.schema
    values = yaml.safe_load((CHART / "values.yaml").read_text())
    assert schema is not None
    _compare({**values, "workers": {}, "global": {}}, schema, schema)


def _compare(values: dict[str, Any], described: dict[str, Any], schema: dict[str, Any]) -> None:
    """Compare values with the properties of a schema, at all depths; what may have any name is left out."""
    if "$ref" in described:
        described = schema["definitions"][described["$ref"].removeprefix("#/definitions/")]
    if "properties" not in described:
        return
    assert set(values) == set(described["properties"])
    for name, value in values.items():
        if isinstance(value, dict):
            _compare(value, described["properties"][name], schema)
