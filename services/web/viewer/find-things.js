// Searching a collection for things to add to a scene, twelve at a time.
import { getJson } from '../shared/api.js';

/** @import { FoundAssets } from '../shared/types.d.ts' */

/** Things of a page: three rows of four on a wall, each large enough to be pointed at. */
export const PER_PAGE = 12;

/**
 * Finds things by part of their name, or by one of their labels.
 * @param {string} collection
 * @param {string} words
 * @param {string} after `next` of the page before; '' for the first page
 * @returns {Promise<FoundAssets>}
 * @throws {Problem} as `getJson`
 */
export function findThings(collection, words, after) {
  const query = new URLSearchParams({ label: words, after, limit: String(PER_PAGE) });
  return getJson(`/v1/collections/${encodeURIComponent(collection)}/assets?${query}`);
}
