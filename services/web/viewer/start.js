// Where the viewer page begins: says whose page it is and shows the poster while the 3D library, half a megabyte of it, is still on its way.
import { hidePoster, showPoster } from './poster.js';
import { getCachedJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { checkEntry } from '../shared/signed-catalogue.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const MOST = 24; // things in one scene
const POSTER_MS = 1000; // longest that the library waits for the poster

/** The id of the saved scene in the page's address; '' without one. */
export const sceneId = /^\/scene\/([^/]+)$/.exec(location.pathname)?.[1] ?? '';
/** The assets' keys in the page's address. */
export const keys = sceneId ? [] : keysFrom(location);
let asked = keys.length === 1 ? askForEntry(keys[0]) : null;

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
 * Asks for the newest entry of an asset. The first answer is the one that this module has asked for.
 * @param {string} key
 * @returns {Promise<AssetEntry>} to be checked
 */
export function nextEntry(key) {
  const entry = asked ?? askForEntry(key);
  asked = null;
  return entry;
}

/**
 * Shows name and poster of the thing that the page is about.
 * @param {Promise<AssetEntry>} answer
 */
async function showFirst(answer) {
  const entry = await checkEntry(await answer);
  if (document.body.dataset.version) return; // the mesh was faster
  element('label', HTMLElement).textContent = entry.label || entry.key;
  await showPoster(entry, () => !document.body.dataset.version);
}

// The poster first: on a slow line the library would take seconds from it.
const shown = asked ? showFirst(asked).catch(hidePoster) : null; // the viewer gets the same error, and says it
await Promise.race([shown, new Promise((resolve) => setTimeout(resolve, POSTER_MS))]);
import('./viewer.js').catch((error) => {
  console.error(error);
  dispatchEvent(new ErrorEvent('error', { error })); // to the guard of the page's start, which says it where the viewer has not started
});
