// Pictures that stay packed on the graphics card (KTX2 by Basis Universal): workers turn them into what this card knows. What they
// need is half a megabyte, and is loaded once a file asks for it.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { fetchBytes } from '../shared/network.js';
import { offline, undecodable } from '../shared/problems.js';
import { PICTURE_WORKER_MS, withTimeLimit } from '../shared/time-limits.js';

const WORKERS = 2; // as for meshes
const ASKED = 'KHR_texture_basisu';
const WORKER = new URL('./ktx2-worker.js', import.meta.url);
const TRANSCODER = new URL('../vendor/three-0.187.0.basis-transcoder.wasm', import.meta.url);

// What cards know, by WebGL's name, the transcoder's and three's. BC7 comes first: drivers that tell of it and of ETC too mostly
// unpack ETC themselves, into four times the memory.
const KINDS = [
  { known: 'EXT_texture_compression_bptc', kind: 6, format: THREE.RGBA_BPTC_Format },
  { known: 'WEBGL_compressed_texture_etc', kind: 0, format: THREE.RGB_ETC2_Format },
  { known: 'WEBGL_compressed_texture_s3tc_srgb', kind: 2, format: THREE.RGB_S3TC_DXT1_Format },
];
const UNPACKED = { kind: 13, format: THREE.RGBAFormat };

/** @type {Promise<Worker[]> | null} */
let workers = null; // of the page, whose files all go through them
let turn = 0;

/** A plugin of GLTFLoader that transcodes such pictures for a renderer. One that cannot be transcoded is an error, not white. */
export function ktx2(renderer) {
  return (parser) => {
    let failure = null;
    return {
      name: 'capture2vr_ktx2',
      async beforeRoot() {
        if (!parser.json.extensionsUsed?.includes(ASKED)) return;
        workers ??= startWorkers();
        const pool = await workers;
        const parse = (picture, resolve, reject) =>
          transcode(pool, picture, renderer).then(resolve, (error) => reject((failure = error)));
        parser.options.ktx2Loader = { isKTX2Loader: true, parse };
      },
      async afterRoot() {
        if (failure) throw failure;
      },
    };
  };
}

/**
 * Load the transcoder, compile it once for all workers, and start them.
 * @returns {Promise<Worker[]>}
 * @throws {Problem} OFFLINE, NO_ANSWER, NOT_DECODED; the next call tries again
 */
async function startWorkers() {
  try {
    const { response, bytes } = await fetchBytes(TRANSCODER);
    if (!response.ok) throw offline();
    const module = await withTimeLimit(WebAssembly.compile(bytes), PICTURE_WORKER_MS, undecodable);
    return await Promise.all(Array.from({ length: WORKERS }, () => startWorker(module)));
  } catch (error) {
    workers = null;
    throw error;
  }
}

/**
 * @param {WebAssembly.Module} module
 * @returns {Promise<Worker>}
 */
async function startWorker(module) {
  const worker = new Worker(WORKER);
  const broken = new Promise((_, reject) => (worker.onerror = () => reject(undecodable())));
  try {
    await Promise.race([ask(worker, { module }), broken]);
  } catch (error) {
    worker.terminate();
    throw error;
  }
  return worker;
}

async function transcode(pool, picture, renderer) {
  const { kind, format } = KINDS.find(({ known }) => renderer.extensions.has(known)) ?? UNPACKED;
  const { levels } = await ask(pool[turn++ % pool.length], { picture, kind }, [picture]);
  const texture = new THREE.CompressedTexture(levels, levels[0].width, levels[0].height, format);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.needsUpdate = true;
  return texture;
}

/**
 * Send a message to a worker and wait for its answer.
 * @param {Worker} worker
 * @param {object} message
 * @param {Transferable[]} [transfer]
 * @returns {Promise<any>}
 * @throws {Error} what the worker says, or NOT_DECODED where it says nothing; then all workers are replaced
 */
function ask(worker, message, transfer = []) {
  const { port1, port2 } = new MessageChannel();
  const reply = new Promise((resolve, reject) => {
    port1.onmessage = ({ data }) => (data.error ? reject(new Error(data.error)) : resolve(data));
    worker.postMessage(message, [port2, ...transfer]);
  });
  return withTimeLimit(reply, PICTURE_WORKER_MS, () => {
    worker.terminate();
    workers = null;
    return undecodable();
  });
}
