"""The chart's pods keep a policy; pools of workers scale, spread, and are evicted each by its own values."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import pytest

from tests.support.chart import (
    EXAMPLES,
    Manifest,
    containers,
    inner,
    named,
    of_kind,
    plain_variables,
    pods,
    render,
    values_of,
)

KEYED = {"gateway": {"operatorKeySecret": "key"}}
DIGEST = "@sha256:" + "0a" * 32
ELSEWHERE = {
    "storage": {"endpoint": "https://s3.example", "existingSecret": "s3"},
    "database": {"existingSecret": "postgres"},
}
CASES: dict[str, dict[str, Any]] = {
    "minimal": KEYED,
    "by digest": {**KEYED, "image": {"gateway": f"gateway{DIGEST}", "edge": f"edge{DIGEST}", "registry": "a.example/"}},
    "elsewhere": {**KEYED, **ELSEWHERE},
    "gateway api": {**KEYED, "gatewayApi": {"enabled": True, "host": "a.example", "className": "eg"}},
    "scaled": {
        **KEYED,
        "autoscaling": {"keySecret": "key"},
        "workers": {
            "cpu": {"autoscaling": {"enabled": True, "by": "cpu"}},
            "gpu": {"slots": 4, "autoscaling": {"enabled": True, "maxReplicas": 3}},
        },
    },
    **{name: values_of(name) for name in EXAMPLES},
}


@pytest.fixture(params=CASES)
def manifests(request: pytest.FixtureRequest) -> list[Manifest]:
    return render(CASES[request.param])


def violations(manifest: Manifest) -> Iterator[str]:
    """Yield what a pod's template breaks of the restricted Pod Security Standard, and of what goes beyond it."""
    pod = inner(manifest, "spec", "template", "spec")
    security = pod.get("securityContext", {})
    if security.get("runAsNonRoot") is not True:
        yield "runs as root"
    if security.get("seccompProfile", {}).get("type") != "RuntimeDefault":
        yield "seccomp"
    if pod.get("automountServiceAccountToken") is not False:
        yield "token"
    if any(pod.get(name) for name in ("hostNetwork", "hostPID", "hostIPC")):
        yield "host's namespaces"
    if any("hostPath" in volume for volume in pod.get("volumes", ())):
        yield "host's files"
    for container in pod["containers"]:
        yield from _violations_of_container(container, is_service=manifest["kind"] == "Deployment")


def _violations_of_container(container: Manifest, *, is_service: bool) -> Iterator[str]:
    security, resources = container.get("securityContext", {}), container.get("resources", {})
    if security.get("allowPrivilegeEscalation") is not False or security.get("privileged"):
        yield "privileges"
    if security.get("readOnlyRootFilesystem") is not True:
        yield "writes to its image"
    if security.get("capabilities") != {"drop": ["ALL"]}:
        yield "capabilities"
    if not {"cpu", "memory"} <= set(resources.get("requests", {})):
        yield "requests"
    if "memory" not in resources.get("limits", {}):
        yield "limits"
    if not re.fullmatch(r"[^:@]+(:(?!latest$)[^:@]+|@sha256:[0-9a-f]{64})", container["image"]):
        yield "image"
    for probe in ("startupProbe", "readinessProbe", "livenessProbe") if is_service else ():
        if not {"exec", "httpGet"} & set(container.get(probe, {})):
            yield probe


def test_every_pod_keeps_the_policy(manifests: list[Manifest]) -> None:
    assert len(pods(manifests)) >= 2
    for each in pods(manifests):
        assert list(violations(each)) == [], each["metadata"]["name"]


def _in_pod(**changes: object) -> Callable[[Manifest], None]:
    return lambda manifest: inner(manifest, "spec", "template", "spec").update(changes)


def _in_container(**changes: object) -> Callable[[Manifest], None]:
    return lambda manifest: inner(manifest, "spec", "template", "spec")["containers"][0].update(changes)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (_in_pod(securityContext={}), {"runs as root", "seccomp"}),
        (_in_pod(automountServiceAccountToken=True), {"token"}),
        (_in_pod(hostNetwork=True), {"host's namespaces"}),
        (_in_pod(volumes=[{"name": "host", "hostPath": {"path": "/"}}]), {"host's files"}),
        (_in_container(securityContext={}), {"privileges", "writes to its image", "capabilities"}),
        (_in_container(resources={}), {"requests", "limits"}),
        (_in_container(image="a.example/edge:latest"), {"image"}),
        (_in_container(image="a.example/edge"), {"image"}),
        (_in_container(livenessProbe={}), {"livenessProbe"}),
    ],
)  # fmt: skip
def test_the_policy_sees_what_breaks_it(change: Callable[[Manifest], None], found: set[str]) -> None:
    changed = copy.deepcopy(of_kind(render(KEYED), "Deployment")[0])
    change(changed)
    assert set(violations(changed)) == found


def test_images_by_digest_have_no_tag_behind_it() -> None:
    used = {each["image"] for each in containers(render(CASES["by digest"]))}
    assert used == {f"a.example/gateway{DIGEST}", f"a.example/edge{DIGEST}"}


def test_nothing_is_for_one_ingress_controller(manifests: list[Manifest]) -> None:
    assert "nginx" not in str(manifests)


def test_every_pool_has_room_for_evictions_that_grows_with_it(manifests: list[Manifest]) -> None:
    """One worker at a time, each with its grace of a quarter of an hour, would take a fleet of sixty most of a day."""
    workers = {each["metadata"]["name"] for each in of_kind(manifests, "Deployment") if _is_worker(each)}
    budgets = {each["metadata"]["name"]: each["spec"] for each in of_kind(manifests, "PodDisruptionBudget")}
    assert workers <= set(budgets)
    assert all(re.fullmatch(r"\d+%", spec["maxUnavailable"]) for spec in budgets.values())


def _is_worker(deployment: Manifest) -> bool:
    return "capture2vr/worker" in inner(deployment, "spec", "template", "metadata", "labels")


def test_a_new_worker_needs_no_room_beside_the_old_one(manifests: list[Manifest]) -> None:
    for each in of_kind(manifests, "Deployment"):
        if _is_worker(each):
            assert each["spec"]["strategy"]["rollingUpdate"]["maxSurge"] == 0


def test_pools_scale_each_for_itself() -> None:
    manifests = render(values_of("fleet"))
    most = {
        each["metadata"]["name"]: (each["spec"]["minReplicaCount"], each["spec"]["maxReplicaCount"])
        for each in of_kind(manifests, "ScaledObject")
    }
    assert most == {"demo-capture2vr-cpu": (2, 60), "demo-capture2vr-gpu": (1, 8)}
    jobs = [
        each["spec"]["triggers"][0]["metadata"]["targetValue"]
        for each in sorted(of_kind(manifests, "ScaledObject"), key=lambda each: str(each["metadata"]["name"]))
    ]
    assert jobs == ["5", "12"], "the CPUs' slots; what the values say"
    mixed = render(CASES["scaled"])
    assert [each["metadata"]["name"] for each in of_kind(mixed, "ScaledObject")] == ["demo-capture2vr-gpu"]
    (scaler,) = of_kind(mixed, "HorizontalPodAutoscaler")
    assert (scaler["metadata"]["name"], scaler["spec"]["minReplicas"]) == ("demo-capture2vr-cpu", 1)
    for each in of_kind(mixed, "Deployment"):
        assert ("replicas" in each["spec"]) == (not _is_worker(each)), "an upgrade would undo what the scaler did"


def test_threads_of_all_jobs_together_are_the_cpus_of_the_worker() -> None:
    """Of its limit, else of what it is sure of; a job has one at least."""
    cpus: list[tuple[int | float | str, float]] = [(1, 1), ("7", 7), (16, 16), (0.5, 0.5), (2.5, 2.5), ("1500m", 1.5)]
    wanted, pools = {}, {}
    for index, ((cpu, whole), slots, is_limit) in enumerate(product(cpus, (1, 2, 3, 7, 64), (False, True))):
        resources = {"requests": {"cpu": 1}, "limits": {"cpu": cpu}} if is_limit else {"requests": {"cpu": cpu}}
        pools[f"p{index}"] = {"slots": slots, "resources": resources}
        wanted[f"demo-capture2vr-p{index}"] = max(1, int(whole / slots))
    assert wanted.items() <= _threads(pools).items()


def test_threads_that_are_named_are_taken() -> None:
    assert _threads({"cpu": {"slots": 2, "env": {"OMP_NUM_THREADS": "7"}}}) == {"demo-capture2vr-cpu": 7}


def _threads(pools: dict[str, Any]) -> dict[str, int]:
    """OMP_NUM_THREADS of each pool's deployment."""
    found = {}
    for each in of_kind(render({**KEYED, "workers": pools}), "Deployment"):
        if _is_worker(each):
            (container,) = inner(each, "spec", "template", "spec", "containers")
            names = [variable["name"] for variable in container["env"]]
            assert len(names) == len(set(names))
            found[each["metadata"]["name"]] = int(plain_variables(container)["OMP_NUM_THREADS"])
    return found


def test_scratch_that_one_node_has_keeps_the_workers_on_that_node() -> None:
    manifests = render(values_of("gpu"))
    claim = named(manifests, "PersistentVolumeClaim", "demo-capture2vr-gpu-scratch")
    pod = inner(named(manifests, "Deployment", "demo-capture2vr-gpu"), "spec", "template", "spec")
    assert claim["spec"]["accessModes"] == ["ReadWriteOnce"]
    assert {"name": "scratch", "persistentVolumeClaim": {"claimName": claim["metadata"]["name"]}} in pod["volumes"]
    (term,) = pod["affinity"]["podAffinity"]["requiredDuringSchedulingIgnoredDuringExecution"]
    assert term["topologyKey"] == "kubernetes.io/hostname"
    assert "topologySpreadConstraints" not in pod


def test_shared_scratch_is_had_by_choice_alone() -> None:
    for name, values in CASES.items():
        modes = [inner(each, "spec", "accessModes") for each in of_kind(render(values), "PersistentVolumeClaim")]
        assert (["ReadWriteMany"] in modes) == (name == "fleet"), name
    (spread,) = {
        tuple(each["topologyKey"] for each in inner(one, "spec", "template", "spec", "topologySpreadConstraints"))
        for one in of_kind(render(values_of("fleet")), "Deployment")
        if _is_worker(one)
    }
    assert spread == ("topology.kubernetes.io/zone", "kubernetes.io/hostname")


def test_the_database_is_migrated_before_anything_else_changes() -> None:
    job = named(render(CASES["elsewhere"]), "Job", "demo-capture2vr-migration")
    (container,) = inner(job, "spec", "template", "spec", "containers")
    assert job["metadata"]["annotations"]["helm.sh/hook"] == "pre-install,pre-upgrade"
    assert container["args"] == ["gateway", "migrate"]
    assert [each["name"] for each in container["env"]] == ["GATEWAY_DATABASE_URL"]
    assert "activeDeadlineSeconds" not in job["spec"], "a long migration is not cut off"
    assert of_kind(render(KEYED), "Job")[0]["metadata"]["name"] == "demo-capture2vr-bucket", "SQLite's gateway does it"


def test_the_bucket_of_the_charts_own_store_is_not_waited_for_by_that_store() -> None:
    """Nothing of a release is there before the hooks that go before it have ended."""
    job = named(render(values_of("gpu")), "Job", "demo-capture2vr-bucket-1")
    assert "annotations" not in job["metadata"]
    (elsewhere,) = of_kind(render(KEYED), "Job")
    assert elsewhere["metadata"]["annotations"]["helm.sh/hook"] == "pre-install,pre-upgrade"


@pytest.mark.parametrize("way", ["ingress", "gatewayApi"])
def test_what_is_read_by_signed_urls_comes_from_the_store_and_all_else_from_a_gateway(way: str) -> None:
    values = {**values_of("gpu"), "gatewayApi": {}, way: {"enabled": True, "host": "vr.example", "className": "a"}}
    manifests = render(values)
    backends = dict(_ingress_paths(manifests) if way == "ingress" else _route_paths(manifests))
    assert backends.pop("/") == "demo-capture2vr-gateway"
    assert backends == {
        f"/capture2vr/{folder}/": "demo-capture2vr-store" for folder in ("assets", "collections", "tenants")
    }
    for each in containers(manifests):
        if each["name"] in ("gateway", "edge"):
            assert plain_variables(each)["STORAGE_PUBLIC_ENDPOINT"] == values["publicUrl"]
    services = {each["metadata"]["name"] for each in of_kind(manifests, "Service")}
    assert {"demo-capture2vr-gateway", *backends.values()} <= services


def _ingress_paths(manifests: list[Manifest]) -> Iterator[tuple[str, str]]:
    (ingress,) = of_kind(manifests, "Ingress")
    (rule,) = ingress["spec"]["rules"]
    for each in rule["http"]["paths"]:
        yield each["path"], each["backend"]["service"]["name"]


def _route_paths(manifests: list[Manifest]) -> Iterator[tuple[str, str]]:
    route = named(manifests, "HTTPRoute", "demo-capture2vr")
    for rule in route["spec"]["rules"]:
        for match in rule["matches"]:
            yield match["path"]["value"], rule["backendRefs"][0]["name"]


def test_routes_hang_on_a_listener_that_there_is() -> None:
    manifests = render(values_of("gpu"))
    (gateway,) = of_kind(manifests, "Gateway")
    listeners = {each["name"]: each for each in gateway["spec"]["listeners"]}
    assert listeners["https"]["tls"]["certificateRefs"] == [{"name": "vr-example-tls"}]
    for route in of_kind(manifests, "HTTPRoute"):
        (parent,) = route["spec"]["parentRefs"]
        assert (parent["name"], parent["sectionName"] in listeners) == (gateway["metadata"]["name"], True)
        assert {listeners[parent["sectionName"]]["hostname"]} == set(route["spec"]["hostnames"])
    shared = render(values_of("fleet"))
    (route,) = of_kind(shared, "HTTPRoute")
    assert route["spec"]["parentRefs"] == [{"name": "public", "namespace": "gateways", "sectionName": "https"}]
    assert of_kind(shared, "Gateway") == []


def test_all_pods_have_the_service_account_that_is_named(manifests: list[Manifest]) -> None:
    accounts = {inner(each, "spec", "template", "spec").get("serviceAccountName") for each in pods(manifests)}
    assert accounts in ({None}, {"capture2vr"})
    assert {
        inner(each, "spec", "template", "spec")["serviceAccountName"]
        for each in pods(render({**CASES["elsewhere"], "serviceAccount": "role"}))
    } == {"role"}


def test_a_worker_that_drains_is_not_killed_by_its_probe(manifests: list[Manifest]) -> None:
    for each in containers(manifests):
        if each["name"] == "edge":
            ready, alive = (each[probe]["exec"]["command"] for probe in ("readinessProbe", "livenessProbe"))
            assert alive == [*ready, "--alive"]
