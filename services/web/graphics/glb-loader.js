// Loads GLB files without holding up the page: meshes are decoded by workers and pictures by the browser, the coarsest levels first, and
// the finer ones whenever the page has nothing else to do.
import { GLTFLoader } from '../vendor/three-0.187.0.gltf-loader.js';
import { ktx2 } from './ktx2.js';
import { meshDecoder } from './mesh-decoder.js';
import { surfaceLook } from './surface-look.js';
import { loadFile } from '../catalogue/verified-cache.js';
import { Problem, undecodable } from '../shared/problems.js';
import { DECODE_MS, withTimeLimit } from '../shared/time-limits.js';

/** @import { Group, WebGLRenderer } from '../vendor/three-0.187.0.module.js' */
/** @import { LodFile } from '../shared/types.d.ts' */

/**
 * A level of detail that waits to be loaded.
 * @typedef {object} Request
 * @property {LodFile} lod
 * @property {WebGLRenderer} renderer
 * @property {boolean} urgent before all others, and without waiting for the page to be idle
 * @property {(level: Group) => void} resolve
 * @property {(error: unknown) => void} reject
 */

const AT_ONCE = 2; // one comes over the network while another is decoded
const IDLE_MS = 200; // a page that draws all the time is never idle

/** @type {Request[]} */
const queue = [];
let running = 0;

/**
 * Load a level of detail.
 * @param {LodFile} lod
 * @param {WebGLRenderer} renderer that will draw it
 * @param {{ urgent?: boolean }} [options]
 * @returns {Promise<Group>}
 * @throws {Problem} NOT_DECODED, and what loading throws
 */
export function loadLevel(lod, renderer, { urgent = false } = {}) {
  return new Promise((resolve, reject) => {
    queue.push({ lod, renderer, urgent, resolve, reject });
    queue.sort((one, other) => Number(other.urgent) - Number(one.urgent) || other.lod.level - one.lod.level);
    loadNext();
  });
}

/** Load the next level of the queue, unless enough are being loaded. */
async function loadNext() {
  if (running >= AT_ONCE) return;
  const request = queue.shift();
  if (!request) return;
  const { lod, renderer, urgent, resolve, reject } = request;
  running += 1;
  try {
    const bytes = await loadFile(lod);
    if (!urgent) await idle();
    resolve(await decode(bytes, renderer));
  } catch (error) {
    reject(error);
  }
  running -= 1;
  loadNext();
}

/**
 * Create a loader that knows the extensions of the assets' files.
 * @param {WebGLRenderer} renderer
 */
export function createGlbLoader(renderer) {
  return new GLTFLoader().setMeshoptDecoder(meshDecoder()).register(ktx2(renderer)).register(surfaceLook);
}

/**
 * Decode a GLB file.
 * @param {ArrayBuffer} bytes
 * @param {WebGLRenderer} renderer
 * @returns {Promise<Group>}
 * @throws {Problem} NOT_DECODED, and what loading the KTX2 transcoder throws
 */
async function decode(bytes, renderer) {
  try {
    return (await withTimeLimit(createGlbLoader(renderer).parseAsync(bytes, ''), DECODE_MS)).scene;
  } catch (error) {
    console.error(error); // what the person reads says nothing of the file's faults
    throw error instanceof Problem ? error : undecodable();
  }
}

/**
 * Wait until the page has nothing else to do.
 * @returns {Promise<unknown>}
 */
function idle() {
  return new Promise((resolve) => {
    if ('requestIdleCallback' in window) window.requestIdleCallback(resolve, { timeout: IDLE_MS });
    else setTimeout(resolve); // Safari
  });
}
