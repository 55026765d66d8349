// The panels of the viewer's page for the one thing or the scene that it shows, and who gets them. A panel's module is loaded when the panel is opened.
import { isLoaded } from '../scenes/scene-item.js';
import { attempt } from '../shared/attempt.js';
import { child, create, element } from '../shared/dom.js';
import { offline, sentences } from '../shared/problems.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { AssetEntry, AssetNames, Manifest, Session } from '../shared/types.d.ts' */
/** @import { Stage } from '../graphics/scene.js' */
/** @import { Measuring, MeasuringCallbacks } from './measuring.js' */
/** @import { NotesCallbacks } from './notes.js' */
/** @import { SceneItem } from '../scenes/scene-item.js' */
/** @import { SceneOffer } from './scene-panel.js' */

const page = {
  about: element('about', HTMLDetailsElement),
  downloads: element('downloads', HTMLDetailsElement),
  measure: element('measure', HTMLDetailsElement),
  names: element('names', HTMLDetailsElement),
  share: element('share', HTMLDetailsElement),
  edit: element('edit', HTMLAnchorElement),
  scene: element('scene', HTMLDetailsElement),
  add: element('add', HTMLDetailsElement),
};

/**
 * Shows a panel, and fills it when it is opened; where that fails it says why, and tries again when it is next opened. Until it is filled
 * nothing in it can be pressed: the browser would send its form, and what is saved would be empty.
 * @param {HTMLDetailsElement} panel
 * @param {() => Promise<void>} fill
 */
function offer(panel, fill) {
  const trouble = child(panel, '[role=alert]', HTMLElement);
  const content = [...panel.children].filter((part) => part.tagName !== 'SUMMARY' && part !== trouble);
  const setInert = (/** @type {boolean} */ inert) => content.forEach((part) => part.toggleAttribute('inert', inert));
  let isFilling = false;
  const open = async () => {
    if (!panel.open || isFilling) return;
    isFilling = true;
    await attempt(trouble, async () => {
      await fill();
      panel.removeEventListener('toggle', open);
      setInert(false);
    });
    isFilling = false;
  };
  setInert(true);
  panel.hidden = false;
  panel.addEventListener('toggle', open);
}

/**
 * Waits for a module; one that does not come is a problem of the connection.
 * @template T
 * @param {Promise<T>} loading
 * @returns {Promise<T>}
 * @throws {Problem} OFFLINE
 */
async function loadModule(loading) {
  try {
    return await loading;
  } catch (error) {
    console.error(error);
    throw offline();
  }
}

/**
 * Opens a panel that the page's address names, as a card of the collection's page does.
 * @param {HTMLDetailsElement} panel
 */
function openIfNamed(panel) {
  if (location.hash !== `#${panel.id}`) return;
  panel.open = true;
  child(panel, 'summary', HTMLElement).focus(); // where who uses keys or a screen reader goes on
}

/**
 * Offers the thing for other programs, and its splats on this page. `#downloads` in the page's address opens them at once.
 * @param {SceneItem} item
 * @param {Stage} stage
 * @param {() => void} redraw
 */
export function offerDownloads(item, stage, redraw) {
  const show = async (/** @type {ArrayBuffer} */ bytes) => {
    const { showSplats } = await import('../scenes/splats.js');
    if (isLoaded(item)) await showSplats(item, bytes, stage, redraw);
  };
  offer(page.downloads, async () => {
    const { showDownloads } = await loadModule(import('./downloads.js'));
    await showDownloads(item, show);
  });
  openIfNamed(page.downloads);
}

/**
 * Offers to read how good the thing is and how it was made, once it is there; anew for each version.
 * @param {SceneItem} item
 * @param {(entry: AssetEntry) => Promise<Manifest>} loadManifest
 */
export function offerAbout(item, loadManifest) {
  let shown = 0; // the version that the panel is about, or will be
  const fill = async () => {
    const { entry } = item;
    if (!page.about.open || !entry || entry.version === shown) return;
    shown = entry.version;
    try {
      const { showAbout } = await loadModule(import('./about.js'));
      await showAbout(entry, loadManifest);
    } catch (error) {
      shown = 0; // tried again when it is next opened
      element('about-text', HTMLElement).replaceChildren(create('p', { textContent: sentences(error) }));
    }
  };
  page.about.hidden = false;
  page.about.addEventListener('toggle', fill);
  return fill;
}

/**
 * Offers to measure the thing.
 * @param {SceneItem} item
 * @param {Stage} stage
 * @param {MeasuringCallbacks} callbacks
 * @returns {() => void} to be called for each version that is shown
 */
export function offerMeasuring(item, stage, callbacks) {
  /** @type {Measuring | null} */
  let measuring = null;
  offer(page.measure, async () => {
    const { Measuring: Panel } = await loadModule(import('./measuring.js'));
    measuring = new Panel(item, stage, callbacks);
    measuring.update();
  });
  return () => measuring?.update();
}

/**
 * Shows the notes that are pinned to the thing, and lets somebody who manages it pin some.
 * @param {SceneItem} item
 * @param {Stage} stage
 * @param {NotesCallbacks} callbacks
 * @param {Session | null} session
 * @returns {Promise<() => void>} to be called for each version that is shown
 */
export async function offerNotes(item, stage, callbacks, session) {
  const { Notes: Panel } = await import('./notes.js');
  const notes = new Panel(item, stage, callbacks);
  if (session?.scopes.includes('manage') && ofShownTenant('') === '') notes.allowPinning();
  let shown = 0; // the version whose notes are there
  return () => {
    const version = item.entry?.version ?? shown;
    if (version === shown) return;
    shown = version;
    notes.load();
  };
}

/**
 * Offers to name, to edit and to share the thing to somebody who manages it.
 * @param {SceneItem} item
 * @param {Session | null} session
 * @param {(names: AssetNames) => void} onNames is called with names that were saved
 */
export function offerManaging({ key }, session, onNames) {
  if (!session?.scopes.includes('manage') || ofShownTenant('') !== '') return;
  page.edit.href = `/edit/${encodeURIComponent(key)}`;
  page.edit.hidden = !session.scopes.includes('capture');
  offer(page.names, async () => {
    const { showNaming } = await loadModule(import('./naming.js'));
    await showNaming(key, onNames);
  });
  if (session.via !== 'session') return; // without accounts there is nobody to share it with
  offer(page.share, async () => {
    const { showSharing } = await loadModule(import('./sharing.js'));
    await showSharing(key);
  });
}

/** Hides what is about one thing alone: the page shows several from now on. */
export function hidePanelsOfOne() {
  for (const panel of [page.about, page.downloads, page.measure, page.names, page.edit]) panel.hidden = true;
  page.share.hidden ||= !document.body.dataset.scene;
}

/**
 * Offers to add things of a collection.
 * @param {(key: string) => void} onChoose
 * @param {() => string} collection
 */
export function offerAdding(onChoose, collection) {
  offer(page.add, async () => {
    const { showAdding } = await loadModule(import('./add-thing.js'));
    await showAdding(onChoose, collection());
  });
}

/**
 * Offers to save the scene, and to share one that is saved.
 * @param {SceneOffer} scene
 * @returns {() => void} to be called when it was saved for the first time, or deleted
 */
export function offerScene(scene) {
  let update = () => {};
  offer(page.scene, async () => {
    const { showScenePanel } = await loadModule(import('./scene-panel.js'));
    update = showScenePanel(scene);
  });
  const id = scene.id();
  if (id && scene.canShare) {
    offer(page.share, async () => {
      const { showSharingOfScene } = await loadModule(import('./sharing.js'));
      await showSharingOfScene(id);
    });
  }
  return () => {
    if (id && !scene.id()) page.share.hidden = true; // its links have ended with it
    update();
  };
}
