"""The gateway is one whole, typed object: nothing else is kept in the app's state, and nobody changes it."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import typing
from pathlib import Path

import pytest

import capture2vr.gateway
from capture2vr.gateway import gateway as parts
from capture2vr.gateway.app import create_app
from capture2vr.gateway.gateway import Gateway, gateway_in
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.memory import MemoryStore
from tests.support.in_process_gateway import answering

SERVICE = Path(capture2vr.gateway.__path__[0])
KINDS = [kind for _, kind in inspect.getmembers(parts, dataclasses.is_dataclass) if kind.__module__ == parts.__name__]


def states_of_apps(source: str) -> list[str]:
    """Each place that names the state of an app, such as `request.app.state.store`."""
    named = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Attribute) and node.attr == "state"]
    return sorted(ast.unparse(node) for node in named if ast.unparse(node.value).endswith(("app", "app']")))


def test_a_state_of_an_app_is_found() -> None:
    source = "a = request.app.state.x; app.state.y = 1; scope['app'].state; request.state.caller; bundle.state"
    assert states_of_apps(source) == ["app.state", "request.app.state", "scope['app'].state"]


def test_one_module_alone_touches_the_state_of_the_app() -> None:
    found = {path.relative_to(SERVICE).as_posix(): states_of_apps(path.read_text()) for path in SERVICE.rglob("*.py")}
    assert {name: places for name, places in found.items() if places} == {"gateway.py": ["app.state", "app.state"]}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_part_is_typed_and_stays(kind: type) -> None:
    assert kind.__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert "__slots__" in vars(kind)
    types = typing.get_type_hints(kind)
    assert typing.Any not in types.values()
    assert not any(type(None) in typing.get_args(each) for each in types.values()), "a part that is not there yet"


async def test_a_started_app_keeps_its_gateway_alone(tmp_path: Path) -> None:
    app = create_app(GatewaySettings(data_dir=tmp_path, workers=(), open=True), MemoryStore())
    assert app.state._state == {}
    async with answering(app):
        assert app.state._state == {"gateway": gateway_in(app)}
        assert isinstance(gateway_in(app), Gateway)
        with pytest.raises(dataclasses.FrozenInstanceError):
            gateway_in(app).store = MemoryStore()  # type: ignore[misc]
