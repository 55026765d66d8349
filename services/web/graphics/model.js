// One version of an asset: its levels of detail as they are loaded, the one that is shown, and freeing the others' memory.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { loadLevel } from './glb-loader.js';
import { dispose } from './scene.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const RETRY_MS = 2000; // doubles from try to try
const LONGEST_RETRY_MS = 60_000;
const RELEASE_MS = 3000; // how long a level that is too fine is kept: who steps back often comes back at once

/** The levels of detail of one version. */
export class Model {
  /** @type {(THREE.Group | undefined)[]} */
  #levels = []; // by their place in `lods`; none is loaded before all coarser ones are
  #wanted;
  #retryMs = RETRY_MS;
  #loading = false;
  #tooFineSince = 0;
  #disposed = false;
  #renderer;
  #prepare;
  #onLevel;

  /**
   * @param {AssetEntry} entry with the hashes of its files checked: they are shown as they are
   * @param {THREE.WebGLRenderer} renderer
   * @param {object} [options]
   * @param {(level: THREE.Group) => Promise<void>} [options.prepare] makes what the graphics card needs, before the first drawing
   * @param {(level: number) => void} [options.onLevel] is called for each level that has come
   */
  constructor(entry, renderer, { prepare = async () => {}, onLevel = () => {} } = {}) {
    this.lods = [...entry.lods].sort((one, other) => one.level - other.level);
    this.object = new THREE.Group();
    this.object.name = entry.key;
    this.#renderer = renderer;
    this.#prepare = prepare;
    this.#onLevel = onLevel;
    this.#wanted = this.lods.length - 1;
  }

  /** Loads the coarsest level. Throws what loading throws. */
  async start() {
    await this.#load(this.lods.length - 1, true);
  }

  /**
   * Shows a level, and until it is loaded the finest that is.
   * @param {number} place in `lods`
   */
  want(place) {
    this.#wanted = place;
    this.#refine();
    this.#releaseFinest();
  }

  /** Place in `lods` of the level that is shown. */
  get shown() {
    return Math.max(this.#finest, this.#wanted);
  }

  /** The coarsest level, for hit tests: few triangles are searched quickly. */
  get coarsest() {
    return this.#levels[this.lods.length - 1];
  }

  /** Frees all memory, and later that of a level that is being loaded. */
  dispose() {
    this.#disposed = true;
    for (const level of this.#levels) if (level) dispose(level);
    this.#levels = [];
    this.object.removeFromParent();
  }

  /** Place in `lods` of the finest level that is loaded. */
  get #finest() {
    const place = this.#levels.findIndex(Boolean);
    return place < 0 ? this.lods.length - 1 : place;
  }

  /** Loads one finer level after the other, until the wanted one is there. */
  async #refine() {
    if (this.#loading || this.#disposed || this.#finest <= this.#wanted) return;
    this.#loading = true;
    try {
      await this.#load(this.#finest - 1, false);
      this.#retryMs = RETRY_MS;
    } catch {
      await new Promise((resolve) => setTimeout(resolve, this.#retryMs));
      this.#retryMs = Math.min(2 * this.#retryMs, LONGEST_RETRY_MS);
    }
    this.#loading = false;
    this.#refine();
  }

  /**
   * @param {number} place in `lods`
   * @param {boolean} urgent nothing else is shown yet
   */
  async #load(place, urgent) {
    const level = await loadLevel(this.lods[place], this.#renderer, { urgent });
    if (!this.#disposed) await this.#prepare(level);
    if (this.#disposed) {
      dispose(level);
      return;
    }
    this.#levels[place] = level;
    this.object.add(level);
    this.#show();
    this.#onLevel(this.lods[place].level);
  }

  /** Frees the finest level, once it has been finer than wanted for a while. */
  #releaseFinest() {
    this.#show();
    const finest = this.#finest;
    const level = this.#levels[finest];
    if (!level || finest >= this.#wanted || this.#loading) {
      this.#tooFineSince = 0;
      return;
    }
    this.#tooFineSince ||= performance.now();
    if (performance.now() - this.#tooFineSince < RELEASE_MS) return;
    dispose(level);
    level.removeFromParent();
    delete this.#levels[finest];
  }

  /** Makes one level visible and hides the others. */
  #show() {
    this.#levels.forEach((level, place) => {
      if (level) level.visible = place === this.shown;
    });
  }
}
