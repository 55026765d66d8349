// Checks a set of photos: which of them would do harm, and how far around the object they go.
import { isCopy } from './photo-quality.js';
import { t } from '../shared/texts.js';

/** @import { PhotoQuality } from './photo-quality.js' */

export const ADVISED = [15, 30]; // photos
export const FEWEST = 3; // photos that are used before a video beside them, or tell by their compass how far around they go
export const FEW = 8; // photos up to which what none of them shows is guessed
const BLURRED = 0.4; // sharpness against the median of the set
const MOST_BLURRED = 0.3; // share of the photos that may be called blurred: the others say what is sharp here
const MOST_WHITE = 0.5; // share of a photo's pixels
const STEP = 360 / ADVISED[0]; // degrees that one photo adds at most
const FULL_STEP = 0.6; // difference from the most similar photo that counts as a whole step; 2 degrees make 0.25
const COMPASS_SHARE = 0.5; // share of the photos that must have a direction before the compass is used

/**
 * A photo that was chosen. `quality`: undefined until it is measured, null where the browser cannot decode it.
 * @typedef {object} Photo
 * @property {File} file
 * @property {PhotoQuality | null} [quality]
 * @property {Map<File, number>} differences from the other photos
 * @property {string} thumbnailUrl empty until it is measured
 * @property {number | null} heading degrees clockwise by the compass, or null
 */

/** @typedef {Photo & { quality: PhotoQuality }} MeasuredPhoto */

/** @typedef {[from: number, to: number]} Arc in degrees */

/**
 * How far around the object the photos go, and how that is known.
 * @typedef {object} Coverage
 * @property {Arc[]} arcs
 * @property {(degrees: string) => string} sentence says it, of a number of degrees
 */

/**
 * Whether a photo was measured.
 * @param {Photo} photo
 * @returns {photo is MeasuredPhoto}
 */
export function isMeasured(photo) {
  return Boolean(photo.quality);
}

/**
 * Finds the photos that would do harm.
 * @param {MeasuredPhoto[]} photos
 * @returns {Map<File, string>} a sentence for each of them
 */
export function findFaults(photos) {
  /** @type {Map<File, string>} */
  const faults = new Map();
  for (const [place, photo] of photos.entries()) {
    const earlier = photos.slice(0, place).filter(({ file }) => !faults.has(file));
    const fault = faultOf(photo, earlier);
    if (fault) faults.set(photo.file, fault);
  }
  const rest = photos.filter(({ file }) => !faults.has(file));
  for (const { file } of findBlurred(rest)) {
    faults.set(file, t('Blurred, next to the others. Hold still, or use more light.'));
  }
  return faults;
}

/**
 * @param {MeasuredPhoto} photo
 * @param {MeasuredPhoto[]} earlier photos that it may be a copy of
 */
function faultOf({ quality, differences }, earlier) {
  if (quality.dark) return t('Almost black. Take it again with more light.');
  if (quality.white > MOST_WHITE) {
    return t('More than half of it is plain white. Use less light, or tap on the object before you take it.');
  }
  const original = earlier.find((other) => isCopy(quality, other.quality, differences.get(other.file) ?? Infinity));
  return original
    ? t('Shows the same as {name}. Take a step to the side between photos.', { name: original.file.name })
    : '';
}

/**
 * Finds the photos that are blurred in comparison with the others.
 * @param {MeasuredPhoto[]} photos
 */
function findBlurred(photos) {
  const compared = photos.flatMap((photo) =>
    photo.quality.sharpness ? [{ photo, sharpness: photo.quality.sharpness }] : [],
  );
  if (compared.length === 0) return [];
  const usual = [0, 1, 2, 3].map((place) => median(compared.map(({ sharpness }) => sharpness[place])));
  const shares = compared.map(({ photo, sharpness }) => ({
    photo,
    share: Math.min(...sharpness.map((value, place) => value / usual[place])),
  }));
  shares.sort((one, other) => one.share - other.share);
  const worst = shares.slice(0, Math.floor(MOST_BLURRED * photos.length));
  return worst.filter(({ share }) => share < BLURRED).map(({ photo }) => photo);
}

/** @param {number[]} values */
function median(values) {
  const sorted = [...values].sort((one, other) => one - other);
  return (sorted[Math.floor((sorted.length - 1) / 2)] + sorted[Math.floor(sorted.length / 2)]) / 2;
}

/**
 * Estimates how far around the object the photos go: by the compass, or else by how much they differ.
 * @param {Photo[]} photos
 * @returns {Coverage}
 */
export function coverageOf(photos) {
  const headings = photos.flatMap(({ heading }) => (heading === null ? [] : [heading]));
  if (headings.length < FEWEST || headings.length < COMPASS_SHARE * photos.length) return coverageByDifferences(photos);
  const arcs = mergeArcs(headings.map((degrees) => [degrees - STEP / 2, degrees + STEP / 2]));
  const rest = photos.length - headings.length;
  return {
    arcs,
    sentence: (degrees) =>
      t('About {degrees} seen, by the compass.', { degrees }) +
      (rest ? ` ${t('Not counted, for they have no direction: {count}.', { count: rest })}` : ''),
  };
}

/**
 * @param {Photo[]} photos
 * @returns {Coverage}
 */
function coverageByDifferences(photos) {
  const steps = photos.map(({ differences }, place) => {
    const nearest = Math.min(...photos.slice(0, place).map(({ file }) => differences.get(file) ?? Infinity));
    return STEP * Math.min(1, nearest / FULL_STEP);
  });
  const sum = Math.min(
    360,
    steps.reduce((total, step) => total + step, 0),
  );
  return {
    arcs: [[0, sum]],
    sentence: (degrees) =>
      t(
        'Up to about {degrees} seen: a guess from how much the photos change, for this page cannot see where you stood.',
        { degrees },
      ),
  };
}

/**
 * Merges arcs of a circle that overlap, within 0 to 360 degrees.
 * @param {Arc[]} arcs
 * @returns {Arc[]}
 */
function mergeArcs(arcs) {
  /** @type {Arc[]} */
  const turns = arcs.flatMap(([from, to]) =>
    [0, 360, -360].map((turn) => /** @type {Arc} */ ([from + turn, to + turn])),
  );
  const inside = turns
    .map(([from, to]) => /** @type {Arc} */ ([Math.max(0, from), Math.min(360, to)]))
    .filter(([from, to]) => from < to);
  /** @type {Arc[]} */
  const merged = [];
  for (const [from, to] of inside.sort(([one], [other]) => one - other)) {
    const last = merged.at(-1);
    if (last && from <= last[1]) last[1] = Math.max(last[1], to);
    else merged.push([from, to]);
  }
  return merged;
}
