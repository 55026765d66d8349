"""Pictures reach the graphics card in strips, and look as if they had come at once."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Page

from tests.support.sites import Site

pytestmark = pytest.mark.browser

_STRIP_BYTES = 1 << 20

# Draws a picture of stripes from a card that got it by `uploadTexture` and from one that got it whole: once pixel by
# pixel, and once shrunk to an eighth, where only mips show. Tells the bytes of each strip, how many bytes of the two
# drawings differ, and how many colours they have.
_DRAWN = """async ([width, height, lost]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { uploadTexture } = await import('/web/graphics/gpu-warmup.js');
    const soon = (ms = 0) => new Promise((done) => setTimeout(done, ms));
    const paper = new OffscreenCanvas(width, height);
    const pen = paper.getContext('2d');
    for (let row = 0; row < height; row += 8) {
        pen.fillStyle = `hsl(${(row * 37) % 360} 80% ${20 + (row * 13) % 60}%)`;
        pen.fillRect(0, row, width, 8);
        pen.fillStyle = `hsl(${(row * 91) % 360} 80% 50%)`;
        pen.fillRect((row * 53) % width, row, width / 5, 4);
    }

    async function shown(give) {
        const canvas = new OffscreenCanvas(width, height);
        const renderer = new THREE.WebGLRenderer({ canvas, preserveDrawingBuffer: true });
        const gl = renderer.getContext();
        const image = await createImageBitmap(paper, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
        const texture = new THREE.Texture(image);
        texture.flipY = false;
        texture.colorSpace = THREE.SRGBColorSpace;
        texture.minFilter = THREE.LinearMipmapLinearFilter;
        texture.needsUpdate = true;
        const strips = [];
        const put = gl.texSubImage2D.bind(gl);
        gl.texSubImage2D = (...told) => {
            strips.push(4 * told.at(-1).width * told.at(-1).height);
            put(...told);
        };
        await give(renderer, texture);
        gl.texSubImage2D = put;
        if (lost) {
            const back = new Promise((done) => canvas.addEventListener('webglcontextrestored', done));
            const losing = gl.getExtension('WEBGL_lose_context');
            losing.loseContext();
            await soon(50);
            losing.restoreContext();
            await back;
            await soon();
        }
        const plane = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), new THREE.MeshBasicMaterial({ map: texture }));
        const scene = new THREE.Scene().add(plane);
        const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -1, 1);
        const pixels = [1, 1 / 8].map((scale) => {
            plane.scale.setScalar(scale);
            renderer.render(scene, camera);
            const drawn = new Uint32Array(width * height);
            gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(drawn.buffer));
            return drawn;
        });
        renderer.dispose();
        return { strips, pixels };
    }

    const strips = await shown(uploadTexture);
    const whole = await shown((renderer, texture) => renderer.initTexture(texture));
    const other = (place) => (pixel, at) => pixel !== whole.pixels[place][at];
    const differ = strips.pixels.map((drawn, place) => drawn.filter(other(place)).length);
    return { strips: strips.strips, differ, colours: strips.pixels.map((drawn) => new Set(drawn).size) };
}"""


@pytest.mark.parametrize(("width", "height"), [(1024, 700), (512, 64)], ids=["several strips", "small enough"])
@pytest.mark.parametrize("lost", [False, True], ids=["as it comes", "after the card lost everything"])
def test_strips_look_like_the_whole(page: Page, site: Site, width: int, height: int, lost: bool) -> None:
    page.goto(f"{site.url}/browse/default")
    told: dict[str, Any] = page.evaluate(_DRAWN, [width, height, lost])
    assert sum(told["strips"]) == 4 * width * height
    assert max(told["strips"]) <= _STRIP_BYTES
    assert len(told["strips"]) == -(-4 * width * height // _STRIP_BYTES)
    assert told["differ"] == [0, 0]
    assert min(told["colours"]) > 10, "nothing is drawn"
