"""A wearer in an emulated Quest 3: what their hands do, frame by frame."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

from playwright.sync_api import BrowserContext, Page, expect

# A headset asks for one picture after the other, and here they are drawn in software: twenty a second are enough.
_TWENTY_A_SECOND = """{
const native = window.requestAnimationFrame.bind(window);
let waiting = new Map(), running = new Map(), timer, last = 0, next = 1;
const frame = (now) => {
    [running, waiting, timer, last] = [waiting, new Map(), undefined, performance.now()];
    for (const callback of running.values()) {
        try { callback(now); } catch (error) { reportError(error); }
    }
};
window.requestAnimationFrame = (callback) => {
    waiting.set(next, callback);
    timer ??= setTimeout(() => native(frame), last + 50 - performance.now());
    return next++;
};
window.cancelAnimationFrame = (id) => {
    waiting.delete(id);
    running.delete(id);
};
}"""
_WORN = """
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.position.set(0, 1.6, 0);
device.stereoEnabled = true;
window.xrDevice = device;
"""
_FURNISH = """planes => {
    const half = Math.SQRT1_2;
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, z]) => new DOMPointReadOnly(x, 0, z));
    const natives = planes.map(([label, [x, y, z]]) => {
        const turn = label === 'wall' ? { x: half, y: 0, z: 0, w: half } : { x: 0, y: 0, z: 0, w: 1 };
        return new IWER.NativePlane(new XRRigidTransform({ x, y, z }, turn), corners, label);
    });
    xrDevice.installSEM(class {
        trackedPlanes = new Set(natives);
        trackedMeshes = new Set();
        environmentCanvas = document.createElement('canvas');
        render() {}
    });
}"""
_FRAMES = """count => new Promise((done) => {
    const step = () => (count-- > 0 ? xrDevice.activeSession.requestAnimationFrame(step) : done());
    step();
})"""
_MOVE = """([kind, side, place, [sine, cosine]]) => {
    const held = xrDevice[kind][side];
    held.position.set(...place);
    held.quaternion.set(sine, 0, 0, cosine);
}"""


def wear(context: BrowserContext, iwer: Path) -> None:
    """Pages of this context run in a headset whose wearer stands at the origin, eyes at 1.6 m, looking along -z."""
    context.add_init_script(_TWENTY_A_SECOND)
    context.add_init_script(path=iwer)
    context.add_init_script(_WORN)


def furnish(context: BrowserContext, planes: Sequence[tuple[str, tuple[float, float, float]]]) -> None:
    """The wearer's room has these planes of two metres, each by its label ("wall": it faces +z, else up) and middle."""
    context.add_init_script(f"({_FURNISH})({json.dumps(planes)})")


def enter(page: Page, mode: str = "VR") -> None:
    """Into the session, until the scene stands ahead."""
    page.get_by_role("button", name=f"Enter {mode}").click()
    expect(page.locator("body")).to_have_attribute("data-xr", "on")
    page.wait_for_function("() => document.body.dataset.placed")
    frames(page)


def frames(page: Page, count: int = 3) -> None:
    """Until the headset has drawn as many pictures."""
    page.evaluate(_FRAMES, count)


class Hand:
    """A controller, or a bare hand, that points along -z."""

    def __init__(self, page: Page, side: str, *, bare: bool = False) -> None:
        self._page, self._side = page, side
        self._kind = "hands" if bare else "controllers"

    def move(self, x: float, y: float, z: float, *, down: float = 0.0) -> None:
        """To a place in the room, in metres, pointing so many degrees down."""
        half = -math.radians(down) / 2
        self._page.evaluate(_MOVE, [self._kind, self._side, [x, y, z], [math.sin(half), math.cos(half)]])
        frames(self._page)

    def press(self, button: str = "trigger") -> None:
        self._set(button, 1)

    def release(self, button: str = "trigger") -> None:
        self._set(button, 0)

    def stick(self, x: float, y: float, count: int) -> None:
        """Hold the thumbstick for some frames."""
        script = "([side, x, y]) => xrDevice.controllers[side].updateAxes('thumbstick', x, y)"
        self._page.evaluate(script, [self._side, x, y])
        frames(self._page, count)
        self._page.evaluate(script, [self._side, 0, 0])
        frames(self._page)

    def _set(self, button: str, value: int) -> None:
        if self._kind == "hands":
            self._page.evaluate("([side, value]) => xrDevice.hands[side].updatePinchValue(value)", [self._side, value])
        else:
            script = "([side, button, value]) => xrDevice.controllers[side].updateButtonValue(button, value)"
            self._page.evaluate(script, [self._side, button, value])
        frames(self._page)
