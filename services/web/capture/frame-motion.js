// Movement between two small grey pictures of the camera, by block matching: how far the parts of the picture have moved, and how much of the
// earlier one is no longer found. Pure computing, so that a worker can do it.
import { lumaOf } from './photo-quality.js';

export const LONGEST = 96; // pixels of the frames that are compared: 0.6 degrees each for a phone's camera
const BLOCK = 8; // pixels along a block's side
const REACH = 6; // pixels that a block is looked for around its place
const RADIUS = 6; // pixels: what is darker or lighter than its neighbourhood of this size is compared, so that exposure does no harm
const LEAST_DETAIL = 4; // luma: standard deviation of a block that can be followed; noise of a dark picture is 2
const MATCH = 0.6; // of a block's standard deviation: a difference below is a match
const FEWEST_BLOCKS = 6; // that can be followed, below which nothing can be said
const AWAY_PENALTY = 0.01; // of the difference for each pixel of way: a block along an edge stays where it is

/** @typedef {{ detail: Float32Array, width: number, height: number }} Frame a picture less its local brightness */

/**
 * @typedef {object} Motion
 * @property {number} size how far blocks have moved on average, as a share of the picture's longest side
 * @property {number} lost share of the blocks that are not found again nearby
 * @property {number} moved share of the blocks that are lost or have gone further than `far`
 */

/** @typedef {{ rgba: Uint8ClampedArray<ArrayBuffer>, width: number, height: number }} FrameMessage a frame, to the worker */
/** @typedef {{ keep: 'hold' | 'accept' }} KeepMessage `hold`: a photo is being taken of the newest frame; `accept`: it was good */
/**
 * What the worker says of a frame. Null where there is nothing to compare with, or where too little can be followed.
 * @typedef {{ since: Motion | null, fromPhoto: Motion | null, plain: boolean }} MotionAnswer
 */

/**
 * Width and height of the frame that a picture of this size is compared in.
 * @param {number} width
 * @param {number} height
 * @returns {[width: number, height: number]}
 */
export function frameSize(width, height) {
  const share = LONGEST / Math.max(width, height);
  return [Math.max(1, Math.round(width * share)), Math.max(1, Math.round(height * share))];
}

/**
 * Prepares a frame for comparisons: takes its local brightness away.
 * @param {Uint8ClampedArray} rgba
 * @param {number} width
 * @param {number} height
 * @returns {Frame}
 */
export function frameOf(rgba, width, height) {
  const luma = lumaOf(rgba);
  const sums = integralOf(luma, width, height);
  const detail = new Float32Array(luma.length);
  for (let y = 0; y < height; y++) {
    const [top, bottom] = [Math.max(0, y - RADIUS), Math.min(height, y + RADIUS + 1)];
    for (let x = 0; x < width; x++) {
      const [left, right] = [Math.max(0, x - RADIUS), Math.min(width, x + RADIUS + 1)];
      const sum =
        sums[bottom * (width + 1) + right] -
        sums[top * (width + 1) + right] -
        sums[bottom * (width + 1) + left] +
        sums[top * (width + 1) + left];
      detail[y * width + x] = luma[y * width + x] - sum / ((bottom - top) * (right - left));
    }
  }
  return { detail, width, height };
}

/**
 * Sums of all pixels above and left of each corner between pixels (an integral image).
 * @param {Float32Array} luma
 * @param {number} width
 * @param {number} height
 */
function integralOf(luma, width, height) {
  const sums = new Float64Array((width + 1) * (height + 1));
  for (let y = 0; y < height; y++) {
    let row = 0;
    for (let x = 0; x < width; x++) {
      row += luma[y * width + x];
      sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
    }
  }
  return sums;
}

/**
 * Whether too little of a frame can be followed: a bare wall, or the dark.
 * @param {Frame} frame
 */
export const isPlain = (frame) => blocksOf(frame).length < FEWEST_BLOCKS;

/**
 * Compares two frames of the same size.
 * @param {Frame} earlier
 * @param {Frame} later
 * @param {number} far share of the longest side
 * @returns {Motion | null} null where too little of the earlier one can be followed
 */
export function motionBetween(earlier, later, far) {
  const longest = Math.max(earlier.width, earlier.height);
  const ways = blocksOf(earlier).map((block) => followBlock(earlier, later, block));
  if (ways.length < FEWEST_BLOCKS) return null;
  const found = ways.filter((way) => way !== null).map((way) => way / longest);
  const size = found.length ? found.reduce((sum, way) => sum + way, 0) / found.length : REACH / longest;
  const lost = (ways.length - found.length) / ways.length;
  return { size, lost, moved: lost + found.filter((way) => way > far).length / ways.length };
}

/** @typedef {{ left: number, top: number, deviation: number }} Block */

/**
 * The blocks of a frame with detail enough to follow them.
 * @param {Frame} frame
 * @returns {Block[]}
 */
function blocksOf(frame) {
  const blocks = [];
  for (let top = 0; top + BLOCK <= frame.height; top += BLOCK) {
    for (let left = 0; left + BLOCK <= frame.width; left += BLOCK) {
      const deviation = deviationOf(frame, left, top);
      if (deviation >= LEAST_DETAIL) blocks.push({ left, top, deviation });
    }
  }
  return blocks;
}

/**
 * @param {Frame} frame
 * @param {number} left
 * @param {number} top
 */
function deviationOf({ detail, width }, left, top) {
  let [sum, squares] = [0, 0];
  for (let y = top; y < top + BLOCK; y++) {
    for (let x = left; x < left + BLOCK; x++) {
      const value = detail[y * width + x];
      sum += value;
      squares += value * value;
    }
  }
  const count = BLOCK * BLOCK;
  return Math.sqrt(Math.max(0, squares / count - (sum / count) ** 2));
}

/**
 * Finds a block of one frame in another.
 * @param {Frame} earlier
 * @param {Frame} later
 * @param {Block} block
 * @returns {number | null} pixels that it has moved; null where it is not found
 */
function followBlock(earlier, later, { left, top, deviation }) {
  const costAt = (/** @type {number} */ across, /** @type {number} */ down) => {
    const [x, y] = [left + across, top + down];
    if (x < 0 || y < 0 || x + BLOCK > later.width || y + BLOCK > later.height) return Infinity;
    return differenceAt(earlier, later, left, top, y * later.width + x);
  };
  let [best, bestCost, bestAcross, bestDown] = [Infinity, Infinity, 0, 0];
  for (let down = -REACH; down <= REACH; down++) {
    for (let across = -REACH; across <= REACH; across++) {
      const cost = costAt(across, down);
      const weighted = cost * (1 + AWAY_PENALTY * Math.hypot(across, down));
      if (weighted < best) [best, bestCost, bestAcross, bestDown] = [weighted, cost, across, down];
    }
  }
  if (bestCost > MATCH * deviation) return null;
  const across = bestAcross + vertexOf(costAt(bestAcross - 1, bestDown), bestCost, costAt(bestAcross + 1, bestDown));
  const down = bestDown + vertexOf(costAt(bestAcross, bestDown - 1), bestCost, costAt(bestAcross, bestDown + 1));
  return Math.hypot(across, down);
}

/**
 * Mean absolute difference between a block and the one at a place of the other frame.
 * @param {Frame} earlier
 * @param {Frame} later
 * @param {number} left
 * @param {number} top
 * @param {number} place of the other block's first pixel
 */
function differenceAt(earlier, later, left, top, place) {
  let sum = 0;
  for (let y = 0; y < BLOCK; y++) {
    const [one, other] = [(top + y) * earlier.width + left, place + y * later.width];
    for (let x = 0; x < BLOCK; x++) sum += Math.abs(earlier.detail[one + x] - later.detail[other + x]);
  }
  return sum / (BLOCK * BLOCK);
}

/**
 * Where a parabola through three neighbouring costs is lowest, in pixels from the middle one.
 * @param {number} before
 * @param {number} middle the lowest
 * @param {number} after
 */
function vertexOf(before, middle, after) {
  const bend = before + after - 2 * middle;
  return Number.isFinite(bend) && bend > 0 ? Math.min(0.5, Math.max(-0.5, (before - after) / (2 * bend))) : 0;
}
