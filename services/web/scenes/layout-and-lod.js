// Layout of the things in a scene, and the choice of their levels of detail. Numbers only, no graphics.

/** Triangles in view: a Quest 3 draws them in time with room to spare. */
export const MOST_TRIANGLES = 1_000_000;

// A level is fine enough while the thing's diameter takes less than this share of the view's height.
const FINE_ENOUGH = [Infinity, 0.3, 0.1];
const HYSTERESIS = 0.85; // of that share, before a finer level is given up: otherwise small movements would make it flicker
const GAP = 0.15; // between neighbours, of their mean width
const LEAST_GAP_M = 0.1; // a hand fits in between
const ONE_ROW = 4; // up to this many things stand in one row; more make several rows

/** @import { SizeM } from '../shared/types.d.ts' */
/** @typedef {{ level: number, triangles: number }} Lod a level of detail; level 0 is the finest */
/** @typedef {[x: number, z: number]} FloorPoint in metres */

/**
 * A thing in view.
 * @typedef {object} ThingInView
 * @property {number} share of the view's height that its diameter takes
 * @property {Lod[]} lods finest first
 * @property {number} now place in `lods` of the level that is shown now
 */

/**
 * Chooses the level of detail of each thing within a budget of triangles. The coarsest levels are shown whatever they cost.
 * Then all things become finer by one level as far as they should and the budget allows, the largest in view first, before
 * any becomes finer by two.
 * @param {ThingInView[]} things
 * @param {number} budget triangles of all things together
 * @returns {number[]} a place in `lods` for each thing
 */
export function chooseLevels(things, budget) {
  const levels = things.map(({ lods }) => lods.length - 1);
  const wanted = things.map(wantedLevel);
  let left = budget - things.reduce((sum, { lods }) => sum + lods[lods.length - 1].triangles, 0);
  const largestFirst = things.map((_, place) => place).sort((one, other) => things[other].share - things[one].share);
  for (let round = Math.max(0, ...levels); round > 0; round--) {
    for (const place of largestFirst) {
      const { lods } = things[place];
      const level = levels[place];
      if (level === 0 || level > round || wanted[place] >= level) continue;
      const more = lods[level - 1].triangles - lods[level].triangles;
      if (more > left) continue;
      left -= more;
      levels[place] -= 1;
    }
  }
  return levels;
}

/**
 * The coarsest level that is fine enough.
 * @param {ThingInView} thing
 */
function wantedLevel({ share, lods, now }) {
  for (let place = lods.length - 1; place > 0; place--) {
    const limit = FINE_ENOUGH[Math.min(lods[place].level, FINE_ENOUGH.length - 1)];
    if (share < (now < place ? HYSTERESIS * limit : limit)) return place;
  }
  return 0;
}

/**
 * Places boxes side by side, in rows one behind the other. The first row is at z = 0.
 * @param {SizeM[]} sizes
 * @returns {FloorPoint[]} the centre of each box on the floor
 */
export function placeSideBySide(sizes) {
  const perRow = sizes.length <= ONE_ROW ? sizes.length : Math.ceil(Math.sqrt(2 * sizes.length));
  /** @type {FloorPoint[]} */
  const places = [];
  let front = 0;
  for (let first = 0; first < sizes.length; first += perRow) {
    const row = sizes.slice(first, first + perRow);
    const depth = Math.max(...row.map((size) => size[2]));
    const middle = first === 0 ? 0 : front - depth / 2;
    for (const x of rowCentres(row)) places.push([x, middle]);
    front = middle - depth / 2 - rowGap(row);
  }
  return places;
}

/**
 * The x of the centre of each box in a row.
 * @param {SizeM[]} row
 */
function rowCentres(row) {
  const gap = rowGap(row);
  const whole = row.reduce((sum, size) => sum + size[0] + gap, -gap);
  let left = -whole / 2;
  return row.map(([width]) => {
    const middle = left + width / 2;
    left += width + gap;
    return middle;
  });
}

/** @param {SizeM[]} row */
function rowGap(row) {
  return Math.max(LEAST_GAP_M, (GAP * row.reduce((sum, size) => sum + size[0], 0)) / row.length);
}
