// From a file's bytes to something that can be drawn without holding up the page: meshes are unpacked by workers and pictures
// by the browser, the coarsest levels first, and the finer ones whenever the page has nothing else to do.
import { ktx2 } from './ktx2.js';
import { GLTFLoader } from '../vendor/three-0.187.0.gltf-loader.js';
import { MeshoptDecoder } from '../vendor/three-0.187.0.meshopt-decoder.js';
import { bytesOf } from '../shared/verified-cache.js';

const WORKERS = 2; // a headset has few cores to spare
const AT_ONCE = 2; // one comes over the network while another is unpacked
const PATIENCE_MS = 200; // a page that draws all the time is never idle

const waiting = [];
let busy = 0;
let hired = false;

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
    hire();
    const bytes = await bytesOf(lod);
    if (!hurry) await idle();
    const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).register(ktx2(renderer));
    resolve((await loader.parseAsync(bytes, '')).scene);
  } catch (error) {
    reject(error);
  }
  busy -= 1;
  next();
}

/** The workers, when there is something to unpack: starting them would hold up a page that begins. */
function hire() {
  if (!hired && MeshoptDecoder.supported) MeshoptDecoder.useWorkers(WORKERS);
  hired = true;
}

function idle() {
  const wait = window.requestIdleCallback || ((done) => setTimeout(done)); // Safari has none
  return new Promise((done) => wait(done, { timeout: PATIENCE_MS }));
}
