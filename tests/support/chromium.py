"""Start Debian's headless Chromium, which draws in software."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from playwright.sync_api import Browser, Playwright

# Software rendering, and none of the connections that a browser opens for itself.
_FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--use-gl=angle",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--no-first-run",
    "--mute-audio",
]
# The processor puts pages together: cheaper in software, but each frame of a canvas is read back, and waited for.
_COPIED = "--disable-gpu-compositing"


def chromium() -> str | None:
    """The browser's program. The headless shell comes first: a page costs it half of the whole browser's work."""
    return shutil.which("chromium-headless-shell") or shutil.which("chromium")


def launch(playwright: Playwright, flags: Sequence[str] = (), *, composited: bool = False) -> Browser:
    """A browser that has been nowhere. It has to be installed.

    composited  whether pages are put together as on a device with a graphics card, so that no frame waits for another
    """
    args = [*_FLAGS, *flags, *([] if composited else [_COPIED])]
    return playwright.chromium.launch(executable_path=chromium(), args=args)


def launch_with_camera(browser: Browser, film: Path | None) -> Browser:
    """Another one, whose camera shows a film again and again (YUV4MPEG2), and which pages may use; None: they may not.

    browser: that runs, as Playwright has one loop
    """
    answer = "--use-fake-ui-for-media-stream" + ("" if film else "=deny")
    camera = [f"--use-file-for-fake-video-capture={film}"] if film else []
    insecure = "--host-resolver-rules=MAP camera.local 127.0.0.1"  # a name of this machine that is not "localhost"
    flags = [*_FLAGS, "--use-fake-device-for-media-stream", answer, *camera, insecure]
    return browser.browser_type.launch(executable_path=chromium(), args=flags)
