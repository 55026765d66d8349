"""Access keys, sessions and pairings over HTTP: who is let in, with which rights, and until when."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway.access import authentication, guesses
from capture2vr.gateway.access.caller import Scope
from tests.support.in_process_gateway import gateway, memory
from tests.support.tenants import bearer, make_key, two_tenants

READ = {"scopes": ["read"]}


async def code_of(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


async def test_without_any_key_this_machine_is_let_in_and_with_the_first_nobody_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(authentication, "CACHE_S", 0.0)
    async with gateway(tmp_path / "gw", memory()) as client:
        assert (await client.get("/v1/session")).json()["via"] == "open"
        assert (await client.get("/v1/jobs")).status_code == 200
        secret = make_key(tmp_path / "gw", "default", {Scope.READ})
        answer = await client.get("/v1/jobs")
        assert await code_of(answer) == (401, "KEY_MISSING")
        assert answer.headers["www-authenticate"].startswith("Bearer")
        assert (await client.get("/v1/jobs", headers=bearer(secret))).status_code == 200


async def test_told_to_be_open_it_is_open_with_keys_too(tmp_path: Path) -> None:
    secret = make_key(tmp_path / "gw", "ada", {Scope.READ})
    async with gateway(tmp_path / "gw", memory(), open=True) as client:
        assert (await client.get("/v1/session")).json()["via"] == "open"
        assert (await client.get("/v1/session", headers=bearer(secret))).json()["tenant"] == "ada"


@pytest.mark.parametrize(
    ("header", "code"),
    [
        ("Bearer nonsense", "KEY_MALFORMED"),
        ("Basic YTpi", "KEY_MALFORMED"),
        ("Bearer c2v_ada_" + "x" * 43, "KEY_UNKNOWN"),
        ("Bearer c2v_Ada_" + "x" * 43, "KEY_MALFORMED"),
        ("", "KEY_MALFORMED"),
    ],
)
async def test_keys_that_are_none(tmp_path: Path, header: str, code: str) -> None:
    make_key(tmp_path / "gw", "ada")
    async with gateway(tmp_path / "gw", memory()) as client:
        answer = await client.get("/v1/jobs", headers={"Authorization": header})
        assert await code_of(answer) == (401, code)
        assert "x" * 43 not in answer.text


async def test_a_key_that_has_expired_or_was_revoked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late = make_key(tmp_path / "gw", "ada", expires=time.time() - 1)
    async with two_tenants(tmp_path, memory()) as site:
        assert await code_of(await site.anonymous.get("/v1/jobs", headers=bearer(late))) == (401, "KEY_EXPIRED")
        own = (await site.ada.get("/v1/session")).json()["key"]
        revoked = await site.ada.post(f"/v1/api-keys/{own}/revoke")
        assert revoked.json()["revoked"] is not None
        assert await code_of(await site.ada.get("/v1/jobs")) == (401, "KEY_REVOKED"), "at once, at this gateway"


async def test_other_gateways_refuse_a_revoked_key_when_their_cache_is_old(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(authentication, "CACHE_S", 0.3)
    database = f"sqlite:///{tmp_path / 'shared.db'}"
    make_key(tmp_path / "gw", "ada")  # makes the folder
    async with (
        gateway(tmp_path / "one", memory(), database_url=database) as one,
        gateway(tmp_path / "two", memory(), database_url=database) as two,
    ):
        from capture2vr.gateway.access.store import AccessStore
        from capture2vr.gateway.database.database import open_engine

        engine = open_engine(database)
        AccessStore(engine).ensure_tenant("ada")
        _, secret = AccessStore(engine).create_key("ada", set(Scope))
        engine.dispose()
        assert (await two.get("/v1/jobs", headers=bearer(secret))).status_code == 200
        own = (await one.get("/v1/session", headers=bearer(secret))).json()["key"]
        assert (await one.post(f"/v1/api-keys/{own}/revoke", headers=bearer(secret))).status_code == 200
        await asyncio.sleep(0.4)
        assert await code_of(await two.get("/v1/jobs", headers=bearer(secret))) == (401, "KEY_REVOKED")


def test_a_revoked_key_is_refused_within_a_minute() -> None:
    assert authentication.CACHE_S < 60


async def test_a_key_in_the_url_is_refused_and_not_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    secret = make_key(tmp_path / "gw", "ada")
    async with gateway(tmp_path / "gw", memory()) as client:
        caplog.set_level("INFO")
        for path in (f"/v1/jobs?key={secret}", f"/v1/assets/{secret}", f"/v1/jobs?k={secret.replace('_', '%5F')}"):
            answer = await client.get(path)
            assert await code_of(answer) == (400, "KEY_IN_URL")
            assert secret not in answer.text
    logged = [record for record in caplog.records if record.name.startswith("capture2vr.")]
    assert logged
    assert not [record for record in logged if secret in record.getMessage() or secret in str(record.__dict__)]


async def test_a_scope_that_is_missing_is_named(tmp_path: Path) -> None:
    secret = make_key(tmp_path / "gw", "ada", {Scope.READ})
    async with gateway(tmp_path / "gw", memory()) as client:
        answer = await client.post("/v1/captures", headers=bearer(secret), files={"files": ("a.ply", b"x")})
        assert await code_of(answer) == (403, "SCOPE_MISSING")
        assert "capture" in answer.json()["detail"]


class TestKeys:
    async def test_made_listed_and_rotated(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            made = (await site.ada.post("/v1/api-keys", json={**READ, "label": "phone", "expires_days": 2})).json()
            assert (made["tenant"], made["label"], made["scopes"]) == ("ada", "phone", ["read"])
            assert (await site.anonymous.get("/v1/jobs", headers=bearer(made["secret"]))).status_code == 200
            listed = (await site.ada.get("/v1/api-keys")).json()["keys"]
            assert made["id"] in {key["id"] for key in listed}
            assert {key["tenant"] for key in listed} == {"ada"}
            assert not [key for key in listed if "secret" in key or "sha256" in key]
            new = (await site.ada.post(f"/v1/api-keys/{made['id']}/rotate", json={"grace_days": 0})).json()
            assert (new["scopes"], new["expires"]) == (["read"], made["expires"])
            assert (await site.anonymous.get("/v1/jobs", headers=bearer(new["secret"]))).status_code == 200
            refused = await site.anonymous.get("/v1/jobs", headers=bearer(made["secret"]))
            assert await code_of(refused) == (401, "KEY_EXPIRED")

    async def test_of_a_tenant_are_not_anothers(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            ada = (await site.ada.get("/v1/session")).json()["key"]
            for path in (f"/v1/api-keys/{ada}/revoke", f"/v1/api-keys/{ada}/rotate"):
                assert await code_of(await site.bob.post(path, json={})) == (404, "KEY_ID_UNKNOWN")
            for foreign in ("ada", "*"):
                answer = await site.bob.get("/v1/api-keys", params={"tenant": foreign})
                assert await code_of(answer) == (403, "SCOPE_MISSING")
            answer = await site.bob.post("/v1/api-keys", json={**READ, "tenant": "ada"})
            assert await code_of(answer) == (403, "SCOPE_MISSING")
            assert (await site.ada.get("/v1/jobs")).status_code == 200

    async def test_of_all_are_an_operators(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            found = (await site.operator.get("/v1/api-keys", params={"tenant": "*"})).json()["keys"]
            assert {key["tenant"] for key in found} == {"ada", "bob", "default"}
            assert (await site.operator.post("/v1/tenants", json={"name": "eve", "label": "Eve"})).status_code == 201
            again = await site.operator.post("/v1/tenants", json={"name": "eve"})
            assert await code_of(again) == (409, "TENANT_EXISTS")
            made = await site.operator.post("/v1/api-keys", json={"scopes": ["capture"], "tenant": "eve"})
            session = await site.anonymous.get("/v1/session", headers=bearer(made.json()["secret"]))
            assert session.json()["tenant"] == "eve"
            unknown = await site.operator.post("/v1/api-keys", json={**READ, "tenant": "mallory"})
            assert await code_of(unknown) == (404, "TENANT_UNKNOWN")
            names = [each["name"] for each in (await site.operator.get("/v1/tenants")).json()["tenants"]]
            assert names == ["ada", "bob", "default", "eve"]
            assert await code_of(await site.ada.get("/v1/tenants")) == (403, "SCOPE_MISSING")

    @pytest.mark.slow
    async def test_allow_no_more_than_their_maker_may(self, tmp_path: Path) -> None:
        soon = time.time() + 3_600
        secret = make_key(tmp_path / "gw", "ada", {Scope.MANAGE, Scope.READ}, expires=soon)
        async with gateway(tmp_path / "gw", memory()) as client:
            client.headers.update(bearer(secret))
            refused = await client.post("/v1/api-keys", json={"scopes": ["read", "capture"]})
            assert await code_of(refused) == (403, "SCOPE_MISSING")
            assert "capture" in refused.json()["detail"]
            for days in (None, 9):
                made = (await client.post("/v1/api-keys", json={**READ, "expires_days": days})).json()
                assert made["expires"].startswith(time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(soon)))

    async def test_are_not_made_while_everybody_is_let_in(self, tmp_path: Path) -> None:
        async with gateway(tmp_path / "gw", memory()) as client:
            for path in ("/v1/api-keys", "/v1/pairings"):
                assert await code_of(await client.post(path, json=READ)) == (409, "GATEWAY_OPEN")
            assert (await client.get("/v1/session")).json()["via"] == "open"


class TestSessions:
    async def test_a_browser_logs_in_and_out(self, tmp_path: Path) -> None:
        secret = make_key(tmp_path / "gw", "ada", {Scope.READ})
        async with gateway(tmp_path / "gw", memory()) as client:
            answer = await client.post("/v1/session", json={"key": secret})
            cookie = answer.headers["set-cookie"]
            assert "HttpOnly" in cookie
            assert "SameSite=lax" in cookie
            assert "Secure" not in cookie, "without TLS a browser would not send it"
            assert secret not in cookie
            assert (await client.get("/v1/session")).json()["via"] == "session"
            assert (await client.get("/v1/jobs")).status_code == 200
            assert await code_of(await client.post("/v1/captures", content=b"x")) == (403, "SCOPE_MISSING")
            await client.delete("/v1/session")
            assert await code_of(await client.get("/v1/jobs")) == (401, "KEY_MISSING")

    async def test_behind_tls_the_cookie_is_for_tls_only(self, tmp_path: Path) -> None:
        secret = make_key(tmp_path / "gw", "ada")
        async with gateway(tmp_path / "gw", memory(), public_url="https://vr.example") as client:
            answer = await client.post("/v1/session", json={"key": secret})
            assert "Secure" in answer.headers["set-cookie"]

    async def test_an_altered_cookie_is_refused(self, tmp_path: Path) -> None:
        secret = make_key(tmp_path / "gw", "ada")
        async with gateway(tmp_path / "gw", memory()) as client:
            good = (await client.post("/v1/session", json={"key": secret})).cookies["c2v_session"]
            client.cookies.clear()
            told, _, signature = good.rpartition(".")
            # The first letter: two bits of the last one are no part of the signature.
            altered = f"{told}.{'a' if signature[0] != 'a' else 'b'}{signature[1:]}"
            for bad in (altered, "x" + good, "nonsense", good.split(".")[0]):
                answer = await client.get("/v1/jobs", headers={"Cookie": f"c2v_session={bad}"})
                assert await code_of(answer) == (401, "SESSION_INVALID")
            assert (await client.get("/livez")).status_code == 200

    async def test_a_cookie_of_another_gateway_is_refused(self, tmp_path: Path) -> None:
        cookies = []
        for name in ("one", "two"):
            secret = make_key(tmp_path / name, "ada")
            async with gateway(tmp_path / name, memory()) as client:
                cookies.append((await client.post("/v1/session", json={"key": secret})).cookies["c2v_session"])
                client.cookies.clear()
                answer = await client.get("/v1/jobs", headers={"Cookie": f"c2v_session={cookies[0]}"})
                assert answer.status_code == (200 if name == "one" else 401)

    async def test_a_session_ends_with_its_key(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            made = (await site.ada.post("/v1/api-keys", json=READ)).json()
            await site.anonymous.post("/v1/session", json={"key": made["secret"]})
            assert (await site.anonymous.get("/v1/jobs")).status_code == 200
            await site.ada.post(f"/v1/api-keys/{made['id']}/revoke")
            assert await code_of(await site.anonymous.get("/v1/jobs")) == (401, "SESSION_ENDED")

    async def test_another_sites_page_cannot_log_anybody_in(self, tmp_path: Path) -> None:
        secret = make_key(tmp_path / "gw", "mallory")
        async with gateway(tmp_path / "gw", memory()) as client:
            answer = await client.post("/v1/session", json={"key": secret}, headers={"Origin": "https://evil.example"})
            assert await code_of(answer) == (403, "CROSS_SITE")


class TestPairing:
    @pytest.mark.parametrize("by", ["token", "code"])
    async def test_a_device_is_logged_in_once(self, tmp_path: Path, by: str) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            body = {"scopes": ["capture", "read"], "label": "Ada's headset"}
            pairing = (await site.ada.post("/v1/pairings", json=body)).json()
            assert pairing["qr"].startswith("<?xml")
            address, token = pairing["url"].split("#")
            assert address == f"{site.url}/pair"
            assert len(pairing["code"]) == 10
            shown = {"token": token} if by == "token" else {"code": pairing["code"]}
            claimed = await site.anonymous.post("/v1/pairings/claim", json=shown)
            assert claimed.json()["tenant"] == "ada"
            assert (await site.anonymous.get("/v1/session")).json()["scopes"] == ["capture", "read"]
            assert (await site.ada.get(f"/v1/pairings/{pairing['id']}")).json()["claimed"]
            again = await site.anonymous.post("/v1/pairings/claim", json=shown)
            assert await code_of(again) == (404, "PAIRING_UNKNOWN")
            keys = (await site.ada.get("/v1/api-keys")).json()["keys"]
            (device,) = [each for each in keys if each["label"] == body["label"]]
            await site.ada.post(f"/v1/api-keys/{device['id']}/revoke")
            assert (await site.anonymous.get("/v1/jobs")).status_code == 401

    async def test_gives_no_more_than_its_maker_has(self, tmp_path: Path) -> None:
        secret = make_key(tmp_path / "gw", "ada", {Scope.READ})
        async with gateway(tmp_path / "gw", memory()) as client:
            answer = await client.post("/v1/pairings", json={"scopes": ["manage"]}, headers=bearer(secret))
            assert await code_of(answer) == (403, "SCOPE_MISSING")
            assert (await client.post("/v1/pairings", json=READ, headers=bearer(secret))).status_code == 201

    async def test_of_another_tenant_is_unknown(self, tmp_path: Path) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            pairing = (await site.ada.post("/v1/pairings", json=READ)).json()
            answer = await site.bob.get(f"/v1/pairings/{pairing['id']}")
            assert await code_of(answer) == (404, "PAIRING_UNKNOWN")

    @pytest.mark.usefixtures("still_limits")
    async def test_codes_cannot_be_guessed_at_will(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(guesses, "_OF_NETWORK", guesses.RateLimitItemPerMinute(3))
        async with two_tenants(tmp_path, memory()) as site:
            pairing = (await site.ada.post("/v1/pairings", json=READ)).json()
            wrong = f"{(int(pairing['code']) + 1) % 10**10:010}"
            for _ in range(3):
                answer = await site.anonymous.post("/v1/pairings/claim", json={"code": wrong})
                assert await code_of(answer) == (404, "PAIRING_UNKNOWN")
            answer = await site.anonymous.post("/v1/pairings/claim", json={"code": pairing["code"]})
            assert await code_of(answer) == (429, "CODE_GUESSES_LIMITED")
            assert answer.headers["retry-after"] == "60"
            token = pairing["url"].split("#")[1]
            assert (await site.anonymous.post("/v1/pairings/claim", json={"token": token})).status_code == 200

    @pytest.mark.parametrize(
        "shown", [{}, {"token": "a", "code": "1234567890"}, {"code": "123456789"}, {"code": "abcdefghij"}]
    )
    async def test_one_of_both_is_shown(self, tmp_path: Path, shown: dict[str, str]) -> None:
        async with two_tenants(tmp_path, memory()) as site:
            answer = await site.anonymous.post("/v1/pairings/claim", json=shown)
            assert await code_of(answer) == (422, "REQUEST_INVALID")


async def test_the_last_use_of_a_key_is_stored(tmp_path: Path) -> None:
    secret = make_key(tmp_path / "gw", "ada")
    began = time.time()
    async with gateway(tmp_path / "gw", memory()) as client:
        await client.get("/v1/jobs", headers=bearer(secret))
    from capture2vr.gateway.access.store import AccessStore
    from capture2vr.gateway.database.database import open_engine

    engine = open_engine(f"sqlite:///{tmp_path / 'gw' / 'gateway.db'}")
    (key,) = AccessStore(engine).list_keys("ada", limit=2)
    engine.dispose()
    assert key.last_used is not None
    assert key.last_used >= began


async def test_readiness_tells_details_to_operators_only(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory(), 9) as site:
        assert (await site.anonymous.get("/readyz")).json() == {"ready": False, "checks": {}}
        assert set((await site.operator.get("/readyz")).json()["checks"]) == {"store", "database", "disk", "workers"}
