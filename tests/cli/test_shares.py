"""`capture2vr shares` as a process: links are made, listed with how often they were opened, and revoked."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway.access.caller import Scope
from tests.support.sites import Site, site_at
from tests.support.tenants import make_key, publish_for

Ended = subprocess.CompletedProcess[str]
Shares = Callable[..., Ended]


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """Of ada a cup."""
    with site_at(tmp_path) as site:
        publish_for(site.store, "ada", "cup")
        yield site


@pytest.fixture
def shares(site: Site, tmp_path: Path) -> Shares:
    """The command, with ada's key."""
    key = make_key(tmp_path / "data", "ada", {Scope.MANAGE})

    def call(*arguments: str, **variables: str) -> Ended:
        told = {"CAPTURE2VR_KEY": key, "CAPTURE2VR_GATEWAY": site.url, "COLUMNS": "300", **variables}
        command = [sys.executable, "-m", "capture2vr.cli", "shares", *arguments]
        return subprocess.run(command, env={**os.environ, **told}, capture_output=True, text=True, timeout=60)

    return call


def opened(site: Site, link: str, password: str = "") -> int:
    body = {"token": link.rpartition("/")[2], "password": password}
    return httpx.post(f"{site.url}/v1/shares/open", json=body).status_code


@pytest.mark.slow
def test_a_link_is_made_listed_and_revoked(site: Site, shares: Shares) -> None:
    made = shares("create", "cup", "--mode", "place", "--label", "for Bob", "--expires-days", "0")
    assert made.returncode == 0, made.stderr
    link = made.stdout.strip()
    assert link.startswith(f"{site.url}/s/shr_")
    assert "opens cup until it is revoked: whoever has the link needs no login" in made.stderr
    assert opened(site, link) == 200
    id_ = made.stderr.split()[0]
    row = next(line for line in shares("list").stdout.splitlines() if id_ in line)
    told = [cell.strip() for cell in row.strip("│").split("│")]
    assert told == [id_, "asset cup", "place", "for Bob", "until revoked", "1", link]
    assert "its link is refused within a minute" in shares("revoke", id_).stderr
    assert opened(site, link) == 410
    assert "revoked" in shares("list").stdout


@pytest.mark.slow
def test_a_collections_link_has_the_password_of_the_environment(site: Site, shares: Shares) -> None:
    made = shares("create", "default", "--collection", CAPTURE2VR_SHARE_PASSWORD="open sesame")
    assert "with a password" in made.stderr
    link = made.stdout.strip()
    assert (opened(site, link), opened(site, link, "open sesame")) == (401, 200)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("create", "jug"), "there is no asset"),
        (("create", ".x"), "is not a valid asset key"),
        (("create", ".x", "--collection"), "not a valid"),
        (("revoke", "shr_" + "0" * 24), "there is no share"),
        (("revoke", "../keys"), "is not the id of a share"),
        (("list", "--gateway", "http://127.0.0.1:9"), "cannot be reached"),
    ],
)
def test_what_does_not_work_is_said_in_one_line(shares: Shares, arguments: tuple[str, ...], said: str) -> None:
    ended = shares(*arguments)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert said in ended.stderr
    assert ended.stderr.count("\n") == 1
