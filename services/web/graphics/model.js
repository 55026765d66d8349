// One version of an asset: its levels of detail as they come, the one that is shown, and the memory of those that are not.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { decoded } from './glb-loader.js';
import { dispose } from './scene.js';

const RETRY_MS = 2000; // doubles from try to try
const RETRY_MOST_MS = 60_000;
const RELEASE_MS = 3000; // a finer level than is wanted goes after this: who steps back often comes back at once

export class Model {
  #levels = []; // by their place in `lods`: none is there without all the coarser ones
  #wanted;
  #pause = RETRY_MS;
  #loading = false;
  #unwantedSince = 0;

  /**
   * entry     of the catalogue: its files are shown as they are, so their hashes must have been checked
   * renderer  what it will be drawn by
   * prepare   async (group): makes what the graphics card needs, before it is drawn for the first time
   * onLevel   is told of each level that has come
   */
  constructor(entry, renderer, { prepare = async () => {}, onLevel = () => {} } = {}) {
    this.lods = [...entry.lods].sort((one, other) => one.level - other.level);
    this.object = new THREE.Group();
    this.object.name = entry.key;
    this.disposed = false;
    this.renderer = renderer;
    this.prepare = prepare;
    this.onLevel = onLevel;
    this.#wanted = this.lods.length - 1;
  }

  /** Resolves once the coarsest level is there. Throws what loading throws. */
  async start() {
    await this.#load(this.lods.length - 1, true);
  }

  /** Show this level (a place in `lods`), and until it is there the finest that is. */
  want(place) {
    this.#wanted = place;
    this.#refine();
    this.#release();
  }

  /** Place in `lods` of the level that is shown. */
  get shown() {
    return Math.max(this.#finest, this.#wanted);
  }

  /** The coarsest level: to be picked by, because few triangles are quickly searched. */
  get coarsest() {
    return this.#levels[this.lods.length - 1];
  }

  /** Free all memory; what is still on its way is freed when it comes. */
  dispose() {
    this.disposed = true;
    this.#levels.forEach(dispose);
    this.#levels = [];
    this.object.removeFromParent();
  }

  get #finest() {
    const place = this.#levels.findIndex(Boolean);
    return place < 0 ? this.lods.length - 1 : place;
  }

  async #refine() {
    if (this.#loading || this.disposed || this.#finest <= this.#wanted) return;
    this.#loading = true;
    try {
      await this.#load(this.#finest - 1, false);
      this.#pause = RETRY_MS;
    } catch {
      await new Promise((resolve) => setTimeout(resolve, this.#pause));
      this.#pause = Math.min(2 * this.#pause, RETRY_MOST_MS);
    }
    this.#loading = false;
    this.#refine();
  }

  async #load(place, hurry) {
    const level = await decoded(this.lods[place], this.renderer, { hurry });
    if (!this.disposed) await this.prepare(level);
    if (this.disposed) {
      dispose(level);
      return;
    }
    this.#levels[place] = level;
    this.object.add(level);
    this.#show();
    this.onLevel(this.lods[place].level);
  }

  #release() {
    this.#show();
    const finest = this.#finest;
    if (finest >= this.#wanted || this.#loading) {
      this.#unwantedSince = 0;
      return;
    }
    this.#unwantedSince ||= performance.now();
    if (performance.now() - this.#unwantedSince < RELEASE_MS) return;
    dispose(this.#levels[finest]);
    this.#levels[finest].removeFromParent();
    delete this.#levels[finest];
  }

  #show() {
    this.#levels.forEach((level, place) => {
      level.visible = place === this.shown;
    });
  }
}
