"""The gateway's way to its workers: TLS, a shared token, and what is said when they do not fit."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
from pydantic import SecretStr

from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.gateway.server import serve
from capture2vr.gateway.settings import GatewaySettings, worker_credentials
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.process.grpc_security import ClientCredentials
from capture2vr.process.strict_settings import SettingsError
from tests.support.in_process_gateway import Making, capture, ended, gateway, memory, start, worker
from tests.support.network.tls_certificates import TOKEN, Authority


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


def of_worker(authority: Authority) -> dict[str, object]:
    pair = authority.server()
    return {"tls_cert": pair.cert, "tls_key": pair.key, "token": SecretStr(TOKEN)}


async def test_a_job_runs_over_tls_with_a_token(tmp_path: Path, authority: Authority) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge", **of_worker(authority)) as port:
        way = {"edge_ca": authority.ca, "edge_token": SecretStr(TOKEN)}
        async with gateway(tmp_path / "gw", store, port, **way) as client:
            done = await ended(client, await start(client, capture(store)))
            assert (done["state"], done["asset"]["state"]) == ("SUCCEEDED", "refined")
            assert (await client.get("/readyz")).json()["checks"]["workers"]["ok"]


async def test_a_worker_that_does_not_know_us_is_told_of_once(
    tmp_path: Path, authority: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    async with worker(Making(memory()), tmp_path / "edge", **of_worker(authority)) as port:
        for caller, word in (
            (ClientCredentials(authority.ca.read_bytes(), TOKEN + "x"), "UNAUTHENTICATED: TOKEN_WRONG"),
            (ClientCredentials(authority.ca.read_bytes()), "UNAUTHENTICATED: TOKEN_MISSING"),
            (ClientCredentials(Authority(tmp_path, "stranger").ca.read_bytes(), TOKEN), "UNAVAILABLE"),
        ):
            pool = WorkerPool((f"127.0.0.1:{port}",), credentials=caller)
            caplog.clear()
            with caplog.at_level(logging.WARNING):
                for _ in range(3):
                    assert await pool.poll() == ()
            await pool.close()
            (record,) = [each for each in caplog.records if each.name == "capture2vr.gateway.workers.worker_client"]
            assert word in record.getMessage()
            assert TOKEN not in record.getMessage()


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ({"edge_token": SecretStr(TOKEN)}, "GATEWAY_EDGE_TOKEN needs GATEWAY_EDGE_CA"),
        ({"edge_ca": Path("/nowhere.pem")}, "GATEWAY_EDGE_CA: /nowhere.pem cannot be read"),
        ({"edge_ca": Path(__file__)}, "GATEWAY_EDGE_CA: .* contains no PEM certificate"),
    ],
)
def test_wrong_settings_are_named_and_nothing_starts(
    tmp_path: Path, way: dict[str, object], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The logs of this process, which other tests read.
    monkeypatch.setattr("capture2vr.gateway.server.configure", lambda level: None)
    settings = GatewaySettings(data_dir=tmp_path / "gw", port=0, **way)
    with pytest.raises(SettingsError, match=said):
        worker_credentials(settings)
    assert serve(settings, memory()) == 1


def test_both_sides_use_one_token_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_TOKEN", TOKEN)
    monkeypatch.setenv("GATEWAY_EDGE_TOKEN", TOKEN)
    assert EdgeSettings().describe()["EDGE_TOKEN"] == GatewaySettings().describe()["GATEWAY_EDGE_TOKEN"] == "(set)"
