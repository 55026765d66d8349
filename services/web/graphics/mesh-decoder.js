// Decodes meshes (meshopt) in workers, and on the page itself where the workers do not start, fail or never answer.
import { MeshoptDecoder } from '../vendor/three-0.187.0.meshopt-decoder.js';
import { MESH_WORKER_MS, withTimeLimit } from '../shared/time-limits.js';

const WORKERS = 2; // a headset has few cores to spare

let started = false;

/** The decoder for GLTFLoader. Its workers start with the first call: starting them earlier would hold up a page that is being built. */
export function meshDecoder() {
  if (!started && MeshoptDecoder.supported) startWorkers();
  started = true;
  return { ...MeshoptDecoder, decodeGltfBufferAsync };
}

/** Start the workers that decode meshes. */
function startWorkers() {
  try {
    MeshoptDecoder.useWorkers(WORKERS);
  } catch {
    // A browser that starts no worker here: without them the decoder works on the page.
  }
}

/**
 * Decode a buffer of a file, as MeshoptDecoder.decodeGltfBufferAsync does.
 * @param {number} count
 * @param {number} size bytes of each of `count` elements
 * @param {Uint8Array} source
 * @param {string} mode
 * @param {string} [filter]
 * @returns {Promise<Uint8Array>}
 */
async function decodeGltfBufferAsync(count, size, source, mode, filter) {
  try {
    return await withTimeLimit(MeshoptDecoder.decodeGltfBufferAsync(count, size, source, mode, filter), MESH_WORKER_MS);
  } catch (error) {
    if (!(error instanceof DOMException)) throw error; // the file is broken, whoever decodes it
    MeshoptDecoder.useWorkers(0); // they have shown that they do not answer; without them the decoder works on the page
    return MeshoptDecoder.decodeGltfBufferAsync(count, size, source, mode, filter);
  }
}
