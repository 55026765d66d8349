// Measures the quality of a photo on a small copy of it: sharpness, darkness, overexposure, and a hash that finds copies. The
// measures and limits are those of the worker, which leaves out what the page warns of (services/edge/cameras/screening.py);
// overexposure alone is measured only here.

const LONGEST = 480; // pixels of the copy that is measured
const THUMBNAIL = 96; // pixels of the picture in the list
const [CELLS_ACROSS, CELLS_DOWN] = [72, 54]; // cells in which photos are compared: artefacts of JPEG average out
const BLUR_PX = 4; // 1 sigma of the blur that sharpness is measured against
const FLAT = 0.1; // (grey steps per pixel)² left after that blur: a bare wall, which cannot be sharp
const TURN_MS = 10; // of computing without a pause, for browsers in which this runs on the page's own thread
/** @type {Pair[]} */
const DIRECTIONS = [
  [0, 1],
  [1, 0],
  [1, 1],
  [1, -1],
]; // [down, across] in pixels: motion blur takes detail away in one of them
const DARK = [16, 40]; // luma: the median and the 95th percentile of a photo that is almost black
const WHITE = 245; // luma that has hardly any detail; JPEG varies around pure white
const COPY_BITS = 8; // of the 64 in the hash that may differ in a copy
const COPY_DIFFERENCE = 0.08; // mean difference over the standard deviation; 2 degrees around the object make 0.25

/** @typedef {[number, number]} Pair */

/**
 * @typedef {object} PhotoMeasures
 * @property {boolean} dark almost black
 * @property {number} white share of the pixels that are plain white
 * @property {Float32Array} cells luma of CELLS_ACROSS by CELLS_DOWN cells
 * @property {number} deviation standard deviation of `cells`
 * @property {number[]} hash 8 bytes of a difference hash
 * @property {number[] | null} sharpness one number for each of DIRECTIONS; null for a bare wall
 */

/** @typedef {PhotoMeasures & { thumbnail: Blob }} PhotoQuality */

/** @typedef {{ number: number, file: Blob }} PhotoRequest message to the worker; its answer has the same number */
/** @typedef {{ number: number, quality: PhotoQuality | null }} PhotoAnswer null: the browser cannot decode the photo */

/** @typedef {Pick<OffscreenCanvasRenderingContext2D, 'drawImage' | 'getImageData' | 'imageSmoothingQuality'>} CanvasContext */

/**
 * A canvas of a page or of a worker: the first has `toBlob`, the second `convertToBlob`.
 * @typedef {object} Canvas
 * @property {number} width
 * @property {number} height
 * @property {(kind: '2d', options?: { willReadFrequently: boolean }) => CanvasContext | null} getContext
 * @property {(callback: (blob: Blob | null) => void, type: string, quality: number) => void} [toBlob]
 * @property {(options: { type: string, quality: number }) => Promise<Blob>} [convertToBlob]
 */

/** @typedef {(width: number, height: number) => Canvas} CanvasFactory */

/**
 * Measures a photo and makes its thumbnail. Rejects for a file that the browser cannot decode.
 * @param {Blob} file
 * @param {CanvasFactory} createCanvas
 * @returns {Promise<PhotoQuality>}
 */
export async function measurePhoto(file, createCanvas) {
  const bitmap = await decodeSmall(file);
  const { canvas, context } = draw(bitmap, LONGEST, createCanvas);
  const { canvas: thumbnail } = draw(bitmap, THUMBNAIL, createCanvas);
  bitmap.close();
  const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
  return { ...(await measure(pixels)), thumbnail: await toJpeg(thumbnail) };
}

/**
 * Decodes a photo and scales it down. The browser does so on another thread; it knows the size only once it has decoded.
 * @param {Blob} file
 */
async function decodeSmall(file) {
  const whole = await createImageBitmap(file);
  const [width, height] = scaledSize(whole, LONGEST);
  whole.close();
  return createImageBitmap(file, { resizeWidth: width, resizeHeight: height, resizeQuality: 'high' });
}

/**
 * Width and height of a picture scaled down to at most `longest` pixels.
 * @param {{ width: number, height: number }} picture
 * @param {number} longest
 * @returns {Pair}
 */
function scaledSize({ width, height }, longest) {
  const share = Math.min(1, longest / Math.max(width, height));
  return [Math.max(1, Math.round(width * share)), Math.max(1, Math.round(height * share))];
}

/**
 * Draws a picture on a new canvas, scaled down.
 * @param {ImageBitmap} bitmap
 * @param {number} longest
 * @param {CanvasFactory} createCanvas
 */
function draw(bitmap, longest, createCanvas) {
  const canvas = createCanvas(...scaledSize(bitmap, longest));
  const context = canvas.getContext('2d', { willReadFrequently: true });
  if (!context) throw new Error('This browser cannot draw on a canvas.');
  context.imageSmoothingQuality = 'high';
  context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  return { canvas, context };
}

/**
 * Encodes a canvas as JPEG.
 * @param {Canvas} canvas
 * @returns {Promise<Blob>}
 */
function toJpeg(canvas) {
  if (canvas.convertToBlob) return canvas.convertToBlob({ type: 'image/jpeg', quality: 0.7 });
  return new Promise((resolve, reject) => {
    canvas.toBlob?.(
      (blob) => (blob ? resolve(blob) : reject(new Error('This browser cannot encode a JPEG.'))),
      'image/jpeg',
      0.7,
    );
  });
}

/**
 * Measures RGBA pixels.
 * @param {ImageData} pixels
 * @returns {Promise<PhotoMeasures>}
 */
async function measure({ data, width, height }) {
  const luma = lumaOf(data);
  const cells = averageCells(luma, width, height, CELLS_ACROSS, CELLS_DOWN);
  const histogram = histogramOf(luma);
  const dark = percentile(histogram, 0.5) < DARK[0] && percentile(histogram, 0.95) < DARK[1];
  const white = histogram.slice(WHITE).reduce((sum, share) => sum + share, 0);
  const hash = differenceHash(luma, width, height);
  await pause();
  const smooth = await blur(luma, width, height);
  await pause();
  return {
    dark,
    white,
    cells,
    deviation: standardDeviation(cells),
    hash,
    sharpness: sharpnessOf(luma, smooth, width, height),
  };
}

/** Lets the browser do other work. */
const pause = () => new Promise((resolve) => setTimeout(resolve));

/**
 * Converts RGBA bytes to luma, 0 to 255.
 * @param {Uint8ClampedArray} rgba
 */
export function lumaOf(rgba) {
  const luma = new Float32Array(rgba.length / 4);
  for (let at = 0; at < luma.length; at++) {
    luma[at] = 0.299 * rgba[4 * at] + 0.587 * rgba[4 * at + 1] + 0.114 * rgba[4 * at + 2];
  }
  return luma;
}

/**
 * Shares of the pixels that have each of the 256 tones.
 * @param {Float32Array} luma
 */
function histogramOf(luma) {
  const tones = new Float64Array(256);
  for (const value of luma) tones[Math.floor(value)] += 1 / luma.length;
  return tones;
}

/**
 * The tone below which this share of the pixels lies.
 * @param {Float64Array} histogram
 * @param {number} share
 */
function percentile(histogram, share) {
  let sum = 0;
  return histogram.findIndex((part) => (sum += part) >= share);
}

/**
 * Means of a grid of cells. Cells of a picture that is smaller than the grid repeat its pixels.
 * @param {Float32Array} luma
 * @param {number} width
 * @param {number} height
 * @param {number} across number of columns
 * @param {number} down number of rows
 */
function averageCells(luma, width, height, across, down) {
  const cells = new Float32Array(across * down);
  for (let row = 0; row < down; row++) {
    const [top, bottom] = cellRange(row, down, height);
    for (let column = 0; column < across; column++) {
      const [left, right] = cellRange(column, across, width);
      let sum = 0;
      for (let y = top; y < bottom; y++) for (let x = left; x < right; x++) sum += luma[y * width + x];
      cells[row * across + column] = sum / ((bottom - top) * (right - left));
    }
  }
  return cells;
}

/**
 * First pixel of a cell, and the one behind its last.
 * @param {number} cell
 * @param {number} cells how many there are in the row or column
 * @param {number} length pixels of the row or column
 * @returns {Pair}
 */
function cellRange(cell, cells, length) {
  const first = Math.floor((cell * length) / cells);
  return [first, Math.max(first + 1, Math.floor(((cell + 1) * length) / cells))];
}

/** @param {Float32Array} values */
function standardDeviation(values) {
  const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
  return Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / values.length);
}

/**
 * Difference hash (dHash): whether each cell is lighter than its left neighbour, for 8 rows of 9 cells, a byte for each row.
 * @param {Float32Array} luma
 * @param {number} width
 * @param {number} height
 */
function differenceHash(luma, width, height) {
  const cells = averageCells(luma, width, height, 9, 8);
  return Array.from({ length: 8 }, (_, row) => {
    let bits = 0;
    for (let column = 0; column < 8; column++) {
      bits = (bits << 1) | Number(cells[row * 9 + column + 1] > cells[row * 9 + column]);
    }
    return bits;
  });
}

/**
 * Gaussian blur of BLUR_PX: rows, then columns. Outside the picture its border is repeated.
 * @param {Float32Array} luma
 * @param {number} width
 * @param {number} height
 */
async function blur(luma, width, height) {
  const reach = 3 * BLUR_PX;
  const weights = Array.from({ length: 2 * reach + 1 }, (_, place) =>
    Math.exp(-((place - reach) ** 2) / (2 * BLUR_PX ** 2)),
  );
  const sum = weights.reduce((total, weight) => total + weight, 0);
  const kernel = Float32Array.from(weights, (weight) => weight / sum);
  const rows = await convolve(luma, { length: width, lines: height, along: 1, between: width }, kernel);
  return convolve(rows, { length: height, lines: width, along: width, between: 1 }, kernel);
}

/**
 * Convolves all rows, or all columns, with a kernel.
 * @param {Float32Array} source
 * @param {{ length: number, lines: number, along: number, between: number }} layout of the rows or columns: pixels of one, how
 *   many there are, and how far apart in `source` two neighbouring pixels of one are, and two of them
 * @param {Float32Array} kernel
 */
async function convolve(source, { length, lines, along, between }, kernel) {
  const result = new Float32Array(source.length);
  const reach = (kernel.length - 1) / 2;
  let began = performance.now();
  for (let line = 0; line < lines; line++) {
    if (performance.now() - began > TURN_MS) {
      await pause();
      began = performance.now();
    }
    for (let place = 0; place < length; place++) {
      let value = 0;
      for (let tap = -reach; tap <= reach; tap++) {
        const other = Math.min(length - 1, Math.max(0, place + tap));
        value += kernel[tap + reach] * source[line * between + other * along];
      }
      result[line * between + place * along] = value;
    }
  }
  return result;
}

/**
 * Sharpness in each direction: detail of the picture over what a wide blur leaves of it. Null for a bare wall.
 * @param {Float32Array} luma
 * @param {Float32Array} smooth the same, blurred
 * @param {number} width
 * @param {number} height
 */
function sharpnessOf(luma, smooth, width, height) {
  const [sharp, rest] = [gradients(luma, width, height), gradients(smooth, width, height)];
  return Math.min(...rest) > FLAT ? sharp.map((value, place) => value / rest[place]) : null;
}

/**
 * Mean squared difference between neighbouring pixels, for each of DIRECTIONS.
 * @param {Float32Array} luma
 * @param {number} width
 * @param {number} height
 */
function gradients(luma, width, height) {
  return DIRECTIONS.map(([down, across]) => {
    let sum = 0;
    for (let y = 1; y < height - 1; y++) {
      for (let x = 1; x < width - 1; x++) sum += (luma[(y + down) * width + x + across] - luma[y * width + x]) ** 2;
    }
    return sum / Math.max(1, (width - 2) * (height - 2));
  });
}

/**
 * How much two photos differ: 0 for the same, above 1 for two that have nothing in common.
 * @param {PhotoMeasures} one
 * @param {PhotoMeasures} other
 */
export function differenceOf(one, other) {
  let sum = 0;
  for (let at = 0; at < one.cells.length; at++) sum += Math.abs(one.cells[at] - other.cells[at]);
  return sum / one.cells.length / Math.max(1, other.deviation);
}

/**
 * Whether two photos are copies of each other.
 * @param {PhotoMeasures} one
 * @param {PhotoMeasures} other
 * @param {number} difference of the two
 */
export function isCopy(one, other, difference) {
  return (
    difference <= COPY_DIFFERENCE &&
    one.hash.reduce((count, byte, row) => count + bitCount(byte ^ other.hash[row]), 0) <= COPY_BITS
  );
}

/** @param {number} byte */
function bitCount(byte) {
  let count = 0;
  for (let rest = byte; rest; rest &= rest - 1) count++;
  return count;
}
