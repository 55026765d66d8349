"""The trace of a capture, as processes of their own send it to a collector: one id, from its upload to its end."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.process import traces
from capture2vr.process.strict_settings import SettingsError
from capture2vr.process.traces import capture_span, stage_spans, trace_id
from tests.support.fresh_process import run_fresh
from tests.support.gateway_process import running
from tests.support.in_process_gateway import capture as script_capture
from tests.support.in_process_gateway import ended, start, until
from tests.support.patience import PATIENCE_S
from tests.support.photos.private_pictures import jpeg
from tests.support.service_processes import ServiceProcess, killed_at_the_end
from tests.support.workers.inspecting_worker import inspecting_worker
from tests.support.workers.trace_collector import TraceCollector, collecting

pytest.importorskip("opentelemetry.sdk")


@pytest.fixture
def collector() -> Iterator[TraceCollector]:
    with collecting() as server:
        yield server


@pytest.mark.slow
async def test_a_capture_has_one_trace_from_upload_to_publishing(
    tmp_path: Path, collector: TraceCollector, unused_tcp_port: int
) -> None:
    sends = collector.variables
    workers = f"{inspecting_worker()},127.0.0.1:{unused_tcp_port}"  # the scripted one inspects no photos
    options = {"workers": workers, "GATEWAY_PRESETS": "draft,fine", **sends}
    with running(tmp_path, **options) as gateway, ExitStack() as stack:
        async with httpx.AsyncClient(base_url=gateway.url, timeout=PATIENCE_S) as client:
            files = [("files", (f"{number}.jpg", jpeg())) for number in range(3)]
            answer = await client.post("/v1/captures", files=files)
            assert answer.status_code == 201, answer.text
            uploaded = answer.json()["capture"]
            script_capture(gateway.store, uploaded, steps=2)
            edge = ServiceProcess(
                "tests.support.workers.scripted_work_worker",
                tmp_path / "edge.log",
                EDGE_PORT=unused_tcp_port,
                EDGE_SCRATCH=tmp_path / "scratch",
                STORAGE_ROOT=gateway.store.root,
                **sends,
            )
            stack.enter_context(killed_at_the_end(edge))
            job = await start(client, uploaded)
            assert (await ended(client, job))["state"] == "SUCCEEDED"

            async def is_told() -> bool:
                return {"run job", "reconstruct"} <= {span.name for span in collector.of_capture(uploaded)}

            await until(is_told)
    spans = collector.of_capture(uploaded)
    assert {(span.service, span.name) for span in spans} == {
        ("capture2vr-gateway", "receive capture"),
        ("capture2vr-gateway", "run job"),
        ("capture2vr-edge", "reconstruct"),
        ("capture2vr-edge", "FITTING"),
    }
    by_name = {span.name: span for span in spans}
    assert by_name["FITTING"].parent == by_name["reconstruct"].id, "a stage lies within its run"
    assert [span.name for span in spans] == ["receive capture", "run job", "reconstruct", "FITTING"], "by their starts"
    assert not any(span.failed for span in spans)
    lines = [json.loads(line) for line in (tmp_path / "edge.log").read_text().splitlines()]
    assert any(line.get("job") == job for line in lines)


def test_without_a_collector_nothing_is_imported_or_done(tmp_path: Path) -> None:
    said = run_fresh(
        "import sys\n"
        "from capture2vr.process.traces import capture_span, stage_spans, start_tracing\n"
        "start_tracing('x')\n"
        "with capture_span('run', 'cap_1', job='j'), stage_spans() as stages:\n"
        "    stages.enter('FITTING')\n"
        "print([name for name in sys.modules if name.startswith('opentelemetry')])\n",
        extras=["gateway", "traces"],
        cwd=tmp_path,
    )
    assert said.strip() == "[]"


class TestInMemory:
    @pytest.fixture
    def spans(self) -> Iterator[Callable[[], list[Any]]]:
        from opentelemetry.sdk.trace.export import SimpleSpanProcessor
        from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

        kept = InMemorySpanExporter()
        provider = traces.trace_with(SimpleSpanProcessor(kept), "test")
        yield lambda: list(kept.get_finished_spans())
        traces.stop_tracing()
        provider.shutdown()

    def test_stages_follow_each_other_within_their_run(self, spans: Callable[[], list[Any]]) -> None:
        with capture_span("run", "cap_1", job="job_1"), stage_spans() as stages:
            for stage in ("FITTING", "FITTING", "PACKING", "FITTING"):
                stages.enter(stage)
        made = spans()
        assert [span.name for span in made] == ["FITTING", "PACKING", "FITTING", "run"]
        run = made[-1]
        assert {span.parent.span_id for span in made[:-1]} == {run.context.span_id}
        assert {format(span.context.trace_id, "032x") for span in made} == {trace_id("cap_1")}
        assert run.attributes == {"capture2vr.capture": "cap_1", "capture2vr.job": "job_1"}

    def test_a_failure_is_seen_and_passed_on(self, spans: Callable[[], list[Any]]) -> None:
        def fail() -> None:
            with capture_span("run", "cap_1"), stage_spans() as stages:
                stages.enter("FITTING")
                raise ValueError("no surface")

        with pytest.raises(ValueError, match="no surface"):
            fail()
        stage, run = spans()
        assert (stage.name, run.status.is_ok) == ("FITTING", False)
        assert "no surface" in run.events[0].attributes["exception.message"]

    def test_another_capture_is_another_trace(self, spans: Callable[[], list[Any]]) -> None:
        for capture in ("cap_1", "cap_2", ""):
            with capture_span("run", capture):
                pass
        assert len({span.context.trace_id for span in spans()}) == len(spans()) == 2


def test_a_collector_without_the_packages_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(traces.ENDPOINT, "http://127.0.0.1:9")
    monkeypatch.setitem(__import__("sys").modules, "opentelemetry.exporter.otlp.proto.http.trace_exporter", None)
    with pytest.raises(SettingsError, match=r"OTEL_EXPORTER_OTLP_ENDPOINT needs OpenTelemetry: pip install"):
        traces.start_tracing("x")
