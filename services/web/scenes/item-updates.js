// Polling: loads the things of the scene, then asks for new versions of them, one after the other.

/** @import { SceneItem } from './scene-item.js' */

const PREVIEW_POLL_MS = 3000; // while a refined version may come
const REFINED_POLL_MS = 15_000; // once everything is refined
const LEAST_POLL_MS = 1000; // between two requests, however many things there are
/** Codes of problems with an asset that was deleted or taken back. */
export const GONE = ['ASSET_UNKNOWN', 'ASSET_REMOVED'];
const NOT_YET = ['ASSET_UNKNOWN', 'CATALOGUE_BEHIND']; // not published yet: it is on its way

/**
 * @typedef {object} UpdateCallbacks
 * @property {() => SceneItem[]} items
 * @property {() => boolean} isVisible whether anybody looks at the page
 * @property {(item: SceneItem) => Promise<void>} update asks for the item's version, and shows it where it is new
 * @property {(item: SceneItem, error: unknown) => void} onError
 */

/** Polls the catalogue for the items of a scene. */
export class ItemUpdates {
  #callbacks;
  /** @type {Map<SceneItem, Promise<void>>} */
  #running = new Map(); // a second update of an item would load the same files again

  /** @param {UpdateCallbacks} callbacks */
  constructor(callbacks) {
    this.#callbacks = callbacks;
  }

  /** Loads all items, then polls. */
  async poll() {
    const { items, isVisible } = this.#callbacks;
    await Promise.all(items().map((item) => this.update(item)));
    for (let turn = 0; ; turn++) {
      const mayChange = items().some(({ entry }) => entry?.state !== 'refined');
      const wait = Math.max(
        LEAST_POLL_MS,
        (mayChange ? PREVIEW_POLL_MS : REFINED_POLL_MS) / Math.max(1, items().length),
      );
      await new Promise((resolve) => setTimeout(resolve, wait));
      const item = items()[turn % Math.max(1, items().length)];
      if (item && isVisible()) await this.update(item);
    }
  }

  /**
   * Updates an item, or waits for the update of it that is running.
   * @param {SceneItem} item
   * @returns {Promise<void>}
   */
  update(item) {
    const { update, onError } = this.#callbacks;
    const running = this.#running.get(item);
    if (running) return running;
    const started = update(item)
      .catch((error) => onError(item, error))
      .finally(() => this.#running.delete(item));
    this.#running.set(item, started);
    return started;
  }
}

/**
 * Whether an item could not be loaded, so that trying again may help.
 * @param {SceneItem} item
 */
export function hasFailed(item) {
  return !item.entry && Boolean(item.code) && !NOT_YET.includes(item.code) && !isGone(item);
}

/**
 * Whether an item stands in a scene, and its asset was deleted or taken back.
 * @param {SceneItem} item
 */
export function isGone({ entry, code, placed }) {
  return !entry && placed !== null && GONE.includes(code);
}
