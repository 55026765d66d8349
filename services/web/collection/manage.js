// What whoever manages a collection does with the chosen things: remove them, restore them, delete them for good.
import { deleteAt, postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { sentences } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Session } from '../shared/types.d.ts' */

const DELETE_ASKED_MS = 5_000; // for which the second tap deletes

const buttons = {
  remove: element('remove', HTMLButtonElement),
  restore: element('restore', HTMLButtonElement),
  delete: element('delete', HTMLButtonElement),
};
const removedOption = /** @type {HTMLOptionElement} */ (element('state', HTMLSelectElement).querySelector('[value=removed]'));

/** @type {Record<'remove' | 'restore' | 'delete', (asset: string) => Promise<unknown>>} */
const ACTIONS = {
  remove: (asset) => postJson(`${asset}/remove`, {}),
  restore: (asset) => postJson(`${asset}/restore`, {}),
  delete: (asset) => deleteAt(asset),
};
const SAID = { remove: t('removed; “Show: removed ones” has them'), restore: t('restored'), delete: t('deleted for good') };

/**
 * Offers to manage things to somebody who may.
 * @param {Session | null} session
 * @param {{ chosen: () => string[], onDone: (said: string) => void }} page chosen: keys; onDone: is called with what was done
 */
export function offerManaging(session, { chosen, onDone }) {
  if (!session?.scopes.includes('manage')) return;
  removedOption.hidden = removedOption.disabled = false;
  let asked = 0;
  for (const name of /** @type {const} */ (['remove', 'restore', 'delete'])) {
    buttons[name].addEventListener('click', async () => {
      if (name === 'delete' && Date.now() - asked > DELETE_ASKED_MS) {
        asked = Date.now();
        buttons.delete.textContent = t('Tap again: it cannot be undone');
        return;
      }
      onDone(await doAll(chosen(), name));
    });
  }
  document.body.dataset.manages = 'yes';
}

/**
 * Shows the buttons for things of a state.
 * @param {boolean} removed whether removed things are shown
 */
export function showManaging(removed) {
  const manages = document.body.dataset.manages === 'yes';
  buttons.remove.hidden = !manages || removed;
  buttons.restore.hidden = buttons.delete.hidden = !manages || !removed;
  buttons.delete.textContent = t('Delete for good');
}

/**
 * Does something with each thing; where one fails, the others are done all the same.
 * @param {string[]} keys
 * @param {keyof typeof ACTIONS} name
 * @returns {Promise<string>} what was done, and what went wrong
 */
async function doAll(keys, name) {
  const faults = [];
  for (const key of keys) {
    try {
      await ACTIONS[name](`/v1/assets/${encodeURIComponent(key)}`);
    } catch (error) {
      faults.push(`${key}: ${sentences(error)}`);
    }
  }
  const done = keys.length - faults.length;
  return [done > 0 ? `${done} ${SAID[name]}.` : '', ...faults].filter(Boolean).join(' ');
}
