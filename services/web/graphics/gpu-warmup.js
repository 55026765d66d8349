// Prepares the graphics card for a model before it is drawn, so that no frame has to wait: compiles shaders, uploads textures.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { materialsOf, texturesOf } from './scene.js';
import { SHADER_MS, withTimeLimit } from '../shared/time-limits.js';

/** @import { Stage } from './scene.js' */

const FENCE_MS = 2000; // a card that is not ready by then is drawn on all the same
const FENCE_POLL_MS = 8;
const STRIP_BYTES = 1 << 20; // of a picture, uploaded at once: all of 2048² texels hold the page up for 80 ms
/** @type {ImageBitmapOptions} */
const BITMAP = { premultiplyAlpha: 'none', colorSpaceConversion: 'none' }; // as glTF has its texels, and as GLTFLoader decodes them

/**
 * Compile the shaders of an object and upload its textures. Resolves once the card has them.
 * @param {Stage} stage
 * @param {THREE.Object3D} object
 */
export async function prepare({ renderer, scene, camera }, object) {
  const gl = /** @type {WebGL2RenderingContext} */ (renderer.getContext()); // three.js makes no other
  await gpuDone(gl); // a question to the card waits for all work that it was given before
  await withTimeLimit(renderer.compileAsync(object, camera, scene), SHADER_MS).catch(() => {}); // then the first frame waits for them
  for (const texture of allTextures(object)) await uploadTexture(renderer, texture);
  await gpuDone(gl);
}

/**
 * All textures of an object and all below it, each once.
 * @param {THREE.Object3D} object
 */
function allTextures(object) {
  /** @type {Set<THREE.Texture>} */
  const textures = new Set();
  object.traverse((node) =>
    materialsOf(node)
      .flatMap(texturesOf)
      .forEach((texture) => textures.add(texture)),
  );
  return textures;
}

/**
 * Upload a decoded picture strip by strip, with time between them for whatever else the page has to do.
 * @param {THREE.WebGLRenderer} renderer
 * @param {THREE.Texture} texture
 */
export async function uploadTexture(renderer, texture) {
  const { image, source, generateMipmaps } = texture;
  const bitmap = image instanceof ImageBitmap ? image : null;
  const rows = bitmap ? Math.max(1, Math.floor(STRIP_BYTES / (4 * bitmap.width))) : 0;
  if (!bitmap || texture.flipY || bitmap.height <= rows) {
    renderer.initTexture(texture);
    return;
  }
  source.dataReady = false; // the card makes room, and gets nothing yet
  renderer.initTexture(texture);
  for (let top = 0; top < bitmap.height; top += rows) {
    await pause();
    const strip = await createImageBitmap(bitmap, 0, top, bitmap.width, Math.min(rows, bitmap.height - top), BITMAP);
    texture.generateMipmaps = generateMipmaps && top + rows >= bitmap.height; // once all of it is there
    renderer.copyTextureToTexture(new THREE.Texture(strip), texture, null, new THREE.Vector2(0, top));
    strip.close();
  }
  source.dataReady = true; // a card that lost everything gets it whole
}

/**
 * Wait until the card has done its work so far. Not every browser says when a shader is ready, but all of them say this.
 * @param {WebGL2RenderingContext} gl
 */
async function gpuDone(gl) {
  const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  gl.flush();
  const until = performance.now() + FENCE_MS;
  const isBusy = () => fence && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED;
  while (isBusy() && performance.now() < until) await pause(FENCE_POLL_MS);
  gl.deleteSync(fence);
}

/** Let the browser do other work. */
export const pause = (ms = 0) => new Promise((resolve) => setTimeout(resolve, ms));
