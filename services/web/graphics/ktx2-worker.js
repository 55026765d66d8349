// Web worker that transcodes KTX2 pictures into a format that the graphics card knows, with all their mipmaps. Basis Universal's
// wrapper makes functions from text (eval), which the page's security policy forbids; this file has a policy of its own, which
// allows just that.
importScripts('../vendor/three-0.187.0.basis-transcoder.js');

/** @typedef {import('./ktx2-messages.d.ts').Ktx2Request} Ktx2Request */
/** @typedef {import('./ktx2-messages.d.ts').Ktx2Answer} Ktx2Answer */
/** @typedef {import('./ktx2-messages.d.ts').Mipmap} Mipmap */

/** @type {BasisTranscoder | null} */
let transcoder = null;

addEventListener('message', async (event) => {
  const [port] = event.ports;
  const answer = await answerTo(event.data).catch(errorAnswer);
  port.postMessage(answer, 'levels' in answer ? answer.levels.map(({ data }) => data.buffer) : []);
});

/**
 * @param {Ktx2Request} request
 * @returns {Promise<Ktx2Answer>}
 */
async function answerTo(request) {
  if ('module' in request) {
    transcoder = await createTranscoder(request.module);
    return { levels: [] };
  }
  if (!transcoder) throw new Error('The transcoder was not sent yet.');
  return { levels: transcode(transcoder, request.picture, request.format) };
}

/**
 * @param {unknown} error
 * @returns {Ktx2Answer}
 */
function errorAnswer(error) {
  return { error: error instanceof Error ? error.message : String(error) };
}

/**
 * @param {WebAssembly.Module} module
 * @returns {Promise<BasisTranscoder>}
 */
async function createTranscoder(module) {
  const created = await BASIS({
    instantiateWasm(imports, done) {
      WebAssembly.instantiate(module, imports).then((instance) => done(instance, module));
      return {}; // it comes later
    },
  });
  created.initializeBasis();
  return created;
}

/**
 * Transcodes a picture.
 * @param {BasisTranscoder} basis
 * @param {ArrayBuffer} picture a KTX2 file
 * @param {number} format the transcoder's number of it
 * @returns {Mipmap[]} the largest first
 */
function transcode(basis, picture, format) {
  const file = new basis.KTX2File(new Uint8Array(picture));
  try {
    if (!file.isValid() || !file.startTranscoding()) throw new Error('A picture cannot be unpacked.');
    return Array.from({ length: file.getLevels() }, (_, level) => {
      const { origWidth: width, origHeight: height } = file.getImageLevelInfo(level, 0, 0);
      const data = new Uint8Array(file.getImageTranscodedSizeInBytes(level, 0, 0, format));
      if (!file.transcodeImage(data, level, 0, 0, format, 0, -1, -1)) throw new Error('A picture cannot be unpacked.');
      return { data, width, height };
    });
  } finally {
    file.close();
    file.delete();
  }
}
