"""TLS and the shared token: who may call a worker, and what of the settings is refused before it serves."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import grpc
import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from grpc_health.v1 import health_pb2, health_pb2_grpc
from pydantic import SecretStr

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.jobs.central_client import Central, CentralUnavailable
from capture2vr.edge.worker.health import is_serving
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.server import EdgeServer, serve
from capture2vr.edge.worker.settings import EdgeSettings, central_credentials, server_security
from capture2vr.process.grpc_security import NO_CREDENTIALS, ClientCredentials, certificate_host
from capture2vr.process.strict_settings import SettingsError
from tests.edge.jobs.test_forward_job import QUICK, Standing
from tests.support.network.tls_certificates import DAY, TOKEN, Authority, key_pem
from tests.support.patience import PATIENCE_S
from tests.support.workers.edge_client import Client, Scripted, header_of


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


def settings_of(authority: Authority, tmp_path: Path, **changed: object) -> EdgeSettings:
    pair = authority.server()
    given = {"tls_cert": pair.cert, "tls_key": pair.key, "token": SecretStr(TOKEN), **changed}
    return EdgeSettings(port=0, scratch=tmp_path / "scratch", **given)


@asynccontextmanager
async def guarded(settings: EdgeSettings, work: Scripted | None = None) -> AsyncIterator[str]:
    """A listening worker; its address."""
    hurry = asyncio.Event()
    hurry.set()
    place = Scratch(settings.scratch)
    with place.claim():
        server = EdgeServer(settings, work or Scripted(), place)
        port = await server.start()
        try:
            yield f"127.0.0.1:{port}"
        finally:
            await server.drain(hurry)


async def status_of(address: str, caller: ClientCredentials, call: Callable[[Client], Any]) -> grpc.StatusCode:
    async with caller.aio_channel(address, ()) as channel:
        answer = call(Client(channel))
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await (anext(aiter(answer)) if hasattr(answer, "__aiter__") else answer)
    code: grpc.StatusCode = refused.value.code()
    return code


CALLS: dict[str, Callable[[Client], Any]] = {
    "Reconstruct": lambda client: client.stub.Reconstruct(iter([pb.Chunk(header=header_of(b"ticks 1"))])),
    "Inspect": lambda client: client.stub.Inspect(iter([pb.Chunk(header=header_of(b"x"))])),
    "Attach": lambda client: client.attach(),
    "Cancel": lambda client: client.stub.Cancel(pb.CancelRequest(job="job_1")),
    "GetWorker": lambda client: client.stub.GetWorker(pb.GetWorkerRequest(), timeout=PATIENCE_S),
}


async def test_who_shows_the_token_is_served(authority: Authority, tmp_path: Path) -> None:
    caller = ClientCredentials(authority.ca.read_bytes(), TOKEN)
    async with guarded(settings_of(authority, tmp_path)) as address, caller.aio_channel(address, ()) as channel:
        client = Client(channel)
        assert (await client.worker()).slots == 1
        assert (await client.ended(b"ticks 2"))[-1].HasField("finished")


@pytest.mark.parametrize("call", CALLS)
async def test_no_call_goes_without_the_token(authority: Authority, tmp_path: Path, call: str) -> None:
    ca = authority.ca.read_bytes()
    async with guarded(settings_of(authority, tmp_path)) as address:
        for token in ("", TOKEN[:-1], TOKEN + "x", "x" * len(TOKEN)):
            assert (
                await status_of(address, ClientCredentials(ca, token), CALLS[call]) == grpc.StatusCode.UNAUTHENTICATED
            )


async def test_what_is_missing_is_told(authority: Authority, tmp_path: Path) -> None:
    ca = authority.ca.read_bytes()
    async with guarded(settings_of(authority, tmp_path)) as address:
        for token, word in (("", "TOKEN_MISSING"), (TOKEN + "x", "TOKEN_WRONG")):
            async with ClientCredentials(ca, token).aio_channel(address, ()) as channel:
                with pytest.raises(grpc.aio.AioRpcError, match=word) as refused:
                    await Client(channel).worker()
                assert TOKEN not in str(refused.value)


async def test_health_asks_for_no_token(authority: Authority, tmp_path: Path) -> None:
    settings = settings_of(authority, tmp_path)
    async with guarded(settings) as address:
        async with ClientCredentials(authority.ca.read_bytes()).aio_channel(address, ()) as channel:
            answer = await health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest())
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
        assert await asyncio.to_thread(is_serving, address, server_security(settings))


async def test_health_knows_a_certificate_for_another_name(authority: Authority, tmp_path: Path) -> None:
    """Inside the container the worker is asked on loopback, which its certificate is not for."""
    pair = authority.server("elsewhere", host="edge.example")
    settings = settings_of(authority, tmp_path, tls_cert=pair.cert, tls_key=pair.key)
    assert certificate_host(pair.cert.read_bytes()) == "edge.example"
    async with guarded(settings) as address:
        assert await asyncio.to_thread(is_serving, address, server_security(settings))
        assert not await asyncio.to_thread(is_serving, address)


@pytest.mark.parametrize("who", ["nobody", "a stranger", "another name"])
async def test_a_worker_that_nobody_vouches_for_is_not_spoken_to(
    authority: Authority, tmp_path: Path, who: str
) -> None:
    """Plain gRPC to a TLS port; a certificate of another authority; one for another host: none gets the token."""
    elsewhere = authority.server("elsewhere", host="elsewhere.example")
    changed = {"tls_cert": elsewhere.cert, "tls_key": elsewhere.key} if who == "another name" else {}
    stranger = Authority(tmp_path, "stranger").ca if who == "a stranger" else authority.ca
    caller = NO_CREDENTIALS if who == "nobody" else ClientCredentials(stranger.read_bytes(), TOKEN)
    async with guarded(settings_of(authority, tmp_path, **changed)) as address:
        assert await status_of(address, caller, CALLS["GetWorker"]) in {
            grpc.StatusCode.UNAVAILABLE,
            grpc.StatusCode.DEADLINE_EXCEEDED,
        }


@pytest.mark.slow
async def test_central_is_called_with_its_token(authority: Authority, tmp_path: Path) -> None:
    ca = authority.ca.read_bytes()
    async with guarded(settings_of(authority, tmp_path), Standing()) as address:
        for caller, said, answer_s in (
            (ClientCredentials(ca, TOKEN), "", PATIENCE_S),
            (ClientCredentials(ca, TOKEN + "x"), "refuses", PATIENCE_S),
            (NO_CREDENTIALS, "not be reached", 0.2),
        ):
            central = Central(address, replace(QUICK, answer_s=answer_s), caller)
            try:
                if said:
                    with pytest.raises(CentralUnavailable, match=said):
                        await asyncio.to_thread(central.require, "quick")
                else:
                    await asyncio.to_thread(central.require, "quick")
            finally:
                central.close()


WRONG = {
    "a certificate without its key": ({"tls_key": None}, "EDGE_TLS_CERT and EDGE_TLS_KEY go together"),
    "a key without its certificate": ({"tls_cert": None, "token": SecretStr("")}, "go together"),
    "no such file": ({"tls_cert": Path("/nowhere.crt")}, "EDGE_TLS_CERT: /nowhere.crt cannot be read"),
    "a folder": ({"tls_key": Path("/")}, "EDGE_TLS_KEY: / cannot be read"),
    "a token without TLS": ({"tls_cert": None, "tls_key": None}, "EDGE_TOKEN needs EDGE_TLS_CERT"),
    "a short token": ({"token": SecretStr("short")}, "EDGE_TOKEN: use at least 16"),
    "a token with a blank": ({"token": SecretStr("a token with some blanks")}, "EDGE_TOKEN: use"),
    "a token of two lines": ({"token": SecretStr("a-token-of-two\nlines-of-it")}, "EDGE_TOKEN: use"),
    "a token in other letters": ({"token": SecretStr("ä" * 20)}, "EDGE_TOKEN: use"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_settings_are_named(authority: Authority, tmp_path: Path, what: str) -> None:
    changed, said = WRONG[what]
    settings = settings_of(authority, tmp_path, **changed)
    with pytest.raises(SettingsError, match=said) as refused:
        server_security(settings)
    token = settings.token.get_secret_value()
    assert not token or token not in str(refused.value)
    assert serve(settings, Scripted()) == 1, "a worker with them does not start"


def test_a_certificate_and_the_key_of_another(authority: Authority, tmp_path: Path) -> None:
    other = authority.server("other")
    garbage, locked = tmp_path / "garbage", tmp_path / "locked.key"
    garbage.write_bytes(b"no PEM")
    locked.write_bytes(key_pem(ec.generate_private_key(ec.SECP256R1()), b"password"))
    for changed in ({"tls_key": other.key}, {"tls_key": garbage}, {"tls_cert": garbage}, {"tls_key": locked}):
        with pytest.raises(SettingsError, match="are not a PEM certificate and its unencrypted PEM key"):
            server_security(settings_of(authority, tmp_path, **changed))


@pytest.mark.parametrize(("since", "until"), [(-3 * DAY, -2 * DAY), (2 * DAY, 3 * DAY)])
def test_a_certificate_whose_time_it_is_not(authority: Authority, tmp_path: Path, since: object, until: object) -> None:
    pair = authority.server("old", since=since, until=until)  # type: ignore[arg-type]
    settings = settings_of(authority, tmp_path, tls_cert=pair.cert, tls_key=pair.key)
    with pytest.raises(SettingsError, match=r"old\.crt is valid from .*, not now"):
        server_security(settings)


def test_the_way_to_central_is_checked_too(authority: Authority, tmp_path: Path) -> None:
    garbage = tmp_path / "garbage"
    garbage.write_bytes(b"no PEM")
    good = EdgeSettings(central="c:1", central_ca=authority.ca, central_token=SecretStr(TOKEN))
    assert central_credentials(good) == ClientCredentials(authority.ca.read_bytes(), TOKEN)
    for changed, said in (
        ({"central_ca": garbage}, "EDGE_CENTRAL_CA: .*garbage contains no PEM certificate"),
        ({"central_ca": tmp_path / "none"}, "EDGE_CENTRAL_CA: .* cannot be read"),
        ({"central_token": SecretStr(TOKEN)}, "EDGE_CENTRAL_TOKEN needs EDGE_CENTRAL_CA"),
    ):
        with pytest.raises(SettingsError, match=said):
            central_credentials(EdgeSettings(**changed))


def test_nothing_secret_is_shown(authority: Authority, tmp_path: Path) -> None:
    settings = settings_of(authority, tmp_path)
    told = f"{settings.describe()} {server_security(settings)} {ClientCredentials(b'ca', TOKEN)}"
    assert TOKEN not in told
    assert "PRIVATE KEY" not in told
    assert settings.describe()["EDGE_TOKEN"] == "(set)"
