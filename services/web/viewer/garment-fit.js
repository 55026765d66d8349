// How a garment hangs on the dress dummy: what the garment measures at each height, and the dummy that fits into it. The garment keeps its true
// size; the dummy's girth, depth and height are set to it, as a tailor does. Numbers only, no graphics.
import { BUST_M, HIP_M, SHOULDERS, TORSO, WAIST_M, torsoAt } from '../graphics/dress-dummy.js';

/** @import { Hanging } from '../shared/garments.js' */
/** @import { SizeM } from '../shared/types.d.ts' */
/** @import { DummyShape } from '../graphics/dress-dummy.js' */
/** @typedef {[from: number, to: number]} Span in metres */
/** @typedef {Record<'x' | 'y' | 'z', Span>} Spans */
/** @typedef {{ y: number, width: number, x: number, z: number }} Room of a garment at a height: half its width with all that hangs beside it, and how far it is from its middle to the cloth at the sides, and before and behind; Infinity where it is open there */
/** @typedef {{ axis: { x: number, z: number }, rooms: Room[] }} Measures the middle of its upper part, and its room at each height, from the top down */
/** @typedef {{ position_m: [x: number, y: number, z: number], shape: DummyShape }} Fit where the garment's origin is, over the middle of the dummy's foot */

const BANDS = 32; // a garment's collar is one or two of them
const LEAST_HEIGHT_M = 0.25; // what is lower lies folded, and is worn by nobody
const MOST_M = { height: 2.2, across: 1.8 };
const LEAST_SHARE = 0.35; // of the height, of the longer side of its base: what is flatter lies
const UPPER = 1 / 3; // of a garment, which tells where its middle is: a hem swings
const SHOULDER_SHARE = 0.55; // of the widest place of the upper part: a collar is narrower, and stands above the shoulders
const MOST_COLLAR_M = 0.12;
const EASE = 0.95; // of the garment's room, which the dummy takes
const FREE_M = 0.03; // between the hem and the floor
/** @type {Record<'x' | 'y' | 'z', [least: number, most: number]>} */
const RANGES = { x: [0.4, 1.2], y: [0.4, 1.1], z: [0.35, 1.3] }; // of the dummy's sizes, from a small child's on
const WAIST_WITHIN = [0.15, 0.7]; // of the height, from the top down
const LEG_SHARE = 0.3; // of the whole width, to the cloth beside the middle: where it is less, the middle is between two legs
const ROUNDS = 3; // where it hangs depends on the dummy's girth, and that on where it hangs

/**
 * Whether a thing of this size can hang on a dummy.
 * @param {SizeM} size width, height, depth
 */
export function canHang([width, height, depth]) {
  const across = Math.max(width, depth);
  return height >= LEAST_HEIGHT_M && height <= MOST_M.height && across <= MOST_M.across && height >= LEAST_SHARE * across;
}

/**
 * Measures a garment.
 * @param {ArrayLike<number>} corners nine numbers for each of its triangles, in metres
 * @returns {Measures}
 */
export function measureGarment(corners) {
  const triangles = Array.from({ length: corners.length / 9 }, (_, place) => spansOf(corners, 9 * place));
  const { y: [low, high] } = unite(triangles);
  const step = (high - low) / BANDS;
  const bandAt = (/** @type {number} */ y) => Math.min(BANDS - 1, Math.max(0, Math.floor((high - y) / step)));
  /** @type {Spans[][]} */
  const bands = Array.from({ length: BANDS }, () => []);
  for (const triangle of triangles) for (let band = bandAt(triangle.y[1]); band <= bandAt(triangle.y[0]); band++) bands[band].push(triangle);
  const upper = unite(bands.slice(0, Math.ceil(UPPER * BANDS)).flat());
  const axis = { x: mean(upper.x), z: mean(upper.z) };
  const rooms = bands.map((band, place) => ({ y: high - (place + 0.5) * step, width: halfOf(unite(band).x), x: roomOf(band, axis, 'x', 'z'), z: roomOf(band, axis, 'z', 'x') }));
  return { axis, rooms };
}

/**
 * How far it is from a garment's middle to its cloth, to the nearer of two sides: a sleeve that hangs beside the body is behind the body's cloth.
 * @param {Spans[]} triangles of a band
 * @param {{ x: number, z: number }} axis
 * @param {'x' | 'z'} side
 * @param {'x' | 'z'} across
 */
function roomOf(triangles, axis, side, across) {
  const met = triangles.filter((triangle) => triangle[across][0] <= axis[across] && triangle[across][1] >= axis[across]);
  return met.reduce((least, triangle) => Math.min(least, Math.abs(mean(triangle[side]) - axis[side])), Infinity);
}

/**
 * @param {ArrayLike<number>} corners
 * @param {number} first of nine numbers
 * @returns {Spans}
 */
function spansOf(corners, first) {
  const span = (/** @type {number} */ axis) => /** @type {Span} */ ([Math.min, Math.max].map((most) => most(corners[first + axis], corners[first + axis + 3], corners[first + axis + 6])));
  return { x: span(0), y: span(1), z: span(2) };
}

/**
 * What several parts span together.
 * @param {Spans[]} parts
 * @returns {Spans}
 */
function unite(parts) {
  const span = (/** @type {'x' | 'y' | 'z'} */ axis) => /** @type {Span} */ ([
    parts.reduce((least, part) => Math.min(least, part[axis][0]), Infinity),
    parts.reduce((most, part) => Math.max(most, part[axis][1]), -Infinity),
  ]);
  return { x: span('x'), y: span('y'), z: span('z') };
}

/** @param {Span} span */
const halfOf = ([from, to]) => (to - from) / 2;

/** @param {Span} span */
const mean = ([from, to]) => (from + to) / 2;

/**
 * Hangs a garment on the dummy, over its middle, and sets the dummy to it.
 * @param {Measures} measures
 * @param {Hanging} hanging
 * @returns {Fit}
 */
export function fitGarment({ axis, rooms }, hanging) {
  const around = rooms.filter(({ width, x }) => x >= LEG_SHARE * width);
  const y = clamp((EASE * waistOf(around, hanging)) / torsoAt(WAIST_M).x, RANGES.y);
  let scale = { x: y, y, z: y };
  let drop = 0; // from the garment's frame to the dummy's
  for (let round = 0; round < ROUNDS; round++) {
    const { y: line, height, girth: [high, low] } = hanging === 'waist' ? waistLine(rooms) : shoulderLine(rooms, scale);
    drop = y * height - line;
    const girth = around.map((room) => ({ ...room, y: (room.y + drop) / y })).filter((room) => room.y <= high && room.y >= low);
    scale = { x: shareOf(girth, 'x'), y, z: shareOf(girth, 'z') };
  }
  const hem = rooms[rooms.length - 1].y + drop;
  const lift = Math.max(0, FREE_M - hem);
  return { position_m: [-axis.x, drop + lift, -axis.z], shape: { scale, lift } };
}

/**
 * Half the width of a garment's waist: of its upper edge, or where it is narrowest between the armholes and the hem.
 * @param {Room[]} rooms
 * @param {Hanging} hanging
 */
function waistOf(rooms, hanging) {
  const [from, to] = hanging === 'waist' ? [0, 1] : WAIST_WITHIN.map((share) => Math.floor(share * rooms.length));
  return Math.min(...rooms.slice(from, to).map(({ x }) => x));
}

/**
 * @typedef {object} Line where a garment meets the dummy
 * @property {number} y of the garment
 * @property {number} height of the dummy of size 1
 * @property {[high: number, low: number]} girth the dummy's part that must fit into the garment, of size 1
 */

/**
 * The waist, which a garment's upper edge is at. Below the hips there may be legs.
 * @param {Room[]} rooms
 * @returns {Line}
 */
const waistLine = ([{ y }]) => ({ y, height: WAIST_M, girth: [WAIST_M, HIP_M] });

/**
 * The shoulders, on which a garment lies with its first band from the top that is no collar. Straps lie nearer to the neck than sleeves begin. Above the
 * bust are armholes, and cloth that runs up to the shoulders.
 * @param {Room[]} rooms
 * @param {{ x: number, y: number }} scale of the dummy
 * @returns {Line}
 */
function shoulderLine(rooms, scale) {
  const upper = rooms.filter(({ y }) => rooms[0].y - y <= MOST_COLLAR_M * scale.y);
  const widest = Math.max(...upper.map(({ width }) => width));
  const { y, width } = upper.find((room) => room.width >= SHOULDER_SHARE * widest) ?? rooms[0];
  const height = shoulderHeight(width / scale.x);
  return { y, height, girth: [BUST_M, TORSO[TORSO.length - 1].y] };
}

/**
 * The height at which the dummy's shoulders are so wide.
 * @param {number} half of the width, for a dummy of size 1
 */
function shoulderHeight(half) {
  const place = SHOULDERS.findIndex(({ x }) => x >= half);
  if (place <= 0) return SHOULDERS[place < 0 ? SHOULDERS.length - 1 : 0].y;
  const [above, below] = [SHOULDERS[place - 1], SHOULDERS[place]];
  return above.y + ((below.y - above.y) * (half - above.x)) / (below.x - above.x);
}

/**
 * The size of the dummy that fits into a garment everywhere.
 * @param {Room[]} rooms at heights of a dummy of size 1
 * @param {'x' | 'z'} side
 */
function shareOf(rooms, side) {
  return clamp(Math.min(...rooms.map((room) => (EASE * room[side]) / torsoAt(room.y)[side])), RANGES[side]);
}

/**
 * @param {number} value
 * @param {[least: number, most: number]} range
 */
const clamp = (value, [least, most]) => Math.min(most, Math.max(least, value));
