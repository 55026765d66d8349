"""Names of workers: what they stand for, and how the answer follows the name."""

from __future__ import annotations

import logging
import socket
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.workers.worker_addresses import WorkerAddresses, target_and_name
from capture2vr.process.strict_settings import SettingsError

EDGE = "dns:///edge:50051"


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """What names resolve to, in place of the machine's DNS; an empty list: nothing."""
    known: dict[str, list[str]] = {}

    def look_up(host: str, port: str, *_: Any) -> list[Any]:
        if not known.get(host):
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        families = [socket.AF_INET6 if ":" in each else socket.AF_INET for each in known[host]]
        return [
            (family, socket.SOCK_STREAM, 6, "", (each, int(port)))
            for family, each in zip(families, known[host], strict=True)
        ]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    return known


async def looked_up(addresses: WorkerAddresses) -> tuple[str, ...]:
    """The addresses after another lookup."""
    addresses._began = time.monotonic() - 60
    await addresses.refresh()
    return addresses.current


async def test_a_name_stands_for_all_its_addresses_as_they_come_and_go(names: dict[str, list[str]]) -> None:
    addresses = WorkerAddresses((EDGE, "other:1"))
    names["edge"] = ["10.0.0.3", "10.0.0.2"]
    assert await looked_up(addresses) == ("edge/10.0.0.2:50051", "edge/10.0.0.3:50051", "other:1")
    names["edge"] = ["10.0.0.3", "fd00::4"]
    assert await looked_up(addresses) == ("edge/10.0.0.3:50051", "edge/[fd00::4]:50051", "other:1")
    await addresses.close()


async def test_a_name_without_an_address_is_told_once_and_the_last_ones_stay(
    names: dict[str, list[str]], caplog: pytest.LogCaptureFixture
) -> None:
    addresses = WorkerAddresses((EDGE,))
    with caplog.at_level(logging.WARNING):
        assert await looked_up(addresses) == ()
        assert await looked_up(addresses) == ()
    assert [record.getMessage() for record in caplog.records] == [
        f"GATEWAY_WORKERS: {EDGE} resolves to no address: [Errno {socket.EAI_NONAME}] Name or service not known"
    ]
    assert addresses.unresolved == (EDGE,)
    names["edge"] = ["10.0.0.2"]
    assert await looked_up(addresses) == ("edge/10.0.0.2:50051",)
    assert addresses.unresolved == ()
    names["edge"] = []
    assert await looked_up(addresses) == ("edge/10.0.0.2:50051",)
    assert addresses.unresolved == (EDGE,)
    await addresses.close()


async def test_one_worker_behind_two_names_counts_once(names: dict[str, list[str]]) -> None:
    names.update(edge=["10.0.0.2"], gpu=["10.0.0.2", "10.0.0.3"])
    addresses = WorkerAddresses((EDGE, "dns:///gpu:50051", "10.0.0.3:50051"))
    assert await looked_up(addresses) == ("edge/10.0.0.2:50051", "gpu/10.0.0.3:50051")
    await addresses.close()


async def test_a_name_is_not_looked_up_at_every_poll(names: dict[str, list[str]]) -> None:
    names["edge"] = ["10.0.0.2"]
    addresses = WorkerAddresses((EDGE,))
    await addresses.refresh()
    names["edge"] = ["10.0.0.3"]
    addresses._began = time.monotonic() + 60  # however slow this machine is
    await addresses.refresh()
    assert addresses.current == ("edge/10.0.0.2:50051",)
    await addresses.close()


@given(st.ip_addresses(), st.integers(1, 65535))
def test_an_address_says_where_to_connect_and_whose_certificate_it_is(address: Any, port: int) -> None:
    target = f"[{address}]:{port}" if address.version == 6 else f"{address}:{port}"
    assert target_and_name(f"edge/{target}") == (target, "edge")
    for plain in (target, f"edge:{port}", "unix:/run/edge.sock", "unix:///run/edge.sock"):
        assert target_and_name(plain) == (plain, "")


@pytest.mark.parametrize("wrong", ["dns:///edge", "dns:///:50051", "dns:///edge:", "dns:///a/b:1", "dns:///[::1]:1"])
def test_a_name_without_a_port_is_refused(wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATEWAY_WORKERS", f"edge:1,{wrong}")
    with pytest.raises(SettingsError, match=r"GATEWAY_WORKERS: .*names no workers: write dns:///HOST:PORT"):
        GatewaySettings()
