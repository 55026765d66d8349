// When the camera takes a photo by itself: the phone has moved enough since the last one, and is held still. Pure computing on what the
// pictures and the compass say.

/** @import { MotionAnswer } from './frame-motion.js' */

export const FAR = 0.05; // of the picture's longest side: a block that has gone so far counts as moved since the last photo
const MOVED = 0.7; // share of the blocks: 12 degrees around a thing move so many, which makes 30 photos all the way round
const TURNED = 12; // degrees of the compass, for the same number of photos
const STILL = 0.06; // of the longest side per second, 4 degrees: an exposure of 1/60 s then smears 2 pixels of 2000
const MOST_LOST = 0.3; // of the blocks from frame to frame: more, and the camera moves too fast to be followed
const STILL_MS = 300; // for so long, as a hand comes to rest
const LATE_MS = 600; // between two frames: a page that was hidden or busy has seen nothing meanwhile
const RETRY_MS = 1500; // after a photo that was refused, for the person to read why

/**
 * What the camera waits for: `plain` says that no movement can be seen.
 * @typedef {'plain' | 'move' | 'hold' | 'wait' | 'take'} Cue
 */

/**
 * @typedef {object} Shutter
 * @property {number} stillMs for how long the phone has been held still
 * @property {number} waitMs until a photo may be taken again
 * @property {boolean} first no photo has been taken yet
 * @property {number | null} photoHeading degrees: where the camera looked when the last photo was taken
 * @property {number | null} heading degrees: where it looks now
 * @property {Cue} cue
 */

/** @returns {Shutter} before the first photo */
export const newShutter = () => ({
  stillMs: 0,
  waitMs: 0,
  first: true,
  photoHeading: null,
  heading: null,
  cue: 'hold',
});

/**
 * The shutter after one more frame.
 * @param {Shutter} shutter
 * @param {{ ms: number, heading: number | null, motion: Pick<MotionAnswer, 'since' | 'fromPhoto' | 'plain'> }} seen `ms`: since the frame before
 * @returns {Shutter}
 */
export function afterFrame(shutter, { ms, heading, motion }) {
  const still = ms < LATE_MS && isStill(motion.since, ms);
  const next = {
    ...shutter,
    heading,
    stillMs: still ? shutter.stillMs + ms : 0,
    waitMs: Math.max(0, shutter.waitMs - ms),
  };
  return { ...next, cue: cueOf(next, motion) };
}

/**
 * The shutter after a photo that was good.
 * @param {Shutter} shutter
 * @returns {Shutter}
 */
export const afterPhoto = (shutter) => ({
  ...shutter,
  first: false,
  stillMs: 0,
  waitMs: 0,
  photoHeading: shutter.heading,
  cue: 'move',
});

/**
 * The shutter after a photo that was refused: it is taken again.
 * @param {Shutter} shutter
 * @returns {Shutter}
 */
export const afterRefusal = (shutter) => ({ ...shutter, stillMs: 0, waitMs: RETRY_MS, cue: 'wait' });

/**
 * Whether the phone is held still.
 * @param {MotionAnswer['since']} motion since the frame before; null where too little can be followed
 * @param {number} ms
 */
export const isStill = (motion, ms) => motion !== null && motion.lost <= MOST_LOST && motion.size / (ms / 1000) < STILL;

/**
 * @param {Shutter} shutter
 * @param {Pick<MotionAnswer, 'fromPhoto' | 'plain'>} motion
 * @returns {Cue}
 */
function cueOf({ first, waitMs, stillMs, heading, photoHeading }, { fromPhoto, plain }) {
  if (waitMs > 0) return 'wait';
  if (plain) return 'plain';
  const turned = heading !== null && photoHeading !== null && angleBetween(heading, photoHeading) >= TURNED;
  if (!first && !turned && fromPhoto !== null && fromPhoto.moved < MOVED) return 'move';
  return stillMs >= STILL_MS ? 'take' : 'hold';
}

/**
 * @param {number} one degrees
 * @param {number} other degrees
 * @returns {number} degrees, 0 to 180
 */
export function angleBetween(one, other) {
  const turn = Math.abs(one - other) % 360;
  return Math.min(turn, 360 - turn);
}
