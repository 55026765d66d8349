"""Settings: frozen, complete, and a variable that means nothing is an error with its name."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import SecretStr, ValidationError
from pydantic_settings import SettingsConfigDict

from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.process.strict_settings import CommaList, SettingsError, StrictSettings


class Sample(StrictSettings):
    model_config = SettingsConfigDict(env_prefix="SAMPLE_")

    workers: CommaList = ()
    password: SecretStr = SecretStr("")
    database_url: str = ""
    size: int = 1


def test_the_defaults_stay_on_this_machine() -> None:
    settings = EdgeSettings()
    assert settings.is_local
    assert (settings.host, settings.port, settings.slots, settings.queue) == ("127.0.0.1", 50051, 1, 8)
    assert not settings.reflection


def test_the_environment_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_SLOTS", "3")
    monkeypatch.setenv("EDGE_SCRATCH", "/somewhere")
    monkeypatch.setenv("EDGE_REFLECTION", "true")
    monkeypatch.setenv("EDGE_HOST", "")  # compose passes unset variables as empty ones
    settings = EdgeSettings()
    assert (settings.slots, settings.scratch, settings.reflection) == (3, Path("/somewhere"), True)
    assert settings.host == "127.0.0.1"


def test_memory_may_have_a_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    assert EdgeSettings().memory == 0
    for text in ("6GiB", str(6 << 30)):
        monkeypatch.setenv("EDGE_MEMORY", text)
        assert EdgeSettings().memory == 6 << 30


@pytest.mark.parametrize("address", ["central:50051", "10.0.0.7:1", "gpu-1.example.org:65535", "[::1]:50051"])
def test_a_central_is_named_with_its_port(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    assert EdgeSettings().central == ""
    monkeypatch.setenv("EDGE_CENTRAL", address)
    assert EdgeSettings().central == address
    assert EdgeSettings().describe()["EDGE_CENTRAL"] == address


def test_a_generator_is_named_by_its_address(monkeypatch: pytest.MonkeyPatch) -> None:
    assert EdgeSettings().generator == ""
    monkeypatch.setenv("EDGE_GENERATOR", "http://127.0.0.1:8080")
    assert EdgeSettings().generator == "http://127.0.0.1:8080"
    monkeypatch.setenv("EDGE_GENERATOR", "127.0.0.1:8080/generate")
    with pytest.raises(SettingsError, match=r"EDGE_GENERATOR.*must be http://host:port"):
        EdgeSettings()


@pytest.mark.parametrize("device", ["cpu", "cuda", "cuda:3", "auto"])
def test_devices_have_torchs_names(monkeypatch: pytest.MonkeyPatch, device: str) -> None:
    monkeypatch.setenv("EDGE_DEVICE", device)
    assert EdgeSettings().device == device


def test_an_unknown_variable_is_named_with_the_one_that_was_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_SLOT", "3")
    with pytest.raises(SettingsError, match=r"EDGE_SLOT is not a setting, did you mean EDGE_SLOTS\?"):
        EdgeSettings()


def test_an_unknown_variable_far_from_any_gets_the_list(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_ABRACADABRA", "3")
    known = "the settings are EDGE_CENTRAL, .*EDGE_SLOTS"
    with pytest.raises(SettingsError, match=f"EDGE_ABRACADABRA is not a setting; {known}"):
        EdgeSettings()


def test_other_services_variables_are_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATEWAY_PORT", "1")
    monkeypatch.setenv("EDGEWISE", "1")
    EdgeSettings()


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("PORT", "many"),
        ("PORT", "70000"),
        ("SLOTS", "0"),
        ("QUEUE", "-1"),
        ("DRAIN_S", "-1"),
        ("DRAIN_S", "nan"),
        ("DEVICE", "gpu"),
        ("CENTRAL", "nowhere"),
        ("CENTRAL", "http://central:50051"),
        ("CENTRAL", "central:0"),
        ("CENTRAL", "central:65536"),
        ("CENTRAL", "a:1,b:2"),
        ("CENTRAL", "::1:50051"),
    ],
)
def test_a_value_that_does_not_fit_is_named_and_not_shown(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    monkeypatch.setenv(f"EDGE_{variable}", value)
    with pytest.raises(SettingsError, match=f"EDGE_{variable}: ") as error:
        EdgeSettings()
    assert value not in str(error.value).replace("(nan)", "")


def test_settings_are_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        EdgeSettings().port = 1  # type: ignore[misc]


def test_a_list_is_one_variable_with_commas(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAMPLE_WORKERS", "a:1, b:2,")
    assert Sample().workers == ("a:1", "b:2")


def test_the_description_holds_no_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAMPLE_PASSWORD", "hunter2")
    monkeypatch.setenv("SAMPLE_DATABASE_URL", "postgresql://me:hunter2@db:5432/jobs")
    assert Sample().describe() == {
        "SAMPLE_WORKERS": "",
        "SAMPLE_PASSWORD": "(set)",
        "SAMPLE_DATABASE_URL": "postgresql://me:***@db:5432/jobs",
        "SAMPLE_SIZE": 1,
    }
    assert Sample(password=SecretStr("")).describe()["SAMPLE_PASSWORD"] == "(unset)"
