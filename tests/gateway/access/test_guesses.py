"""Guessing codes and passwords is slow for each network, and who guesses keeps nobody else from pairing."""

from __future__ import annotations

import pytest
from starlette.requests import Request

from capture2vr.gateway.access.guesses import Guesses
from capture2vr.gateway.access.pairing import free_code
from capture2vr.gateway.access.store import PAIRING_S
from capture2vr.gateway.errors import Problem

pytestmark = pytest.mark.usefixtures("still_limits")


def of(address: str) -> Request:
    """A request from an address."""
    return Request({"type": "http", "client": (address, 1), "headers": []})


def refused(guesses: Guesses, address: str, share: str = "") -> bool:
    try:
        guesses.spend(of(address), share)
    except Problem:
        return True
    return False


def test_strangers_keep_nobody_from_pairing() -> None:
    """Six addresses with five wrong codes each kept everybody from it."""
    guesses = Guesses("code")
    strangers = [f"198.51.{number // 200}.{number % 200}" for number in range(1_000)]
    assert not any(refused(guesses, address) for address in strangers for _ in range(5))
    assert all(refused(guesses, address) for address in strangers)
    assert not refused(guesses, "203.0.113.7")


def test_a_network_is_one_however_many_addresses_it_has() -> None:
    guesses = Guesses("code")
    assert [refused(guesses, f"2001:db8:0:7::{number:x}") for number in range(7)] == [False] * 5 + [True] * 2
    assert refused(guesses, "2001:db8:0:7:ffff::1")
    assert not refused(guesses, "2001:db8:0:8::1")
    assert [refused(guesses, address) for address in ["::ffff:192.0.2.1", "192.0.2.1"] * 3] == [False] * 5 + [True]
    assert not refused(guesses, "::ffff:192.0.2.2")


def test_a_gateway_that_answers_guesses_alone_gives_away_no_code() -> None:
    """2,000 answers a second, for as long as a code lives, of all the codes that there are."""
    assert 2_000 * PAIRING_S / 10 ** len(free_code(set())) < 1e-4


def test_a_share_has_a_limit_in_all_and_others_go_on() -> None:
    guesses = Guesses("password")
    assert [refused(guesses, f"192.0.2.{number}", "a") for number in range(31)] == [False] * 30 + [True]
    assert not refused(guesses, "192.0.2.200", "b")
