"""Sending: signed as Standard Webhooks has it, to the address that was checked, in its time, to the internet only."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import ssl
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from standardwebhooks import Webhook

from capture2vr.gateway.webhooks import send
from capture2vr.gateway.webhooks.outbox import Delivery, Message
from capture2vr.gateway.webhooks.send import Outcome, Sender, is_public
from capture2vr.gateway.webhooks.store import new_secret
from tests.support.network.receivers import receiver
from tests.support.network.tls_certificates import Authority


def delivery(url: str, *secrets: str) -> Delivery:
    message = Message("msg_1", "hook_1", "ada", "job.failed", '{"a":"ü"}', 0.0, 0, 0.0, None, False, "")
    return Delivery(message, url, secrets or (new_secret(),))


async def attempt(url: str, *secrets: str, allow_private: bool = True) -> Outcome:
    sender = Sender(allow_private=allow_private)
    try:
        return await sender.send(delivery(url, *secrets))
    finally:
        await sender.close()


async def test_a_message_is_signed_with_every_secret() -> None:
    new, old = new_secret(), new_secret()
    async with receiver() as got:
        got.answers = [200]
        outcome = await attempt(got.url, new, old)
        ((headers, body),) = got.got
    assert outcome == Outcome(delivered=True, answer="200 hello")
    assert headers["content-type"] == "application/json"
    assert headers["host"] == got.url.split("/")[2]
    for secret in (new, old):
        assert Webhook(secret).verify(body, headers) == {"a": "ü"}
    with pytest.raises(Exception, match="No matching signature"):
        Webhook(new_secret()).verify(body, headers)


@pytest.mark.parametrize("status", [301, 302, 307, 400, 404, 429, 500, 503])
async def test_what_is_no_success_is_none(status: int) -> None:
    async with receiver() as got:
        got.answers, got.headers = [status], "Location: http://127.0.0.1:1/\r\nRetry-After: 120\r\n"
        outcome = await attempt(got.url)
        assert len(got.got) == 1, "redirects are not followed"
    assert not outcome.delivered
    assert outcome.answer.startswith(f"{status} ")
    assert outcome.wait_s == 120.0


async def test_a_receiver_that_is_gone_says_so() -> None:
    async with receiver() as got:
        got.answers = [410]
        assert (await attempt(got.url)).gone


async def test_a_slow_receiver_and_an_endless_answer_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send, "TIMEOUT_S", 0.5)
    async with receiver() as slow, receiver() as endless:
        slow.delay_s, endless.endless = 60.0, True
        began = time.monotonic()
        assert (await attempt(slow.url)).answer == "no answer within 0.5 s"
        assert (await attempt(endless.url)).delivered, "its status was a success, and nobody reads on"
        assert time.monotonic() - began < 10


async def test_nobody_there() -> None:
    outcome = await attempt("http://127.0.0.1:9/")
    assert not outcome.delivered
    assert outcome.answer


@pytest.mark.parametrize(
    "url",
    [
        "https://127.0.0.1/",
        "https://localhost/",
        "https://[::1]/",
        "https://[::ffff:127.0.0.1]/",
        "https://10.0.0.1/",
        "https://169.254.169.254/latest/meta-data/",
        "https://192.168.1.1:8443/",
        "https://100.64.0.1/",
        "https://0.0.0.0/",
        "https://[fe80::1]/",
        "https://[fd00::1]/",
        "https://[fec0::1]/",
        "https://[::10.0.0.1]/",
        "https://[64:ff9b::10.0.0.1]/",
        "https://[64:ff9b:1::10.0.0.1]/",
        "https://2130706433/",
        "https://0x7f000001/",
        "http://93.184.216.34/",
        "https://user:password@93.184.216.34/",
        "ftp://93.184.216.34/",
        "https:///nothing",
        "https://93.184.216.34:99999/",
        "https://93.184.216.34:0/",
        "https://xn--/",
        "https://xn--zzzz----.com/",
    ],
)
async def test_addresses_that_are_not_of_the_internet_are_refused(url: str) -> None:
    outcome = await attempt(url, allow_private=False)
    assert not outcome.delivered
    with pytest.raises((send.UrlRefused, OSError)):
        await Sender(allow_private=False).check(url)


async def test_a_name_with_one_private_address_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    resolve_to(monkeypatch, "93.184.216.34", "127.0.0.1")
    assert "not an address of the internet" in (await attempt("https://mixed.example/", allow_private=False)).answer


async def test_the_address_that_was_checked_is_the_one_that_is_asked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A name that resolves to a public address at the check, and to this machine afterwards."""
    answers = iter([["93.184.216.34"], ["127.0.0.1"]])
    asked: list[str] = []

    async def getaddrinfo(host: str, port: int, **_: Any) -> list[Any]:
        asked.append(host)
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, port)) for address in next(answers)]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)
    monkeypatch.setattr(send, "TIMEOUT_S", 1.0)
    async with receiver() as here:
        port = here.url.split(":")[2].split("/")[0]
        outcome = await attempt(f"https://rebind.example:{port}/", allow_private=False)
        assert not outcome.delivered
        assert here.got == []
    assert asked[0] == "rebind.example"
    assert all(host != "rebind.example" for host in asked[1:]), "it is looked up once"


async def test_the_certificate_must_be_the_hosts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    pair = authority.server(host="hooks.example")
    context.load_cert_chain(pair.cert, pair.key)
    monkeypatch.setenv("SSL_CERT_FILE", str(authority.ca))
    resolve_to(monkeypatch, "127.0.0.1")

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 204 x\r\nContent-Length: 0\r\n\r\n")
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0, ssl=context)
    port = server.sockets[0].getsockname()[1]
    assert (await attempt(f"https://hooks.example:{port}/")).delivered
    other = await attempt(f"https://other.example:{port}/")
    assert not other.delivered
    assert "CERTIFICATE_VERIFY_FAILED" in other.answer
    server.close()


def resolve_to(monkeypatch: pytest.MonkeyPatch, *addresses: str) -> None:
    """Let every name resolve to these addresses."""

    async def getaddrinfo(_: str, port: int, **__: Any) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, port)) for address in addresses]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)


@given(st.ip_addresses(v=4))
def test_an_address_in_another_form_is_as_private(address: ipaddress.IPv4Address) -> None:
    public = is_public(str(address))
    assert not (public and (address.is_private or address.is_loopback or address.is_link_local or address.is_multicast))
    if not public:
        mapped, sixtofour = f"::ffff:{address}", ipaddress.IPv6Address((0x2002 << 112) | (int(address) << 80))
        assert not is_public(mapped)
        assert not is_public(str(sixtofour))


def test_an_address_that_a_network_without_ipv4_reaches_is_of_the_internet() -> None:
    assert is_public("64:ff9b::93.184.216.34")
    assert is_public("2606:2800:21f:cb07:6820:80da:af6b:8b2c")


@given(st.ip_addresses(v=6))
def test_addresses_of_version_six(address: ipaddress.IPv6Address) -> None:
    if is_public(str(address)):
        assert address.is_global
        assert not address.is_multicast
