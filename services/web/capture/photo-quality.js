// What a photo is worth, seen on a small copy of it. The measures and limits are those of the worker, which leaves out
// what the page warns of (services/edge/photos/screening.py); only too much light is judged here alone.

const LONGEST = 480; // pixels of the copy that is judged
const THUMBNAIL = 96; // pixels of the picture in the list
const [ACROSS, DOWN] = [72, 54]; // pixels in which photos are compared: another JPEG's damage averages out
const COARSE_PX = 4; // 1 sigma of the blur that sharpness is measured against
const NOTHING = 0.1; // (grey steps per pixel)² left after that blur: a wall, which cannot be sharp
const PIECE_MS = 10; // of computing at once, for browsers in which this runs beside the page
const STEPS = [[0, 1], [1, 0], [1, 1], [1, -1]]; // a smear takes fine detail away in one direction only
const DARK = [16, 40]; // luma: the middle tone and the light ones of a photo that is almost black
const WHITE = 245; // luma that holds hardly any detail; JPEG ripples around pure white
const COPY_BITS = 8; // of the 64 in the hash that may differ in a copy
const COPY_CHANGE = 0.08; // mean difference over its standard deviation: 2 degrees on make 0.25

/** Measures and a thumbnail of a file; rejects what the browser cannot decode. `makeCanvas(width, height)`. */
export async function lookAt(file, makeCanvas) {
  const bitmap = await shrunk(file);
  const small = drawn(bitmap, LONGEST, makeCanvas);
  const tiny = drawn(bitmap, THUMBNAIL, makeCanvas);
  bitmap.close();
  const { width, height } = small;
  const pixels = small.getContext('2d').getImageData(0, 0, width, height);
  return { ...(await measures(pixels)), thumbnail: await jpegOf(tiny) };
}

/** Decoded and scaled by the browser, which does it beside the page; its sides are known only once it is decoded. */
async function shrunk(file) {
  const whole = await createImageBitmap(file);
  const [width, height] = sides(whole, LONGEST);
  whole.close();
  return createImageBitmap(file, { resizeWidth: width, resizeHeight: height, resizeQuality: 'high' });
}

/** Width and height of a picture scaled down to at most `longest`. */
function sides({ width, height }, longest) {
  const share = Math.min(1, longest / Math.max(width, height));
  return [Math.max(1, Math.round(width * share)), Math.max(1, Math.round(height * share))];
}

function drawn(bitmap, longest, makeCanvas) {
  const canvas = makeCanvas(...sides(bitmap, longest));
  const context = canvas.getContext('2d', { willReadFrequently: true });
  context.imageSmoothingQuality = 'high';
  context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  return canvas;
}

function jpegOf(canvas) {
  if (canvas.convertToBlob) return canvas.convertToBlob({ type: 'image/jpeg', quality: 0.7 });
  return new Promise((resolve) => canvas.toBlob(resolve, 'image/jpeg', 0.7));
}

/** Of RGBA pixels. */
async function measures({ data, width, height }) {
  const luma = new Float32Array(width * height);
  for (let at = 0; at < luma.length; at++) luma[at] = 0.299 * data[4 * at] + 0.587 * data[4 * at + 1] + 0.114 * data[4 * at + 2];
  const thumb = averaged(luma, width, height, ACROSS, DOWN);
  const tones = tonesOf(luma);
  const dark = toneAt(tones, 0.5) < DARK[0] && toneAt(tones, 0.95) < DARK[1];
  const white = tones.slice(WHITE).reduce((sum, share) => sum + share, 0);
  const found = { dark, white, thumb, spread: deviation(thumb), hash: hashOf(luma, width, height) };
  await pause();
  const coarse = await blurred(luma, width, height);
  await pause();
  return { ...found, sharpness: sharpnessOf(luma, coarse, width, height) };
}

const pause = () => new Promise((resolve) => setTimeout(resolve));

/** Shares of the 256 tones. */
function tonesOf(luma) {
  const tones = new Float64Array(256);
  for (const value of luma) tones[Math.floor(value)] += 1 / luma.length;
  return tones;
}

/** The tone below which this share of the pixels lies. */
function toneAt(tones, share) {
  let sum = 0;
  return tones.findIndex((part) => (sum += part) >= share);
}

/** Means of cells, `across` by `down` of them; cells of a picture smaller than that repeat its pixels. */
function averaged(luma, width, height, across, down) {
  const cells = new Float32Array(across * down);
  for (let row = 0; row < down; row++) {
    const [top, bottom] = span(row, down, height);
    for (let column = 0; column < across; column++) {
      const [left, right] = span(column, across, width);
      let sum = 0;
      for (let y = top; y < bottom; y++) for (let x = left; x < right; x++) sum += luma[y * width + x];
      cells[row * across + column] = sum / ((bottom - top) * (right - left));
    }
  }
  return cells;
}

function span(cell, cells, length) {
  const first = Math.floor((cell * length) / cells);
  return [first, Math.max(first + 1, Math.floor(((cell + 1) * length) / cells))];
}

function deviation(values) {
  const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
  return Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / values.length);
}

/** Whether it grows lighter from cell to cell, on 8 rows of 9: a byte a row. */
function hashOf(luma, width, height) {
  const cells = averaged(luma, width, height, 9, 8);
  return Array.from({ length: 8 }, (_, row) => {
    let bits = 0;
    for (let column = 0; column < 8; column++) bits = (bits << 1) | (cells[row * 9 + column + 1] > cells[row * 9 + column]);
    return bits;
  });
}

/** By a Gaussian of COARSE_PX: rows, then columns; the border's pixels go on outside. */
async function blurred(luma, width, height) {
  const reach = 3 * COARSE_PX;
  const weights = Array.from({ length: 2 * reach + 1 }, (_, place) => Math.exp(-((place - reach) ** 2) / (2 * COARSE_PX ** 2)));
  const sum = weights.reduce((total, weight) => total + weight, 0);
  const kernel = Float32Array.from(weights, (weight) => weight / sum);
  const rows = await smeared(luma, width, height, 1, width, kernel);
  return smeared(rows, height, width, width, 1, kernel);
}

/** Along lines of `length` pixels that are `along` apart; the lines themselves are `beside` apart. */
async function smeared(from, length, lines, along, beside, kernel) {
  const to = new Float32Array(from.length);
  const reach = (kernel.length - 1) / 2;
  let began = performance.now();
  for (let line = 0; line < lines; line++) {
    if (performance.now() - began > PIECE_MS) {
      await pause();
      began = performance.now();
    }
    for (let place = 0; place < length; place++) {
      let value = 0;
      for (let tap = -reach; tap <= reach; tap++) {
        const other = Math.min(length - 1, Math.max(0, place + tap));
        value += kernel[tap + reach] * from[line * beside + other * along];
      }
      to[line * beside + place * along] = value;
    }
  }
  return to;
}

/** Four numbers, one for each direction: fine detail over what a wide blur leaves of it; null for a bare wall. */
function sharpnessOf(luma, coarse, width, height) {
  const [fine, left] = [changes(luma, width, height), changes(coarse, width, height)];
  return Math.min(...left) > NOTHING ? fine.map((value, step) => value / left[step]) : null;
}

/** Mean squared difference between a pixel and the one a step further. */
function changes(luma, width, height) {
  return STEPS.map(([down, across]) => {
    let sum = 0;
    for (let y = 1; y < height - 1; y++) {
      for (let x = 1; x < width - 1; x++) sum += (luma[(y + down) * width + x + across] - luma[y * width + x]) ** 2;
    }
    return sum / Math.max(1, (width - 2) * (height - 2));
  });
}

/** How much two photos differ: 0 for the same, above 1 for two that have nothing in common. */
export function change(one, other) {
  let sum = 0;
  for (let at = 0; at < one.thumb.length; at++) sum += Math.abs(one.thumb[at] - other.thumb[at]);
  return sum / one.thumb.length / Math.max(1, other.spread);
}

/** Whether two photos that differ by `changed` are copies. */
export function isCopy(one, other, changed) {
  return changed <= COPY_CHANGE && one.hash.reduce((count, byte, row) => count + ones(byte ^ other.hash[row]), 0) <= COPY_BITS;
}

function ones(byte) {
  let count = 0;
  for (let rest = byte; rest; rest &= rest - 1) count++;
  return count;
}
