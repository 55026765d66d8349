"""Two tenants on one gateway: on every route another tenant's ids are answered as ids that do not exist.

The routes come from the OpenAPI document, so a new one is walked too; one whose parameters or body this file does not
know fails the test until they are added.
"""

from __future__ import annotations

import asyncio
import json
import string
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from capture2vr.gateway.jobs.capture_objects import receipt_name
from capture2vr.gateway.page_texts import sentences_address
from capture2vr.gateway.routes.captures import CaptureView
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.in_process_gateway import capture, memory
from tests.support.tenants import TwoTenants, publish_for, two_tenants

KEYS = st.text(string.ascii_letters + string.digits + "._-", min_size=4, max_size=30).map(lambda text: f"a{text}")
_PARAMETERS = {
    "/v1/captures": {"capture": "capture", "picture": "level", "film": "level"},
    "/v1/uploads": {"upload": "upload"},
    "/v1/jobs": {"job": "job"},
    "/v1/assets": {"key": "asset", "level": "level", "version": "version", "note": "note"},
    "/v1/collections": {"name": "collection", "key": "asset"},
    "/v1/files": {"name": "file"},
    "/v1/api-keys": {"key": "api_key"},
    "/v1/pairings": {"pairing": "pairing"},
    "/v1/tenants": {"name": "tenant"},
    "/v1/readable": {"folder": "folder"},
    "/v1/shares": {"share": "share"},
    "/v1/scenes": {"scene": "scene"},
    "/scene": {"scene": "scene"},
    "/s": {"token": "share_token"},
    "/v1/webhooks": {"webhook": "webhook", "message": "message"},
    "/view": {"key": "asset"},
    "/edit": {"key": "asset"},
    "/browse": {"name": "collection"},
    "/wardrobe": {"name": "collection"},
    "/web/sentences": {"name": "sentences"},
}
"""Which of a tenant's ids a path parameter takes, by the beginning of the path."""
_BODIES: Mapping[str, Any] = {
    "post /v1/captures": None,  # an upload's body, which names nothing
    "post /v1/outlines": None,
    "post /v1/uploads": None,
    "post /v1/uploads/{upload}/capture": None,
    "post /v1/jobs": {"capture": "{capture}", "asset_key": "mine"},
    "post /v1/jobs/{job}/again": {"capture": "{capture}", "cut": "scene"},
    "post /v1/jobs/{job}/cancel": None,
    "post /v1/assets/{key}/remove": None,
    "post /v1/assets/{key}/restore": None,
    "post /v1/assets/{key}/versions/{version}/restore": None,
    "patch /v1/assets/{key}": {"label": "Mine"},
    "post /v1/assets/{key}/notes": {"text": "Mine", "at": [0, 0, 0]},
    "patch /v1/assets/{key}/notes/{note}": {"text": "Mine"},
    "patch /v1/uploads/{upload}": None,
    "put /v1/assets/{key}/visibility": {"visibility": "public"},
    "put /v1/collections/{name}/visibility": {"visibility": "public"},
    "post /v1/shares": {"asset": "{asset}"},
    "post /v1/scenes": {"name": "Mine"},
    "put /v1/scenes/{scene}": {"name": "Mine"},
    "post /v1/scenes/{scene}/moving": {
        "sender": "mine",
        "items": [{"id": "a", "position_m": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": 1}],
    },
    "post /v1/shares/open": {"token": "no token"},
    "post /v1/session": {"key": "c2v_bob_" + "x" * 43},
    "post /v1/pairings": {"scopes": ["read"]},
    "post /v1/pairings/claim": {"code": "000000"},
    "post /v1/api-keys": {"scopes": ["read"]},
    "post /v1/api-keys/{key}/revoke": None,
    "post /v1/api-keys/{key}/rotate": {"grace_days": 0},
    "post /v1/tenants": {"name": "eve"},
    "put /v1/tenants/{name}/limits": {"jobs_at_once": 0},
    "post /v1/deletions": {"tenant": "ada"},
    "put /v1/retention": {"captures_days": 1_000},
    "post /v1/webhooks": {"url": "http://127.0.0.1:9/bob"},
    "put /v1/webhooks/{webhook}/state": {"disabled": True},
    "post /v1/webhooks/{webhook}/rotate": None,
    "post /v1/webhooks/{webhook}/test": None,
    "post /v1/webhooks/{webhook}/messages/{message}/redeliver": None,
}
"""Bodies of what has one; "{capture}" is a tenant's capture, "{asset}" its asset."""
_HEADERS: Mapping[str, Mapping[str, str]] = {
    "/v1/scenes": {"If-Match": '"1"'},
    "/v1/uploads": {"Tus-Resumable": "1.0.0", "Upload-Length": "3", "Upload-Offset": "0"},
}
"""Headers without which a request says nothing, by the beginning of the path."""
_WITHOUT_KEY = {  # what anyone may ask
    "get /", "get /admin", "get /login", "get /pair", "get /view", "get /view/{key}", "get /edit/{key}",
    "get /scene/{scene}", "get /browse/{name}", "get /wardrobe/{name}", "get /web/shell.json",
    "get /web/sentences/{name}", "get /v1/schemas/edits",
    "get /livez", "get /readyz", "get /v1/keys", "get /v1/session", "post /v1/session", "delete /v1/session",
    "post /v1/pairings/claim", "get /s/{token}", "post /v1/shares/open",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Ids:
    """A tenant's things, by what they are."""

    capture: str
    job: str
    asset: str
    collection: str
    file: str
    api_key: str
    pairing: str
    webhook: str
    message: str
    upload: str
    share: str
    share_token: str
    folder: str
    scene: str
    note: str
    tenant: str = "ada"
    level: str = "0"
    version: str = "1"
    sentences: str = sentences_address("de").rpartition("/")[2]

    def of(self, template: str) -> dict[str, str]:
        """The values of a path's parameters."""
        begin = max((each for each in _PARAMETERS if template.startswith(each)), key=len, default="")
        names = [part.strip("{}").partition(":")[0] for part in template.split("/") if part.startswith("{")]
        return {name: getattr(self, _PARAMETERS[begin][name]) for name in names}


@dataclass(frozen=True, slots=True)
class Operation:
    """A method of a path, as the OpenAPI document has it."""

    method: str
    template: str

    @property
    def name(self) -> str:
        return f"{self.method} {self.template}"

    async def ask(self, client: httpx.AsyncClient, ids: Ids) -> httpx.Response:
        """Send the request with these ids."""
        path = self.template.format(**ids.of(self.template))
        body = None
        if self.method in ("post", "put", "patch"):
            body = _BODIES[self.name]
            if isinstance(body, dict):
                named = {"{capture}": ids.capture, "{asset}": ids.asset}
                body = {name: named.get(str(value), value) for name, value in body.items()}
        query = {"/view": {"key": ids.asset}, "/v1/assets/{key}/download": {"format": "glb"}}.get(self.template, {})
        headers = next((each for begin, each in _HEADERS.items() if path.startswith(begin)), {})
        return await client.request(self.method, path, json=body, params=query, headers=headers)


def operations(document: dict[str, Any]) -> Iterator[Operation]:
    """All operations, those that delete last: what is part of a thing before the thing."""
    found = [Operation(method, path) for path, methods in document["paths"].items() for method in methods]
    changes = [each for each in found if each.method != "delete"]
    deletions = [each for each in found if each.method == "delete"]
    yield from sorted(changes, key=lambda each: each.name)
    yield from sorted(deletions, key=lambda each: (-each.template.count("/"), each.name))


async def ids_of(site: TwoTenants, client: httpx.AsyncClient, tenant: str, store: Store, key: str) -> Ids:
    """Make one of everything for a tenant."""
    own = store_of_tenant(store, tenant)
    name = capture(own, f"cap_{tenant}{key.replace('.', '-')}")
    example = CaptureView.model_config["json_schema_extra"]["example"]
    receipt = json.dumps({**example, "capture": name}).encode()
    own.put(receipt_name(name), receipt, content_type="application/json")
    publish_for(store, tenant, key, collection=f"shelf-{tenant}-{key}")
    job = (await client.post("/v1/jobs", json={"capture": name, "asset_key": f"new-{key}"})).json()["id"]
    api_key = (await client.post("/v1/api-keys", json={"scopes": ["read"]})).json()["id"]
    pairing = (await client.post("/v1/pairings", json={"scopes": ["read"]})).json()["id"]
    entry = (await client.get(f"/v1/assets/{key}")).json()
    file = f"tenants/{tenant}/{entry['manifest']['name']}"
    hook = (await client.post("/v1/webhooks", json={"url": "http://127.0.0.1:9/"})).json()["id"]
    message = (await client.post(f"/v1/webhooks/{hook}/test")).json()["id"]
    created = await client.post("/v1/uploads", headers=_HEADERS["/v1/uploads"])
    upload = created.headers["Location"].rpartition("/")[2]
    share = (await client.post("/v1/shares", json={"asset": key})).json()
    scene = (await client.post("/v1/scenes", json={"name": "Room"})).json()["id"]
    note = (await client.post(f"/v1/assets/{key}/notes", json={"text": "Its own", "at": [0, 0, 0]})).json()["id"]
    links = (share["id"], share["url"].rpartition("/")[2], f"tenants/{tenant}/assets/{key}", scene, note)
    return Ids(name, job, key, f"shelf-{tenant}-{key}", file, api_key, pairing, hook, message, upload, *links)


def nothing() -> Ids:
    """Ids of the same form, of which there is nothing."""
    return Ids(
        capture="cap_nothing",
        job="job_" + "0" * 32,
        asset="anothing",
        collection="shelf-nothing",
        file="tenants/nobody/assets/a/manifest.json",
        api_key="key_" + "0" * 28,
        pairing="pair_" + "0" * 16,
        webhook="hook_" + "0" * 16,
        message="msg_" + "0" * 40,
        upload="upl_" + "0" * 32,
        share="shr_" + "0" * 24,
        share_token="shr_" + "0" * 24 + "." + "0" * 43,
        folder="tenants/nobody/assets/a",
        scene="scn_" + "0" * 24,
        note="note_" + "0" * 16,
        tenant="nobody",
    )


def masked(answer: httpx.Response, ids: Ids) -> tuple[int, str]:
    """Status and text of an answer, without the ids that were asked for and what changes with every request."""
    text = answer.text
    public = {"tenant", "level", "version", "sentences"}
    values = [getattr(ids, field.name) for field in fields(ids) if field.name not in public]
    for value in sorted(values, key=len, reverse=True):
        text = text.replace(value, "…")
    return answer.status_code, text


@pytest.mark.slow
@settings(max_examples=4, phases=[Phase.generate])  # a smaller key explains no more, and costs minutes
@given(key=KEYS)
def test_another_tenants_ids_are_as_ids_that_do_not_exist(key: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    asyncio.run(_walk(key, tmp_path_factory.mktemp("site")))


async def _walk(key: str, folder: Path) -> None:
    store = LocalStore(folder / "store")
    async with two_tenants(folder, store, webhook_private=True) as site:
        document = (await site.operator.get("/openapi.json")).json()
        ada = await ids_of(site, site.ada, "ada", store, key)
        before = await everything_of(site.ada, ada)
        for operation in operations(document):
            if operation.template.endswith("/events"):
                continue  # follows a job to its end, or a scene without one: `test_events_of_another_tenant`
            has_ids = "{" in operation.template or _names_a_thing(_BODIES.get(operation.name))
            foreign = await operation.ask(site.bob, ada)
            if has_ids and operation.name not in _WITHOUT_KEY:
                scopes = document["paths"][operation.template][operation.method]["x-scopes"]
                refused = 401 if operation.template.startswith("/v1/readable") else 404  # nginx passes on no other
                assert foreign.status_code == (403 if scopes == ["operate"] else refused), operation.name
                unknown = await operation.ask(site.bob, nothing())
                assert masked(foreign, ada) == masked(unknown, nothing()), operation.name
            elif not has_ids:
                for mine in (ada.capture, ada.job, ada.api_key, ada.pairing, ada.collection):
                    assert mine not in foreign.text, operation.name
        assert await everything_of(site.ada, ada) == before, "nothing of ada's has changed"
        for operation in operations(document):
            if "{" in operation.template and not operation.template.endswith("/events"):
                own = await operation.ask(site.ada, ada)
                assert own.status_code != 404, f"{operation.name}: the walk has asked for nothing that exists"


def _names_a_thing(body: Any) -> bool:
    return isinstance(body, dict) and any(value in ("{capture}", "{asset}") for value in body.values())


async def everything_of(client: httpx.AsyncClient, ids: Ids) -> list[str]:
    """What a tenant reads of its things, but for the clock."""
    answers = [
        await client.get(path)
        for path in (f"/v1/assets/{ids.asset}", f"/v1/assets/{ids.asset}/notes", f"/v1/captures/{ids.capture}/archive")
    ]
    job = (await client.get(f"/v1/jobs/{ids.job}")).json()
    keys = [(each["id"], each["revoked"]) for each in (await client.get("/v1/api-keys")).json()["keys"]]
    pairing = (await client.get(f"/v1/pairings/{ids.pairing}")).json()
    upload = await client.head(f"/v1/uploads/{ids.upload}", headers=_HEADERS["/v1/uploads"])
    offset = upload.headers["Upload-Offset"]
    return [answer.text for answer in answers] + [job["state"], str(keys), str(pairing), offset]


@pytest.mark.slow
@pytest.mark.essential
async def test_without_a_key_nothing_is_answered(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        document = (await site.operator.get("/openapi.json")).json()
        for operation in operations(document):
            answer = await operation.ask(site.anonymous, nothing())
            if operation.name in _WITHOUT_KEY:
                assert answer.status_code != 401 or operation.name == "post /v1/session", operation.name
            else:
                code = answer.json()["code"] if answer.content else "KEY_MISSING"  # HEAD has no body
                assert (answer.status_code, code) == (401, "KEY_MISSING"), operation.name
                assert "security" in document["paths"][operation.template][operation.method], operation.name
        for path in ("/openapi.json", "/metrics"):
            assert (await site.ada.get(path)).status_code == 403


async def test_events_of_another_tenant(tmp_path: Path) -> None:
    store = memory()
    async with two_tenants(tmp_path, store, webhook_private=True) as site:
        ids = await ids_of(site, site.ada, "ada", store, "dress")
        answer = await site.bob.get(f"/v1/jobs/{ids.job}/events")
        assert (answer.status_code, answer.json()["code"]) == (404, "JOB_UNKNOWN")
        for scene in (ids.scene, nothing().scene):
            answer = await site.bob.get(f"/v1/scenes/{scene}/events")
            assert (answer.status_code, answer.json()["code"]) == (404, "SCENE_UNKNOWN")
        answer = await site.bob.get(f"/v1/scenes/{ids.scene}/events", params={"tenant": "ada"})
        assert (answer.status_code, answer.json()["code"]) == (404, "SCENE_UNKNOWN")


async def test_each_has_its_own_keys_collections_and_idempotency_keys(tmp_path: Path) -> None:
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        jobs = []
        for tenant, client in (("ada", site.ada), ("bob", site.bob)):
            capture(store_of_tenant(store, tenant), "cap_same")
            publish_for(store, tenant, "dress")
            order = {"capture": "cap_same", "asset_key": "dress"}
            jobs.append((await client.post("/v1/jobs", json=order, headers={"Idempotency-Key": "one"})).json()["id"])
            again = (await client.post("/v1/jobs", json=order, headers={"Idempotency-Key": "one"})).json()["id"]
            assert again == jobs[-1]
        assert jobs[0] != jobs[1]
        await site.ada.post("/v1/assets/dress/remove")
        assert (await site.ada.get("/v1/assets/dress")).status_code == 410
        assert (await site.bob.get("/v1/assets/dress")).status_code == 200
        rows = [
            (await client.get("/v1/collections/default/assets")).json()["assets"] for client in (site.ada, site.bob)
        ]
        assert [[row["key"] for row in each] for each in rows] == [[], ["dress"]]
