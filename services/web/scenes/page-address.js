// What the page's address asks for: assets, a saved scene or a wardrobe; and the entries of assets, which are asked for at once.
import { checkEntry } from '../catalogue/signed-catalogue.js';
import { getCachedJson } from '../shared/api.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const MOST = 24; // things in one scene

/** The id of the saved scene in the page's address; '' without one. */
export const sceneId = /^\/scene\/([^/]+)$/.exec(location.pathname)?.[1] ?? '';
/** The collection whose wardrobe the page's address names; '' without one. */
export const wardrobeOf = decodeURIComponent(/^\/wardrobe\/([^/]+)$/.exec(location.pathname)?.[1] ?? '');
/** The assets' keys in the page's address. */
export const keys = sceneId || wardrobeOf ? [] : keysFrom(location);
/** The entry of the only asset that the address names, asked for at once, and checked; null for none and for several. */
export const firstEntry = keys.length === 1 ? askForEntry(keys[0]).then(checkEntry) : null;
let asked = firstEntry;

/**
 * The assets' keys in an address.
 * @param {Location} address
 */
function keysFrom({ pathname, search }) {
  const key = pathname.split('/')[2];
  const found = key ? [decodeURIComponent(key)] : new URLSearchParams(search).getAll('key');
  return [...new Set(found)].slice(0, MOST);
}

/**
 * Asks for an asset's entry, which is to be checked.
 * @param {string} key
 * @returns {Promise<AssetEntry>}
 */
function askForEntry(key) {
  return getCachedJson(ofShownTenant(`/v1/assets/${encodeURIComponent(key)}`));
}

/**
 * Asks for the newest version of an asset, and checks it. The first answer is the one that this module has asked for.
 * @param {string} key
 * @param {number} [known] the version that the page shows
 * @returns {Promise<AssetEntry | null>} null: there is no newer one
 * @throws {Problem} as `checkEntry`
 */
export async function nextEntry(key, known) {
  const first = asked;
  asked = null;
  if (first) return first;
  const entry = await askForEntry(key);
  return entry.version === known ? null : checkEntry(entry);
}
