"""The Helm chart: linted, rendered for a laptop, a small cluster and a fleet, checked against Kubernetes' own schemas,
and its settings against what the services take."""

from __future__ import annotations

import importlib.util
import tomllib
from collections.abc import Iterator
from functools import cache
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
from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.settings import StorageSettings
from tests.support.in_process_gateway import gateway, memory
from tests.support.repository import ROOT

helm = pytest.importorskip("helm_python", reason="Helm's library has no wheel for this machine")

CHART = ROOT / "deploy" / "chart"
EXAMPLES = sorted(path.stem for path in (CHART / "examples").glob("*.yaml"))
KUBERNETES = ("1.27", "1.31", "1.35")
_SELECTS = {"Service": ("spec", "selector"), "PodDisruptionBudget": ("spec", "selector", "matchLabels")}


@cache
def values_of(example: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((CHART / "examples" / f"{example}.yaml").read_text())
    return found


def render(values: dict[str, Any]) -> list[dict[str, Any]]:
    with helm.Chart.load(CHART) as chart:
        files = chart.render(values, name="demo", namespace="vr")
    texts = [text for name, text in files.items() if name.endswith(".yaml")]
    return [each for text in texts for each in yaml.safe_load_all(text) if each]


@pytest.fixture(params=EXAMPLES)
def example(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def manifests(example: str) -> list[dict[str, Any]]:
    return render(values_of(example))


def of_kind(manifests: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [each for each in manifests if each["kind"] == kind]


def containers(manifests: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for each in (*of_kind(manifests, "Deployment"), *of_kind(manifests, "Job")):
        yield from each["spec"]["template"]["spec"]["containers"]


def inner(manifest: dict[str, Any], *path: str) -> Any:
    for name in path:
        manifest = manifest[name]
    return manifest


def test_there_are_three_examples() -> None:
    assert EXAMPLES == ["fleet", "laptop", "small"]


def test_helm_has_nothing_against_it(example: str) -> None:
    found = helm.lint(CHART, values=values_of(example))
    assert found["errors"] == []
    assert [each["error"] for each in found["messages"]] == ["icon is recommended"]


@pytest.mark.slow
def test_kubernetes_takes_every_manifest(manifests: list[dict[str, Any]]) -> None:
    import kubernetes_validate  # here: it loads a library that compiles grammars for seconds

    own = [each for each in manifests if "keda.sh" not in each["apiVersion"]]
    assert len(own) >= 6
    for version in KUBERNETES:
        for manifest in own:
            kubernetes_validate.validate(manifest, version, strict=True)
    names = [(each["kind"], each["metadata"]["name"]) for each in manifests]
    assert len(names) == len(set(names))


def test_services_budgets_and_scalers_find_what_they_are_for(manifests: list[dict[str, Any]]) -> None:
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
    for scaler in of_kind(manifests, "ScaledObject"):
        assert inner(scaler, "spec", "scaleTargetRef", "name") in names


def test_gateways_call_the_workers_by_their_services(manifests: list[dict[str, Any]], example: str) -> None:
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


def plain_variables(container: dict[str, Any]) -> dict[str, str]:
    return {each["name"]: each["value"] for each in container["env"] if "value" in each}


def test_every_setting_is_one_that_the_services_take(
    manifests: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    secrets = {"GATEWAY_OPERATOR_KEY": new_secret("default"), "GATEWAY_DATABASE_URL": "postgresql+psycopg://u:p@h/d"}
    kinds = {
        "gateway": (GatewaySettings, StorageSettings),
        "edge": (EdgeSettings, StorageSettings),
        "bucket": (StorageSettings,),
    }
    for container in containers(manifests):
        with monkeypatch.context() as patch:
            for each in container["env"]:
                patch.setenv(each["name"], each.get("value") or secrets.get(each["name"], "a-long-enough-secret"))
            for settings in kinds[container["name"]]:
                settings()


def test_files_that_are_named_are_mounted(manifests: list[dict[str, Any]]) -> None:
    for manifest in of_kind(manifests, "Deployment"):
        pod = manifest["spec"]["template"]["spec"]
        volumes = {each["name"]: each for each in pod["volumes"]}
        for container in pod["containers"]:
            mounts = {each["mountPath"]: volumes[each["name"]] for each in container["volumeMounts"]}
            for value in plain_variables(container).values():
                if value.startswith("/keys/"):
                    folder, _, name = value.rpartition("/")
                    assert name in {item["path"] for item in mounts[folder]["secret"]["items"]}


def test_nothing_runs_as_root_or_writes_to_its_image(manifests: list[dict[str, Any]]) -> None:
    for manifest in (*of_kind(manifests, "Deployment"), *of_kind(manifests, "Job")):
        assert inner(manifest, "spec", "template", "spec", "securityContext", "runAsNonRoot") is True
    for container in containers(manifests):
        assert container["securityContext"]["readOnlyRootFilesystem"] is True
        assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
        assert container["resources"]["limits"]["memory"]


def test_a_grace_is_longer_than_the_drain(manifests: list[dict[str, Any]]) -> None:
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
        ({"autoscaling": {"enabled": True}}, "autoscaling.enabled: KEDA asks the gateway with an access key"),
        ({"gateway": {"operatorKeySecret": "key"}, "ingress": {"enabled": True}}, "ingress.enabled: name the host"),
        ({"gateway": {"operatorKeySecret": "key"}, "storage": {"presignSeconds": 0}}, "name the CDN"),
        ({"gateway": {"operatorKeySecret": "key"}, "workers": {"cpu": {"central": "gpu"}}}, "central is gpu"),
        ({"gateway": {"operatorKeySecret": "key"}, "workers": {"cpu": {"central": "cpu"}}}, "a central of its own"),
        ({"gateway": {"operatorKeySecret": "key"}, "workers": {"gateway": {}}}, "the gateways have that name"),
        ({"gateway": {"operatorKeySecret": "key"}, "workers": {"cpu": {"takesJobs": False}}}, "no pool has takesJobs"),
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
    assert set(values) == set(schema["properties"]) - {"global"}
    for name, inside in values.items():
        if isinstance(inside, dict) and name != "workers":
            assert set(inside) == set(schema["properties"][name]["properties"])
