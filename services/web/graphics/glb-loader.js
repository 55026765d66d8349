// From a file's bytes to something that can be drawn without holding up the page: meshes are unpacked by workers and pictures
// by the browser, the coarsest levels first, and the finer ones whenever the page has nothing else to do.
import { ktx2 } from './ktx2.js';
import { GLTFLoader } from '../vendor/three-0.187.0.gltf-loader.js';
import { Problem, undecodable } from '../shared/problems.js';
import { DECODE_MS, withTimeLimit } from '../shared/time-limits.js';
import { loadFile } from '../shared/verified-cache.js';
import { meshDecoder } from './mesh-decoder.js';

const AT_ONCE = 2; // one comes over the network while another is unpacked
const PATIENCE_MS = 200; // a page that draws all the time is never idle

const waiting = [];
let busy = 0;

/** What a catalogue's level ({url, sha256, file, level}) shows on a renderer, as a THREE.Group. Throws what loading throws. */
export function decoded(lod, renderer, { hurry = false } = {}) {
  return new Promise((resolve, reject) => {
    waiting.push({ lod, renderer, hurry, resolve, reject });
    waiting.sort((one, other) => other.hurry - one.hurry || other.lod.level - one.lod.level);
    next();
  });
}

async function next() {
  if (busy >= AT_ONCE || waiting.length === 0) return;
  busy += 1;
  const { lod, renderer, hurry, resolve, reject } = waiting.shift();
  try {
    const bytes = await loadFile(lod);
    if (!hurry) await idle();
    resolve(await decode(bytes, renderer));
  } catch (error) {
    reject(error);
  }
  busy -= 1;
  next();
}

/**
 * Decode a GLB file.
 * @param {ArrayBuffer} bytes
 * @param {import('../vendor/three-0.187.0.module.js').WebGLRenderer} renderer
 * @throws {Problem} NOT_DECODED, and what loading the KTX2 transcoder throws
 */
async function decode(bytes, renderer) {
  const loader = new GLTFLoader().setMeshoptDecoder(meshDecoder()).register(ktx2(renderer));
  try {
    return (await withTimeLimit(loader.parseAsync(bytes, ''), DECODE_MS)).scene;
  } catch (error) {
    console.error(error); // what the person reads says nothing of the file's faults
    throw error instanceof Problem ? error : undecodable();
  }
}

function idle() {
  const wait = window.requestIdleCallback || ((done) => setTimeout(done)); // Safari has none
  return new Promise((done) => wait(done, { timeout: PATIENCE_MS }));
}
