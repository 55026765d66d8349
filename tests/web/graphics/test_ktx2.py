"""Textures as KTX2 in the viewer: unpacked beside the page by what only such files load, and kept for a visit without
a server."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from playwright.sync_api import Browser, Page, expect

from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.ktx2 import Ktx2Encoder
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.texture.bake import jpeg_of
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from tests.referees.ktx2.encoder import ktx2  # noqa: F401 - a fixture is used by its name
from tests.support.lines import line_to
from tests.support.pages import await_data, time_limit_ms
from tests.support.screenshots import await_frames, difference, drawn, places_of, stage
from tests.support.sites import Site
from tests.support.things import BLUE, GREEN, RED, bundle_of
from tests.web.conftest import with_a_past

pytestmark = pytest.mark.browser
SIDE = 128
UNPACKING = ("ktx2-worker.js", "basis-transcoder.js", "basis-transcoder.wasm")


def quarters() -> np.ndarray:
    """Four colours, the second half as bright towards the bottom: turned or mirrored it would be another picture."""
    picture = np.zeros((SIDE, SIDE, 3))
    half = SIDE // 2
    picture[:half, :half], picture[:half, half:] = RED, GREEN
    picture[half:, :half], picture[half:, half:] = BLUE, (230, 220, 200)
    return (picture * np.linspace(1, 0.5, SIDE)[:, None, None]).astype(np.uint8)


def cube(encode: Ktx2Encoder | None) -> Bundle:
    """A box with the picture on every side, in two levels."""
    made = trimesh.creation.box((1, 1, 1)).subdivide()
    corners = made.vertices[made.faces].reshape(-1, 3)
    ahead = np.abs(made.face_normals).argmax(axis=1).repeat(3)
    u = np.where(ahead == 0, corners[:, 2], corners[:, 0])
    v = np.where(ahead == 1, corners[:, 2], -corners[:, 1])
    mesh = Mesh(0.4 * (corners + np.array([0, 0.5, 0])), np.arange(len(corners)).reshape(-1, 3))
    picture = quarters()
    packed = encode(picture) if encode else None
    asset = TexturedMesh(mesh, 0.5 + np.stack([u, v], axis=1), jpeg_of(picture, 88), SIDE, packed)
    glbs = {f"lod{level}.glb": to_glb(asset, "meshopt") for level in range(2)}
    return bundle_of("Cube", glbs, [len(mesh.faces)] * 2, (0.4, 0.4, 0.4))


@pytest.fixture(scope="module", autouse=True)
def published(site: Site, ktx2: Ktx2Encoder) -> None:  # noqa: F811
    """The same box twice: with its picture as JPEG, and as KTX2."""
    publish(cube(None), site.store, key="cube-jpeg")
    publish(cube(ktx2), site.store, key="cube-ktx2")


def shown(page: Page, address: str) -> bytes:
    """The thing at an address, once its levels are there."""
    page.goto(address)
    await_data(page, loaded="1 0")
    await_frames(page)
    return stage(page)


@pytest.mark.essential
def test_its_colours_are_those_of_the_jpeg_and_only_it_loads_what_unpacks_it(page: Page, site: Site) -> None:
    asked: list[str] = []
    said: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(message.text))
    as_jpeg = shown(page, f"{site.url}/view/cube-jpeg")
    assert [url for url in asked if url.endswith(UNPACKING)] == []
    beside = len(page.workers)
    as_ktx2 = shown(page, f"{site.url}/view/cube-ktx2")
    assert all(any(url.endswith(name) for url in asked) for name in UNPACKING)
    assert len(page.workers) > beside, "pictures are unpacked beside the page"
    assert min(places_of(as_jpeg, channel)[0] for channel in range(3)) > 0.03
    assert difference(as_jpeg, as_ktx2) < 0.02
    assert [text for text in said if "KTX2" in text or "Content Security Policy" in text] == []


HIDE = """(() => {
    const known = WebGL2RenderingContext.prototype.getExtension;
    WebGL2RenderingContext.prototype.getExtension = function (name) {
        return name.includes('%s') ? null : known.call(this, name);
    };
    const put = WebGL2RenderingContext.prototype.compressedTexSubImage2D;
    WebGL2RenderingContext.prototype.compressedTexSubImage2D = function (...told) {
        (window.formats ??= []).push(told[6]);
        return put.apply(this, told);
    };
})()"""


def test_a_card_that_knows_less_shows_the_same(page: Page, site: Site) -> None:
    """The browser of the test knows BC7, phones get ETC2, others BC1, or plain texels."""
    first = None
    for hidden, format_ in (("nothing", 0x8E8D), ("bptc", 0x9275), ("texture_etc", 0x8C4C), ("s3tc", None)):
        page.add_init_script(HIDE % hidden)  # and all that were hidden before
        seen = shown(page, f"{site.url}/view/cube-ktx2")
        assert set(page.evaluate("window.formats ?? []")) == ({format_} if format_ else set())
        assert difference(first or seen, seen) < 0.02
        first = first or seen


def test_a_transcoder_that_was_lost_on_the_way_is_fetched_again(page: Page, site: Site) -> None:
    page.clock.install()
    page.route("**/*.basis-transcoder.wasm", lambda route: route.abort(), times=1)
    with page.expect_event("requestfailed"):
        page.goto(f"{site.url}/view/cube-ktx2")
    page.clock.fast_forward(10_000)  # longer than until the page tries again
    await_data(page, loaded="1 0")
    assert places_of(stage(page), 0)[0] > 0.03


def test_a_transcoder_that_never_comes_or_never_answers_is_said(page: Page, site: Site) -> None:
    """A page asks for the transcoder before it starts its workers: that has come before they are missing."""
    line = line_to(site.url)
    page.clock.install()
    line.silence("basis-transcoder.wasm")
    page.goto(f"{line.url}/view/cube-ktx2")
    line.await_fault()
    page.clock.fast_forward(time_limit_ms("NETWORK_SILENCE_MS"))
    expect(page.locator("#said")).to_contain_text("The server does not answer")
    for script, silent in (
        (None, "ktx2-worker.js"),
        ("onmessage = () => importScripts('/nothing');", "/nothing"),
        ("throw new Error('broken');", None),
    ):
        line.mend()
        if script:
            line.change("ktx2-worker.js", lambda _, script=script: script)
        if silent:
            line.silence(silent)
        page.get_by_role("button", name="Try again").click()
        if silent:
            line.await_fault()
            page.clock.fast_forward(time_limit_ms("PICTURE_WORKER_MS"))
        expect(page.locator("#said")).to_contain_text("The 3D file was loaded, but this browser could not open it.")
    line.mend()
    page.get_by_role("button", name="Try again").click()
    await_data(page, loaded="1 0")
    assert places_of(stage(page), 0)[0] > 0.03


def test_one_visit_is_enough_for_the_next_to_need_no_server(browser: Browser, site: Site) -> None:
    line = line_to(site.url)
    address = f"{line.url}/view/cube-ktx2"
    with with_a_past(browser) as context:
        page = context.new_page()
        online = shown(page, address)
        await_data(page, offline="ready")
        line.cut()
        page.close()
        offline = shown(context.new_page(), address)
        assert drawn(offline) > 0.05
        assert difference(online, offline) < 0.02
