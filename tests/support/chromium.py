"""Start Debian's headless Chromium, which draws in software."""

from __future__ import annotations

import shutil

from playwright.sync_api import Browser, Playwright

# Software rendering, and none of the connections that a browser opens for itself.
_FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--use-gl=angle",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-gpu-compositing",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--no-first-run",
    "--mute-audio",
]


def chromium() -> str | None:
    """The browser's program. The headless shell comes first: a page costs it half of the whole browser's work."""
    return shutil.which("chromium-headless-shell") or shutil.which("chromium")


def launch(playwright: Playwright) -> Browser:
    """A browser that has been nowhere. It has to be installed."""
    return playwright.chromium.launch(executable_path=chromium(), args=_FLAGS)
