"""What metrics and log tell of what a gateway depends on, who may read them, and that a scrape waits for none of it."""

from __future__ import annotations

import logging
import shutil
import time
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from prometheus_client.parser import text_string_to_metric_families
from pydantic import SecretStr

from capture2vr.cli.deployment.tls_authority import CA_DAYS, make_authority
from capture2vr.gateway.access.api_key import new_secret
from capture2vr.gateway.app import create_app
from capture2vr.gateway.gateway import gateway_in
from capture2vr.gateway.server import refuse_without_keys
from capture2vr.gateway.settings import GatewaySettings, read_metrics_token
from capture2vr.gateway.vitals.vitals import Vitals
from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.memory import MemoryStore
from tests.support.in_process_gateway import answering, capture, gateway, memory, start

TOKEN = "a-token-of-the-metrics"


def samples(text: str) -> dict[str, float]:
    """Values by name and label values: `capture2vr_check_ok store`."""
    return {
        " ".join((sample.name, *sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


class _Deaf(MemoryStore):
    """A store that can be away."""

    away = False

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> Any:
        if self.away:
            raise OSError("away")
        return super().list(prefix, after=after, limit=limit)


async def scrape(client: httpx.AsyncClient) -> dict[str, float]:
    return samples((await client.get("/metrics")).raise_for_status().text)


async def test_what_is_away_is_told_and_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    store = _Deaf()
    app = create_app(GatewaySettings(data_dir=tmp_path, workers=("127.0.0.1:9",)), store)
    caplog.set_level(logging.INFO)
    async with answering(app) as client:
        vitals = Vitals(gateway_in(app))
        gateway_in(app).upkeep.backups.prove("2026-11-30", 12345.0, 23456.0)
        await vitals.look()
        found = await scrape(client)
        assert {name: found[f"capture2vr_check_ok {name}"] for name in ("store", "database", "disk", "workers")} == {
            **dict.fromkeys(("store", "database", "disk"), 1.0),
            "workers": 0.0,
        }
        assert (found["capture2vr_workers known"], found["capture2vr_workers answering"]) == (1, 0)
        assert found["capture2vr_disk_total_bytes database and staging"] == shutil.disk_usage(tmp_path).total
        assert found["capture2vr_disk_free_bytes database and staging"] > 0
        assert found["capture2vr_copy_seconds backup"] == 12345.0
        assert found["capture2vr_copy_seconds drill"] == 23456.0
        store.away = True
        for _ in range(3):
            await vitals.look()
        assert (await scrape(client))["capture2vr_check_ok store"] == 0
        store.away = False
        await vitals.look()
    said = [record.getMessage() for record in caplog.records if "store:" in record.getMessage()]
    assert said == ["not ready: store: OSError", "ready again: store: answers"]


async def test_a_job_that_waits_is_told_and_probes_are_not_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "capture2vr.gateway.requests")
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        assert (await scrape(client))["capture2vr_queue_oldest_seconds"] == 0
        await start(client, capture(store))
        found = await scrape(client)
        assert found["capture2vr_queue_oldest_seconds"] > 0
        assert (found["capture2vr_queue_depth"], found["capture2vr_jobs QUEUED"]) == (1, 1)
        for path in ("/livez", "/readyz", "/v1/jobs"):
            await client.get(path)
    assert [record.__dict__["path"] for record in caplog.records] == ["/v1/jobs", "/v1/jobs"]


async def test_the_token_reads_metrics_and_nothing_else(tmp_path: Path) -> None:
    secret, key = tmp_path / "token", new_secret("default")
    secret.write_text(TOKEN + "\n")
    told: dict[str, Any] = {"operator_key": SecretStr(key), "host": "0.0.0.0", "metrics_token_file": secret}
    (tmp_path / "gw").mkdir()
    refuse_without_keys(GatewaySettings(data_dir=tmp_path / "gw", **told))
    async with gateway(tmp_path / "gw", memory(), **told) as client:

        async def status(path: str, token: str) -> int:
            return (await client.get(path, headers={"Authorization": f"Bearer {token}"})).status_code

        assert await status("/metrics", TOKEN) == await status("/metrics", key) == 200
        assert (await client.get("/metrics")).status_code == 401
        assert await status("/metrics", TOKEN[:-1]) == await status("/metrics", "x" + TOKEN) == 401
        for path in ("/v1/queue", "/v1/jobs", "/openapi.json"):
            assert await status(path, TOKEN) == 401


async def test_metrics_are_shown_while_the_database_is_away(tmp_path: Path) -> None:
    settings = GatewaySettings(data_dir=tmp_path, metrics_token=SecretStr(TOKEN), workers=("127.0.0.1:9",))
    app = create_app(settings, memory())
    async with answering(app) as client:
        client.headers["Authorization"] = f"Bearer {TOKEN}"
        with gateway_in(app).job_store.blocking.engine.begin() as db:
            db.execute(sa.text("ALTER TABLE job_counts RENAME TO away"))
        found = await scrape(client)
        assert "capture2vr_webhook_attempts_total" not in found
        assert found["capture2vr_queue_depth"] != found["capture2vr_queue_depth"], "no number"
        with gateway_in(app).job_store.blocking.engine.begin() as db:
            db.execute(sa.text("ALTER TABLE away RENAME TO job_counts"))
        assert (await scrape(client))["capture2vr_queue_depth"] == 0


@pytest.mark.parametrize(("content", "said"), [(None, "No such file"), ("", "is empty"), ("short", "at least 16")])
def test_a_token_that_cannot_be_used_is_named(tmp_path: Path, content: str | None, said: str) -> None:
    file = tmp_path / "token"
    if content is not None:
        file.write_text(content)
    with pytest.raises(SettingsError, match=f"GATEWAY_METRICS_TOKEN.*{said}"):
        read_metrics_token(GatewaySettings(metrics_token_file=file))
    assert read_metrics_token(GatewaySettings()) == ""


async def test_a_certificates_end_is_told(tmp_path: Path) -> None:
    make_authority(tmp_path / "ca.pem", tmp_path / "ca.key")
    async with gateway(tmp_path / "gw", memory(), edge_ca=tmp_path / "ca.pem") as client:
        found = await scrape(client)
    days = (found["capture2vr_certificate_expires_seconds GATEWAY_EDGE_CA"] - time.time()) / 86_400
    assert days == pytest.approx(CA_DAYS, abs=1)
