// Child process that encodes one image as KTX2: `node ktx2_child.mjs PACKAGE FOLDER WIDTH HEIGHT` reads FOLDER/picture.rgba,
// rows of sRGB and alpha from the top, and writes FOLDER/picture.ktx2. A failure is one line on stderr and exit status 1.
import { readFile, writeFile } from 'node:fs/promises';
import { pathToFileURL } from 'node:url';

const QUALITY = 255; // 1 to 255, the best
const EFFORT = 2; // 0 to 6
const RAW = 0; // type of the source: raw bytes
const SPARE_BYTES = 65_536; // for the file's header; its levels take less than the source and a third

try {
  const [encoder, folder, width, height] = process.argv.slice(2);
  const { NodeBasisEncoder } = await import(pathToFileURL(`${encoder}/dist/node/index.js`));
  const { BasisEncoder } = await new NodeBasisEncoder().init();
  const picture = new Uint8Array(await readFile(`${folder}/picture.rgba`));
  await writeFile(`${folder}/picture.ktx2`, encode(new BasisEncoder(), picture, Number(width), Number(height)));
} catch (error) {
  console.error(String(error?.message ?? error).replaceAll('\n', ' '));
  process.exit(1);
}

/** Encode raw RGBA bytes with all mips as KTX2 (ETC1S). */
function encode(encoder, picture, width, height) {
  encoder.setCreateKTX2File(true);
  encoder.setKTX2AndBasisSRGBTransferFunc(true);
  encoder.setPerceptual(true);
  encoder.setMipGen(true);
  encoder.setMipSRGB(true); // mips are averages of linear light
  encoder.setMipWrapping(false); // charts touch the edges, and at the opposite edge is another chart
  encoder.setUASTC(false);
  encoder.setQualityLevel(QUALITY);
  encoder.setETC1SCompressionLevel(EFFORT);
  if (!encoder.setSliceSourceImage(0, picture, width, height, RAW)) {
    throw new Error(`it refused an image of ${width} × ${height}`);
  }
  const out = new Uint8Array(2 * picture.length + SPARE_BYTES);
  const length = encoder.encode(out);
  if (length === 0) throw new Error('it returned no data for the image');
  return out.subarray(0, length);
}
