"""Debian's packages, from where this machine gets its own."""

from __future__ import annotations

import re
from pathlib import Path

_MIRROR = "http://deb.debian.org/debian"


def debian_mirror() -> str:
    """The address of the mirror of Debian that this machine uses."""
    lists = [Path("/etc/apt/sources.list"), *Path("/etc/apt/sources.list.d").glob("*")]
    texts = " ".join(path.read_text() for path in lists if path.is_file())
    found = re.search(r"(?<![#\w])https?://\S+/debian/?(?=\s)", texts)
    return found[0] if found else _MIRROR
