// What the lines in photos leave out of a thing, for the preview: docs/edits.md, as the worker decides it for points.
import { loadCameras, PhotoCamera } from './photo-camera.js';

/** @import { AssetFile, PhotoLasso } from '../shared/types.d.ts' */
/** @import { StoredCamera } from './photo-camera.js' */

const [STAYS, GOES_IF_SEEN, GOES] = [0, 1, 2];

/** The cameras of a version's photos, and what they show of its surface. */
export class LassoCut {
  /** @type {Map<string, PhotoCamera>} */
  #cameras = new Map();
  #surface;
  /** @type {Set<PhotoCamera>} */
  #looked = new Set();

  /**
   * @param {StoredCamera[]} cameras
   * @param {{ places: Float32Array, corners: ArrayLike<number> }} surface of the coarsest level, asset frame: what hides what
   */
  constructor(cameras, surface) {
    for (const camera of cameras) this.#cameras.set(camera.name, new PhotoCamera(camera));
    this.#surface = surface;
  }

  /**
   * Loads the cameras of a version; null where they, or how their photos are turned, are not known.
   * @param {AssetFile | undefined} file
   * @param {{ places: Float32Array, corners: ArrayLike<number> }} surface
   */
  static async load(file, surface) {
    if (!file) return null;
    const cameras = await loadCameras(file);
    return cameras.every(({ turns, part }) => turns !== undefined && part !== undefined)
      ? new LassoCut(cameras, surface)
      : null;
  }

  /**
   * Whether the cameras of all these lines' photos are known: those that could not be placed have no effect.
   * @param {PhotoLasso[]} lassos
   */
  knows(lassos) {
    return lassos.every(({ photo }) => this.#cameras.has(photo));
  }

  /**
   * Marks with 1 the places that the lines leave out.
   * @param {Float32Array} places x, y, z one after the other, asset frame
   * @param {PhotoLasso[]} lassos
   */
  leavesOut(places, lassos) {
    const out = new Uint8Array(places.length / 3);
    for (const [name, camera] of this.#cameras) {
      const lines = lassos.filter(({ photo }) => photo === name);
      if (lines.length === 0) continue;
      if (!this.#looked.has(camera)) camera.look(this.#surface.places, this.#surface.corners);
      this.#looked.add(camera);
      for (let place = 0; place < out.length; place += 1) {
        const found = out[place] ? null : camera.see(places, 3 * place);
        if (found && leaves(found, lines)) out[place] = 1;
      }
    }
    return out;
  }
}

/**
 * The lines that another recipe does not have, and of their photos all that keep something: those count together.
 * @param {PhotoLasso[]} before
 * @param {PhotoLasso[]} now
 */
export function drawnSince(before, now) {
  const known = new Set(before.map((lasso) => JSON.stringify(lasso)));
  const fresh = now.filter((lasso) => !known.has(JSON.stringify(lasso)));
  const kept = new Set(fresh.filter(({ keeps }) => keeps).map(({ photo }) => photo));
  return now.filter((lasso) => fresh.includes(lasso) || (lasso.keeps && kept.has(lasso.photo)));
}

/**
 * @param {{ x: number, y: number, seen: boolean }} place in a photo
 * @param {PhotoLasso[]} lines of it
 */
function leaves({ x, y, seen }, lines) {
  if (x < 0 || x > 1 || y < 0 || y > 1) return false;
  const keeping = lines.filter(({ keeps }) => keeps);
  const beyond = keeping.some(({ through }) => through) ? GOES : GOES_IF_SEEN;
  let verdict = keeping.length && !keeping.some(({ line }) => isInside(x, y, line)) ? beyond : STAYS;
  for (const { line, keeps, through } of lines) {
    if (!keeps && isInside(x, y, line)) verdict = Math.max(verdict, through ? GOES : GOES_IF_SEEN);
  }
  return verdict === GOES || (verdict === GOES_IF_SEEN && seen);
}

/**
 * Whether a closed line goes round a place an odd number of times.
 * @param {number} x
 * @param {number} y
 * @param {[x: number, y: number][]} line
 */
function isInside(x, y, line) {
  let odd = false;
  for (let corner = 0, before = line.length - 1; corner < line.length; before = corner, corner += 1) {
    const [[x0, y0], [x1, y1]] = [line[before], line[corner]];
    if (y0 > y !== y1 > y && x < x0 + (x1 - x0) * ((y - y0) / (y1 - y0))) odd = !odd;
  }
  return odd;
}
