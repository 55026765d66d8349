// The process that packs one picture as KTX2: `node ktx2_child.mjs PACKAGE FOLDER WIDTH HEIGHT` reads FOLDER/picture.rgba, rows
// of sRGB and alpha from the top, and writes FOLDER/picture.ktx2. Every failure is one line on stderr and status 1.
import { readFile, writeFile } from 'node:fs/promises';
import { pathToFileURL } from 'node:url';

const QUALITY = 255; // of 1 to 255
const EFFORT = 2; // of 0 to 6
const RAW = 0; // kind of a source: bytes as they are
const SPARE_BYTES = 65_536; // of the file's head; its levels take less than the source and a third

try {
  const [encoder, folder, width, height] = process.argv.slice(2);
  const { NodeBasisEncoder } = await import(pathToFileURL(`${encoder}/dist/node/index.js`));
  const { BasisEncoder } = await new NodeBasisEncoder().init();
  const picture = new Uint8Array(await readFile(`${folder}/picture.rgba`));
  await writeFile(`${folder}/picture.ktx2`, encoded(new BasisEncoder(), picture, Number(width), Number(height)));
} catch (error) {
  console.error(String(error?.message ?? error).replaceAll('\n', ' '));
  process.exit(1);
}

function encoded(encoder, picture, width, height) {
  encoder.setCreateKTX2File(true);
  encoder.setKTX2AndBasisSRGBTransferFunc(true);
  encoder.setPerceptual(true);
  encoder.setMipGen(true);
  encoder.setMipSRGB(true); // averaged as light
  encoder.setMipWrapping(false); // charts touch the edges, and what lies at the opposite one is another chart
  encoder.setUASTC(false);
  encoder.setQualityLevel(QUALITY);
  encoder.setETC1SCompressionLevel(EFFORT);
  if (!encoder.setSliceSourceImage(0, picture, width, height, RAW)) throw new Error(`it takes no picture of ${width} × ${height}`);
  const out = new Uint8Array(2 * picture.length + SPARE_BYTES);
  const length = encoder.encode(out);
  if (length === 0) throw new Error('it made nothing of the picture');
  return out.subarray(0, length);
}
