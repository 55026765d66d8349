"""`capture2vr notes` as a process: what it pins, lists and removes, and what it says of mistakes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from capture2vr.gateway.access.caller import Scope
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.sites import site_at
from tests.support.tenants import make_key, publish_for

BAD = [
    (("../cup",), "is not a valid asset key"),
    (("cup", "--add", "a"), "give both --add TEXT and --at"),
    (("cup", "--add", "a", "--at", "90", "0", "0"), "far away"),
    (("cup", "--add", "a", "--at", "nan", "0", "0"), "three numbers that are finite"),
    (("cup", "--remove", "note_" + "0" * 16), "has no note"),
    (("cup", "--remove", "note_1/../.."), "is not the id of a note"),  # the address of the asset itself
]


@pytest.mark.slow
def test_notes_are_pinned_listed_and_removed(tmp_path: Path) -> None:
    with site_at(tmp_path) as site:
        publish_for(site.store, "ada", "cup")
        key = make_key(tmp_path / "data", "ada", {Scope.MANAGE, Scope.READ})
        told = {**os.environ, "CAPTURE2VR_KEY": key, "CAPTURE2VR_GATEWAY": site.url, "COLUMNS": "300"}

        def notes(*arguments: str) -> subprocess.CompletedProcess[str]:
            command = [sys.executable, "-m", "capture2vr.cli", "notes", *arguments]
            return subprocess.run(command, env=told, capture_output=True, text=True, timeout=120)

        done = notes("cup", "--add", "[bold]Worn\nhere", "--at", "0.5", "-0.25", "2")
        (note,) = read_entry(store_of_tenant(site.store, "ada"), "cup").notes
        assert (note.text, note.at) == ("[bold]Worn\nhere", (0.5, -0.25, 2))
        assert (done.returncode, done.stdout.strip()) == (0, f"{note.id}  0.500 -0.250 2.000  [bold]Worn / here")
        for arguments, said in BAD:
            done = notes(*arguments)
            assert done.returncode == 2, done.stderr
            assert said in done.stderr
        assert read_entry(store_of_tenant(site.store, "ada"), "cup").notes == (note,)
        done = notes("cup", "--remove", note.id)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
