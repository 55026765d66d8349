// Where the viewer page begins: says whose page it is and shows the poster while the 3D library, half a megabyte of it, is still on its way.
import { hidePoster, showPoster } from './poster.js';
import { createContext } from '../graphics/webgl-context.js';
import { getCachedJson } from '../shared/api.js';
import { create, element } from '../shared/dom.js';
import { checkEntry } from '../shared/signed-catalogue.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const MOST = 24; // things in one scene
const POSTER_MS = 1000; // longest that the library waits for the poster

/** The id of the saved scene in the page's address; '' without one. */
export const sceneId = /^\/scene\/([^/]+)$/.exec(location.pathname)?.[1] ?? '';
/** The collection whose wardrobe the page's address names; '' without one. */
export const wardrobeOf = decodeURIComponent(/^\/wardrobe\/([^/]+)$/.exec(location.pathname)?.[1] ?? '');
/** The assets' keys in the page's address. */
export const keys = sceneId || wardrobeOf ? [] : keysFrom(location);
let asked = keys.length === 1 ? askForEntry(keys[0]).then(checkEntry) : null;
/** The stage's WebGL context, created while the catalogue's answer is on its way. */
export const context = createContext(element('stage', HTMLCanvasElement));

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

/**
 * Shows name and poster of the thing that the page is about.
 * @param {Promise<AssetEntry>} answer
 */
async function showFirst(answer) {
  const entry = await answer;
  if (document.body.dataset.version) return; // the mesh was faster
  element('label', HTMLElement).textContent = entry.label || entry.key;
  await showPoster(entry, () => !document.body.dataset.version);
}

/** Asks for the viewer and all modules that it imports at once: without that each waits until its importer has come. */
function preloadViewer() {
  for (const href of JSON.parse(element('later', HTMLScriptElement).text)) document.head.append(create('link', { rel: 'modulepreload', href }));
}

// The poster first: on a slow line the library would take seconds from it.
const shown = asked ? showFirst(asked).catch(hidePoster) : null; // the viewer gets the same error, and says it
await Promise.race([shown, new Promise((resolve) => setTimeout(resolve, POSTER_MS))]);
preloadViewer();
import('./viewer.js').catch((error) => {
  console.error(error);
  dispatchEvent(new ErrorEvent('error', { error })); // to the guard of the page's start, which says it where the viewer has not started
});
