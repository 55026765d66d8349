// What the viewer's transcoder finds in a KTX2 file: `node decode.mjs TRANSCODER FILE OUT` writes the RGBA of all levels to OUT,
// the largest first, and their widths and heights to stdout as JSON.
import { readFile, writeFile } from 'node:fs/promises';
import { createRequire } from 'node:module';

const RGBA32 = 13; // of the transcoder's formats
const [transcoder, file, out] = process.argv.slice(2);
const basis = await createRequire(import.meta.url)(`${transcoder}.js`)({
  wasmBinary: await readFile(`${transcoder}.wasm`),
});
basis.initializeBasis();
const ktx2 = new basis.KTX2File(new Uint8Array(await readFile(file)));
if (!ktx2.isValid() || !ktx2.startTranscoding()) throw new Error('the transcoder refuses the file');

const sizes = [];
const levels = [];
for (let level = 0; level < ktx2.getLevels(); level++) {
  const { origWidth, origHeight } = ktx2.getImageLevelInfo(level, 0, 0);
  const rgba = new Uint8Array(ktx2.getImageTranscodedSizeInBytes(level, 0, 0, RGBA32));
  if (!ktx2.transcodeImage(rgba, level, 0, 0, RGBA32, 0, -1, -1)) {
    throw new Error(`level ${level} cannot be transcoded`);
  }
  sizes.push([origWidth, origHeight]);
  levels.push(rgba);
}
await writeFile(out, Buffer.concat(levels));
console.log(JSON.stringify({ sizes, alpha: Boolean(ktx2.getHasAlpha()), etc1s: ktx2.isETC1S() }));
