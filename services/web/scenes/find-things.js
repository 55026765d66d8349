// Searching a collection for things to add to a scene, twelve at a time.
import { getJson } from '../shared/api.js';

/** @import { FoundAsset, FoundAssets } from '../shared/types.d.ts' */

/** Things of a page: three rows of four on a wall, each large enough to be pointed at. */
export const PER_PAGE = 12;

const FIRST = [''];

/** A search, and where it stands. Pages are lists of beginnings: those of all pages up to the one that is meant. */
export class ThingSearch {
  #pages = FIRST;
  /** @type {string | null} */
  #following = null;
  #asked = 0;
  #what = ''; // is looked for

  /** The page before the one that was found last; null before the first one. */
  get previous() {
    return this.#pages.length > 1 ? this.#pages.slice(0, -1) : null;
  }

  /** The page after it; null behind the last one. */
  get next() {
    return this.#following === null ? null : [...this.#pages, this.#following];
  }

  /**
   * Finds things by part of their name, or by one of their labels.
   * @param {string} collection
   * @param {string} words
   * @param {string[]} [pages] `previous` or `next`; without it the first page
   * @returns {Promise<FoundAsset[] | null>} null where something else has been asked for since
   * @throws {Problem} as `getJson`
   */
  async find(collection, words, pages = FIRST) {
    const mine = ++this.#asked;
    const what = JSON.stringify([collection, words]);
    if (what !== this.#what) [this.#what, this.#pages, this.#following] = [what, FIRST, null]; // whether or not it is found
    try {
      let found = await getPage(collection, words, pages.at(-1) ?? '');
      while (mine === this.#asked && found.assets.length === 0 && found.next !== null) {
        found = await getPage(collection, words, found.next);
      } // what is being indexed has pages with nothing on them
      if (mine !== this.#asked) return null;
      [this.#pages, this.#following] = [pages, found.next];
      return found.assets;
    } catch (error) {
      if (mine !== this.#asked) return null;
      throw error;
    }
  }
}

/**
 * @param {string} collection
 * @param {string} words
 * @param {string} after
 * @returns {Promise<FoundAssets>}
 * @throws {Problem} as `getJson`
 */
function getPage(collection, words, after) {
  const query = new URLSearchParams({ label: words, after, limit: String(PER_PAGE) });
  return getJson(`/v1/collections/${encodeURIComponent(collection)}/assets?${query}`);
}
