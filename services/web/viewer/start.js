// Where the viewer page begins: says whose page it is and shows the poster while the 3D library, half a megabyte of it, is still on its way.
import { firstEntry } from '../scenes/page-address.js'; // first of all: its request is on its way while the next one creates the context
import './stage-context.js';
import { hidePoster, showPoster } from './poster.js';
import { create, element } from '../shared/dom.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const POSTER_MS = 1000; // longest that the library waits for the poster

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
  for (const href of JSON.parse(element('later', HTMLScriptElement).text)) {
    document.head.append(create('link', { rel: 'modulepreload', href }));
  }
}

// The poster first: on a slow line the library would take seconds from it.
const shown = firstEntry ? showFirst(firstEntry).catch(hidePoster) : null; // the viewer gets the same error, and says it
await Promise.race([shown, new Promise((resolve) => setTimeout(resolve, POSTER_MS))]);
preloadViewer();
import('./viewer.js').catch((error) => {
  console.error(error);
  dispatchEvent(new ErrorEvent('error', { error })); // to the guard of the page's start, which says it where the viewer has not started
});
