// Pictures that stay compressed on the graphics card (KTX2 by Basis Universal): workers transcode them into a format that this card knows.
// The transcoder is half a megabyte, and is loaded once a file needs it.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { fetchBytes } from '../shared/network.js';
import { offline, undecodable } from '../shared/problems.js';
import { PICTURE_WORKER_MS, withTimeLimit } from '../shared/time-limits.js';

/** @import { GLTFLoaderPlugin, GLTFParser } from '../vendor/three-0.187.0.gltf-loader.js' */
/** @import { Ktx2Answer, Ktx2Request, Mipmap } from './ktx2-messages.d.ts' */

const WORKERS = 2; // as for meshes
const EXTENSION = 'KHR_texture_basisu';
const WORKER = new URL('./ktx2-worker.js', import.meta.url);
const TRANSCODER = new URL('../vendor/three-0.187.0.basis-transcoder.wasm', import.meta.url);

// Formats of graphics cards, by their names in WebGL, the transcoder and three.js. BC7 comes first: drivers that offer both BC7 and ETC
// mostly decompress ETC themselves, into four times the memory.
const FORMATS = [
  { extension: 'EXT_texture_compression_bptc', format: 6, threeFormat: THREE.RGBA_BPTC_Format },
  { extension: 'WEBGL_compressed_texture_etc', format: 0, threeFormat: THREE.RGB_ETC2_Format },
  { extension: 'WEBGL_compressed_texture_s3tc_srgb', format: 2, threeFormat: THREE.RGB_S3TC_DXT1_Format },
];
const UNCOMPRESSED = { format: 13, threeFormat: THREE.RGBAFormat };

/** @type {Promise<Worker[]> | null} */
let workers = null; // of the page: all files go through them
let turn = 0;

/**
 * A plugin of GLTFLoader that transcodes such pictures for a renderer. A picture that cannot be transcoded is an error, not white.
 * @param {THREE.WebGLRenderer} renderer
 * @returns {(parser: GLTFParser) => GLTFLoaderPlugin}
 */
export function ktx2(renderer) {
  return (parser) => {
    /** @type {unknown} */
    let failure = null;
    return {
      name: 'capture2vr_ktx2',
      async beforeRoot() {
        if (!parser.json.extensionsUsed?.includes(EXTENSION)) return;
        workers ??= startWorkers();
        const pool = await workers;
        /** @type {(picture: ArrayBuffer, resolve: (texture: THREE.Texture) => void, reject: (error: unknown) => void) => void} */
        const parse = (picture, resolve, reject) => {
          transcode(pool, picture, renderer).then(resolve, (error) => reject((failure = error)));
        };
        Object.assign(parser.options, { ktx2Loader: { isKTX2Loader: true, parse } });
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

/**
 * @param {Worker[]} pool
 * @param {ArrayBuffer} picture a KTX2 file
 * @param {THREE.WebGLRenderer} renderer
 */
async function transcode(pool, picture, renderer) {
  const { format, threeFormat } = FORMATS.find(({ extension }) => renderer.extensions.has(extension)) ?? UNCOMPRESSED;
  const levels = await ask(pool[turn++ % pool.length], { picture, format }, [picture]);
  // three.js uploads uncompressed mipmaps by the same class, which its types do not say.
  const compressedFormat = /** @type {THREE.CompressedPixelFormat} */ (threeFormat);
  const texture = new THREE.CompressedTexture(levels, levels[0].width, levels[0].height, compressedFormat);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.needsUpdate = true;
  return texture;
}

/**
 * Send a message to a worker and wait for its answer.
 * @param {Worker} worker
 * @param {Ktx2Request} request
 * @param {Transferable[]} [transfer]
 * @returns {Promise<Mipmap[]>}
 * @throws {Error} what the worker says, or NOT_DECODED where it says nothing; then all workers are replaced
 */
function ask(worker, request, transfer = []) {
  const { port1, port2 } = new MessageChannel();
  /** @type {Promise<Mipmap[]>} */
  const reply = new Promise((resolve, reject) => {
    port1.onmessage = (event) => {
      const answer = /** @type {Ktx2Answer} */ (event.data);
      if ('error' in answer) reject(new Error(answer.error));
      else resolve(answer.levels);
    };
    worker.postMessage(request, [port2, ...transfer]);
  });
  return withTimeLimit(reply, PICTURE_WORKER_MS, () => {
    worker.terminate();
    workers = null;
    return undecodable();
  });
}
