"""A client of the stack, which asks the gateways through the edge cache."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx

from tests.referees.docker.stack import Stack, wait_until
from tests.support.patience import PATIENCE_S

_AWAY = {502, 503, 504}
_ENDED = {"SUCCEEDED", "FAILED", "CANCELLED"}


class Client:
    """Asks the gateways through the edge cache; one that is away is asked again."""

    def __init__(self, stack: Stack) -> None:
        self._url = stack.url

    def ask(self, method: str, path: str, **request: Any) -> Any:
        """The JSON of an answer."""
        answers: list[httpx.Response] = []

        def is_answered() -> bool:
            answers.append(httpx.request(method, f"{self._url}{path}", timeout=PATIENCE_S, **request))
            return answers[-1].status_code not in _AWAY

        wait_until(is_answered, f"{method} {path}")
        assert answers[-1].is_success, answers[-1].text
        return answers[-1].json()

    def upload(self, file: Path) -> str:
        """Store a capture; its id."""
        files = {"file": (file.name, file.read_bytes())}
        return str(self.ask("POST", "/v1/captures", files=files)["capture"])

    def start(self, capture: str, key: str, preset: str) -> str:
        """Start a job; its id."""
        body = {"capture": capture, "asset_key": key, "preset": preset}
        return str(self.ask("POST", "/v1/jobs", json=body, headers={"Idempotency-Key": key})["id"])

    def job(self, job: str) -> dict[str, Any]:
        return dict(self.ask("GET", f"/v1/jobs/{job}"))

    def await_stage(self, job: str, stage: str) -> None:
        wait_until(lambda: self.job(job)["stage"] == stage, f"{job} in {stage}: {self.job(job)}")

    def await_end(self, job: str) -> dict[str, Any]:
        """Wait until a job has ended, and see that it ended well, and once."""
        wait_until(lambda: self.job(job)["state"] in _ENDED, f"{job} ends: {self.job(job)}")
        self.require_one_end(job)
        return self.job(job)

    def require_one_end(self, job: str) -> None:
        """Of all events of a job one is its end; of all versions of its asset one is the last."""
        lines = httpx.get(f"{self._url}/v1/jobs/{job}/events").raise_for_status().text.splitlines()
        datas = [json.loads(line[5:]) for line in lines if line.startswith("data:") and line[5:].strip()]
        numbers = [data["seq"] for data in datas]
        assert numbers == sorted(set(numbers)), "no event twice"
        assert [data["state"] for data in datas if data.get("state") in _ENDED] == ["SUCCEEDED"], self.job(job)
        found = self.job(job)
        entry = self.ask("GET", f"/v1/assets/{found['asset_key']}")
        assert entry["version"] == found["asset"]["version"]
        lasts = [each for each in entry["versions"] if each.get("last", each["state"] == "refined")]
        assert [each["version"] for each in lasts] == [entry["version"]], entry["versions"]

    def workers(self) -> int:
        """How many workers the gateway has heard of."""
        return len(self.ask("GET", "/v1/service")["workers"])
