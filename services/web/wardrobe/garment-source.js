// Where the wardrobe's garments come from: the signed collection, and their files, loaded ahead.
import { loadFirstRows } from '../catalogue/collection-rows.js';
import { withNewest } from '../catalogue/signed-catalogue.js';
import { loadFile } from '../catalogue/verified-cache.js';
import { nextEntry } from '../scenes/page-address.js';

/**
 * Loads the rows of a collection, the first ones where there are very many.
 * @param {string} name
 * @returns {ReturnType<typeof loadFirstRows>}
 * @throws {Problem} as `loadCollection` and `loadFirstRows`
 */
export const loadGarmentRows = (name) => withNewest(name, (collection) => loadFirstRows(collection));

/**
 * Loads the coarsest level of an asset onto this device, so that it is there at once when it is to be shown. What does not come is said then.
 * @param {string} key
 */
export async function preload(key) {
  try {
    const entry = await nextEntry(key);
    const coarsest = entry?.lods.toSorted((one, other) => other.level - one.level)[0];
    if (coarsest) await loadFile(coarsest);
    document.body.dataset.preloaded = key; // for tests and for scripts
  } catch {
    // nothing is shown of it yet
  }
}
