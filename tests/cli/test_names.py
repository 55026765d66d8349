"""`capture2vr name` as a process: what it changes, what it leaves, and what it says of mistakes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from capture2vr.gateway.access.caller import Scope
from capture2vr.order.asset_names import AssetNames
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.sites import site_at
from tests.support.tenants import make_key, publish_for

BAD = [
    (("cup",), "nothing to change"),
    (("../cup", "--label", "a"), "is not a valid asset key"),
    (("mug", "--label", "a"), "there is no asset mug"),
    (("cup", "--label", "a" * 300), "label"),
]


@pytest.mark.slow
def test_an_asset_is_named_and_what_is_no_name_is_told(tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        publish_for(site.store, "ada", "cup")
        key = make_key(tmp_path / "data", "ada", {Scope.MANAGE})
        told = {**os.environ, "CAPTURE2VR_KEY": key, "CAPTURE2VR_GATEWAY": site.url, "COLUMNS": "300"}

        def name(*arguments: str) -> subprocess.CompletedProcess[str]:
            command = [sys.executable, "-m", "capture2vr.cli", "name", *arguments]
            return subprocess.run(command, env=told, capture_output=True, text=True, timeout=120)

        done = name("cup", "--label", "[bold]Cup", "--tag", "blue", "--tag", "Kitchen")
        assert (done.returncode, done.stderr.strip()) == (0, "cup: [bold]Cup (blue, Kitchen)")
        done = name("cup", "--no-tags", "--description", "It leaks.")
        assert done.stderr.splitlines() == ["cup: [bold]Cup", "It leaks."]
        for arguments, said in BAD:
            done = name(*arguments)
            assert done.returncode == 2, done.stderr
            assert said in done.stderr
        assert read_entry(store_of_tenant(site.store, "ada"), "cup").names == AssetNames("[bold]Cup", "It leaks.", ())
