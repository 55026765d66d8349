// Getting the graphics card ready for something before it is drawn, so that no frame has to wait for it.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { SHADER_MS, withTimeLimit } from '../shared/time-limits.js';

const FENCE_MS = 2000; // a card that has not come by then is drawn on all the same
const FENCE_POLL_MS = 8;
const STRIP_BYTES = 1 << 20; // of a picture handed over at once: 2048² texels at once hold the page up for 80 ms
const BITMAP = { premultiplyAlpha: 'none', colorSpaceConversion: 'none' }; // as glTF has its texels, and as GLTFLoader decodes them

/** Compile the shaders of a group and hand its pictures over; resolves once the card has them. */
export async function prepare({ renderer, scene, camera }, group) {
  const gl = renderer.getContext();
  await passed(gl); // whatever asks the card for anything waits for all it was told before
  await withTimeLimit(renderer.compileAsync(group, camera, scene), SHADER_MS).catch(() => {}); // then the first frame waits for them
  for (const texture of texturesOf(group)) await handOver(renderer, texture);
  await passed(gl);
}

function texturesOf(group) {
  const found = new Set();
  group.traverse((node) => {
    for (const material of [node.material ?? []].flat()) {
      for (const value of Object.values(material)) if (value?.isTexture) found.add(value);
    }
  });
  return found;
}

/** A decoded picture goes to the card strip by strip, with room between them for whatever else the page has to do. */
export async function handOver(renderer, texture) {
  const { image, source, generateMipmaps } = texture;
  const rows = Math.max(1, Math.floor(STRIP_BYTES / (4 * image.width)));
  if (!(image instanceof ImageBitmap) || texture.flipY || image.height <= rows) {
    renderer.initTexture(texture);
    return;
  }
  source.dataReady = false; // the card makes room, and gets nothing yet
  renderer.initTexture(texture);
  for (let top = 0; top < image.height; top += rows) {
    await breath();
    const strip = await createImageBitmap(image, 0, top, image.width, Math.min(rows, image.height - top), BITMAP);
    texture.generateMipmaps = generateMipmaps && top + rows >= image.height; // once all of it is there
    renderer.copyTextureToTexture(new THREE.Texture(strip), texture, null, new THREE.Vector2(0, top));
    strip.close();
  }
  source.dataReady = true; // a card that lost everything gets it whole
}

/** Until the card has done what it was told so far. Not every browser says when a shader is ready, but all of them this. */
async function passed(gl) {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  const until = performance.now() + FENCE_MS;
  const ahead = () => fence && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED;
  while (ahead() && performance.now() < until) await breath(FENCE_POLL_MS);
  gl.deleteSync(fence);
}

/** Let the page do what else is waiting. */
export const breath = (ms = 0) => new Promise((resolve) => setTimeout(resolve, ms));
