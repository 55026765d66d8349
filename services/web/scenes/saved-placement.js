// Saves where people put things in the browser's local storage. What is stored there may be old, full, or changed by hand.

import { ownNameOfShown } from '../shared/whose.js';

const STORAGE_KEY = ownNameOfShown('capture2vr:placed');
const MOST = 200; // assets; the one that was moved longest ago is removed first
const FAR_M = 20; // from the default place: farther away nobody would find it again
/** @type {[smallest: number, largest: number]} */
export const SCALES = [0.05, 20]; // against true size

/**
 * Where an asset stands, relative to its default place. `turn`: a quaternion.
 * @typedef {{ offset_m: number[], turn: number[], scale: number }} Placement
 */

/** @typedef {[key: string, numbers: unknown]} Row an asset and its placement as eight numbers, if nobody has changed it */

/**
 * Loads the placement of an asset. Null where there is none, or where it makes no sense.
 * @param {string} key
 * @returns {Placement | null}
 */
export function loadPlacement(key) {
  const row = loadRows().find(([name]) => name === key);
  return row ? placementFrom(row[1]) : null;
}

/**
 * Saves the placement of an asset.
 * @param {string} key
 * @param {Placement} placement
 */
export function savePlacement(key, { offset_m: offset, turn, scale }) {
  const numbers = [...offset, ...turn, scale].map((value) => Number(value.toFixed(5)));
  if (placementFrom(numbers)) {
    saveRows([...loadRows().filter(([name]) => name !== key), /** @type {Row} */ ([key, numbers])].slice(-MOST));
  }
}

/**
 * Deletes the placement of an asset.
 * @param {string} key
 */
export function deletePlacement(key) {
  saveRows(loadRows().filter(([name]) => name !== key));
}

/**
 * Reads a placement from eight numbers. Null where they make no sense.
 * @param {unknown} stored
 * @returns {Placement | null}
 */
function placementFrom(stored) {
  if (!Array.isArray(stored) || stored.length !== 8 || !stored.every(Number.isFinite)) return null;
  /** @type {number[]} */
  const numbers = stored;
  const [offset, turn, scale] = [numbers.slice(0, 3), numbers.slice(3, 7), numbers[7]];
  const length = Math.hypot(...turn);
  if (Math.hypot(...offset) > FAR_M || Math.abs(length - 1) > 0.01 || scale < SCALES[0] || scale > SCALES[1]) {
    return null;
  }
  return { offset_m: offset, turn: turn.map((value) => value / length), scale };
}

/** @returns {Row[]} */
function loadRows() {
  try {
    /** @type {unknown} */
    const stored = JSON.parse(localStorage.getItem(STORAGE_KEY) ?? 'null');
    return Array.isArray(stored)
      ? stored.filter((row) => Array.isArray(row) && typeof row[0] === 'string').slice(-MOST)
      : [];
  } catch {
    return [];
  }
}

/** @param {Row[]} rows */
function saveRows(rows) {
  try {
    localStorage.setItem(STORAGE_KEY, JSON.stringify(rows));
  } catch {
    // The storage is full or not allowed: the placement lasts until the page is closed.
  }
}
