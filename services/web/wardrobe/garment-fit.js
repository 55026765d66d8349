// How a garment hangs on the dress dummy: what the garment measures at each height, and the dummy that fits into it. The garment keeps its true
// size; the dummy's girth, depth and height are set to it, as a tailor does. Numbers only, no graphics.
import { BUST_M, HIP_M, SHOULDERS, TORSO, WAIST_M, torsoAt } from '../graphics/dress-dummy.js';

/** @import { Hanging } from '../catalogue/garments.js' */
/** @import { SizeM } from '../shared/types.d.ts' */
/** @import { DummyShape } from '../graphics/dress-dummy.js' */
/** @typedef {'x' | 'z'} Axis */
/** @typedef {Record<Axis, number>} Point seen from above, in metres */
/** @typedef {[Point, Point]} Line */
/** @typedef {{ y: number, width: number, x: number, z: number }} Room of a garment at a height: half its width with all that hangs beside it, and how far it is from its middle to the cloth at the sides, and before and behind; Infinity where it is open there */
/** @typedef {{ middle: Point, rooms: Room[] }} Measures the middle of its upper part, and its room at each height, from the top down */
/** @typedef {{ position_m: [x: number, y: number, z: number], shape: DummyShape }} Fit where the garment's origin is, over the middle of the dummy's foot */

const SLICES = 48; // from top to hem: a collar is two or three of them
const EDGES = [
  [0, 3],
  [3, 6],
  [6, 0],
]; // of a triangle, by the places of its corners
const LEAST_HEIGHT_M = 0.25; // what is lower lies folded, and is worn by nobody
const MOST_M = { height: 2.2, across: 1.8 };
const LEAST_SHARE = 0.35; // of the height, of the longer side of its base: what is flatter lies
const UPPER = 1 / 3; // of a garment, which tells where its middle is: a hem swings
const MOST_COLLAR_M = 0.12;
const LEAST_SLOPE = 0.5; // of cloth on shoulders, metres outwards for each down: what is steeper is a collar, or a body's side
const STRAPLESS_M = 1.33; // height of the dummy, of size 1, up to which a garment without straps reaches
const EASE = 0.95; // of the garment's room, which the dummy takes
const FREE_M = 0.03; // between the hem and the floor
/** @type {Record<'x' | 'y' | 'z', [least: number, most: number]>} */
const RANGES = { x: [0.4, 1.2], y: [0.4, 1.1], z: [0.35, 1.3] }; // of the dummy's sizes, from a small child's on
const WAIST_WITHIN = [0.15, 0.7]; // of the height, from the top down
/** The dummy's part, of size 1, that must fit into a garment. Above the bust are armholes, and cloth that runs up to the shoulders; below the hips may be legs. @type {Record<Hanging, [high: number, low: number]>} */
const GIRTHS = { shoulders: [BUST_M, TORSO[TORSO.length - 1].y], waist: [WAIST_M, HIP_M] };
const LEG_SHARE = 0.3; // of the whole width, to the cloth beside the middle: where it is less, the middle is between two legs
const ROUNDS = 3; // where it hangs depends on the dummy's girth, and that on where it hangs

/**
 * Whether a thing of this size can hang on a dummy.
 * @param {SizeM} size width, height, depth
 */
export function canHang([width, height, depth]) {
  const across = Math.max(width, depth);
  return (
    height >= LEAST_HEIGHT_M && height <= MOST_M.height && across <= MOST_M.across && height >= LEAST_SHARE * across
  );
}

/**
 * Measures a garment.
 * @param {ArrayLike<number>} corners nine numbers for each of its triangles, in metres
 * @returns {Measures}
 */
export function measureGarment(corners) {
  let [low, high] = [Infinity, -Infinity];
  for (let place = 1; place < corners.length; place += 3) {
    [low, high] = [Math.min(low, corners[place]), Math.max(high, corners[place])];
  }
  const heights = Array.from({ length: SLICES }, (_, place) => high - ((place + 0.5) * (high - low)) / SLICES);
  const slices = heights.map((y) => sliceAt(corners, y));
  const upper = slices.slice(0, Math.ceil(UPPER * SLICES)).filter(({ length }) => length > 0);
  const middleOf = (/** @type {Axis} */ axis) =>
    upper.reduce((sum, slice) => sum + mean(spanOf(slice, axis)), 0) / upper.length;
  const middle = { x: middleOf('x'), z: middleOf('z') };
  const rooms = slices.map((slice, place) => {
    const [left, right] = spanOf(slice, 'x');
    return {
      y: heights[place],
      width: Math.max(0, right - left) / 2,
      x: roomOf(slice, middle, 'x', 'z'),
      z: roomOf(slice, middle, 'z', 'x'),
    };
  });
  return { middle, rooms };
}

/**
 * The lines in which a plane at a height cuts the cloth.
 * @param {ArrayLike<number>} corners
 * @param {number} y
 * @returns {Line[]}
 */
function sliceAt(corners, y) {
  /** @type {Line[]} */
  const lines = [];
  for (let first = 0; first < corners.length; first += 9) {
    const ends = EDGES.flatMap(([from, to]) => cutAt(corners, first + from, first + to, y) ?? []);
    if (ends.length === 2) lines.push([ends[0], ends[1]]);
  }
  return lines;
}

/**
 * @param {ArrayLike<number>} corners
 * @param {number} from place of a corner's x, as `to`
 * @param {number} to
 * @param {number} y
 * @returns {Point | null} where an edge passes through a height
 */
function cutAt(corners, from, to, y) {
  const [one, other] = [corners[from + 1] - y, corners[to + 1] - y];
  if (one < 0 === other < 0) return null;
  const share = one / (one - other);
  return {
    x: corners[from] + share * (corners[to] - corners[from]),
    z: corners[from + 2] + share * (corners[to + 2] - corners[from + 2]),
  };
}

/**
 * How far it is from a garment's middle to its cloth, to the nearer of two sides: a sleeve that hangs beside the body is behind the body's cloth.
 * @param {Line[]} slice
 * @param {Point} middle
 * @param {Axis} side
 * @param {Axis} across
 */
function roomOf(slice, middle, side, across) {
  let room = Infinity;
  for (const [one, other] of slice) {
    const [from, to] = [one[across] - middle[across], other[across] - middle[across]];
    if (from < 0 !== to < 0) {
      room = Math.min(room, Math.abs(one[side] + ((other[side] - one[side]) * from) / (from - to) - middle[side]));
    }
  }
  return room;
}

/**
 * @param {Line[]} slice
 * @param {Axis} axis
 * @returns {[from: number, to: number]}
 */
function spanOf(slice, axis) {
  const ends = slice.flat().map((point) => point[axis]);
  return [
    ends.reduce((least, end) => Math.min(least, end), Infinity),
    ends.reduce((most, end) => Math.max(most, end), -Infinity),
  ];
}

/** @param {[from: number, to: number]} span */
const mean = ([from, to]) => (from + to) / 2;

/**
 * Hangs a garment on the dummy, over its middle, and sets the dummy to it.
 * @param {Measures} measures
 * @param {Hanging} hanging
 * @returns {Fit}
 */
export function fitGarment({ middle, rooms }, hanging) {
  const around = rooms.filter(({ width, x }) => x >= LEG_SHARE * width);
  const y = clamp((EASE * waistOf(around, hanging)) / torsoAt(WAIST_M).x, RANGES.y);
  const [high, low] = GIRTHS[hanging];
  let scale = { x: y, y, z: y };
  let drop = 0; // from the garment's frame to the dummy's
  for (let round = 0; round < ROUNDS; round++) {
    drop = hanging === 'waist' ? y * WAIST_M - rooms[0].y : shoulderDrop(rooms, scale);
    const girth = around
      .map((room) => ({ ...room, y: (room.y + drop) / y }))
      .filter((room) => room.y <= high && room.y >= low);
    scale = { x: shareOf(girth, 'x'), y, z: shareOf(girth, 'z') };
  }
  const hem = rooms[rooms.length - 1].y + drop;
  const lift = Math.max(0, FREE_M - hem);
  return { position_m: [-middle.x, drop + lift, -middle.z], shape: { scale, lift } };
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
 * How much higher a garment hangs than its own frame has it: what slopes in its upper part lies on the shoulders, straps, seams, or what is below a
 * collar, by the median. What has nothing that slopes hangs off them where it is wider, and else from the bust.
 * @param {Room[]} rooms
 * @param {{ x: number, y: number }} scale of the dummy
 */
function shoulderDrop(rooms, scale) {
  const [end, collar] = [SHOULDERS[SHOULDERS.length - 1], MOST_COLLAR_M * scale.y];
  const top = rooms.find(({ x }) => x <= end.x * scale.x); // not of sleeves alone, which may be higher
  if (!top || rooms[0].y - top.y > collar) return scale.y * end.y - rooms[0].y;
  const drops = rooms
    .filter(({ y, x }, place) => x <= end.x * scale.x && top.y - y <= collar && slopeAt(rooms, place) >= LEAST_SLOPE)
    .map(({ y, x }) => scale.y * shoulderHeight(x / scale.x) - y);
  return drops.length > 0
    ? drops.toSorted((one, other) => one - other)[drops.length >> 1]
    : scale.y * STRAPLESS_M - top.y;
}

/**
 * How far cloth goes outwards from a slice to the next one, for each metre down.
 * @param {Room[]} rooms
 * @param {number} place
 */
function slopeAt(rooms, place) {
  const [above, below] = [rooms[place], rooms[Math.min(place + 1, rooms.length - 1)]];
  return (below.x - above.x) / (above.y - below.y);
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
