// Pictures that stay packed on the graphics card (KTX2 by Basis Universal): workers turn them into what this card knows. What they
// need is half a megabyte, and is loaded once a file asks for it.
import * as THREE from '../vendor/three-0.187.0.module.js';

const WORKERS = 2; // as for meshes
const ASKED = 'KHR_texture_basisu';
const WORKER = new URL('./ktx2-worker.js', import.meta.url);
const WRAPPER = new URL('../vendor/three-0.187.0.basis-transcoder.js', import.meta.url);
const TRANSCODER = new URL('../vendor/three-0.187.0.basis-transcoder.wasm', import.meta.url);

// What cards know, by WebGL's name, the transcoder's and three's. BC7 comes first: drivers that tell of it and of ETC too mostly
// unpack ETC themselves, into four times the memory.
const KINDS = [
  { known: 'EXT_texture_compression_bptc', kind: 6, format: THREE.RGBA_BPTC_Format },
  { known: 'WEBGL_compressed_texture_etc', kind: 0, format: THREE.RGB_ETC2_Format },
  { known: 'WEBGL_compressed_texture_s3tc_srgb', kind: 2, format: THREE.RGB_S3TC_DXT1_Format },
];
const UNPACKED = { kind: 13, format: THREE.RGBAFormat };

let crew = null; // of the page, whose files all go through it: resolves to workers that are ready
let turn = 0;

/** A plugin of GLTFLoader that unpacks such pictures for a renderer. One that cannot be unpacked is an error, not white. */
export function ktx2(renderer) {
  return (parser) => {
    let failed = null;
    return {
      name: 'capture2vr_ktx2',
      async beforeRoot() {
        if (!parser.json.extensionsUsed?.includes(ASKED)) return;
        crew ??= hired();
        const workers = await crew;
        const parse = (picture, resolve, reject) =>
          unpacked(workers, picture, renderer).then(resolve, (error) => reject((failed = error)));
        parser.options.ktx2Loader = { isKTX2Loader: true, parse };
      },
      async afterRoot() {
        if (failed) throw failed;
      },
    };
  };
}

async function hired() {
  try {
    // The page itself asks for all three files, though its workers need them: what it has loaded is kept for visits without
    // a server (register-service-worker.js). Compiled once, for all workers.
    const [module] = await Promise.all([WebAssembly.compileStreaming(fetch(TRANSCODER)), fetch(WRAPPER), fetch(WORKER)]);
    return await Promise.all(Array.from({ length: WORKERS }, () => started(module)));
  } catch (error) {
    crew = null; // the next try begins anew
    throw error;
  }
}

async function started(module) {
  const worker = new Worker(WORKER);
  const broken = new Promise((_, reject) => (worker.onerror = () => reject(new Error('What unpacks pictures did not start.'))));
  await Promise.race([told(worker, { module }), broken]);
  return worker;
}

async function unpacked(workers, picture, renderer) {
  const { kind, format } = KINDS.find(({ known }) => renderer.extensions.has(known)) ?? UNPACKED;
  const worker = workers[turn++ % workers.length];
  const { levels } = await told(worker, { picture, format: kind }, [picture]);
  const texture = new THREE.CompressedTexture(levels, levels[0].width, levels[0].height, format);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.needsUpdate = true;
  return texture;
}

/** A worker's answer. */
function told(worker, message, transfer = []) {
  const { port1, port2 } = new MessageChannel();
  return new Promise((resolve, reject) => {
    port1.onmessage = ({ data }) => (data.error ? reject(new Error(data.error)) : resolve(data));
    worker.postMessage(message, [port2, ...transfer]);
  });
}
