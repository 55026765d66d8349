// What whoever manages a collection does with the chosen things: remove them, restore them, delete them for good.
import { deleteAt, postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { sentences } from '../shared/problems.js';
import { onSecondPress } from '../shared/second-press.js';
import { t } from '../shared/texts.js';
import { reloadForOtherTenant } from '../shared/whose.js';

/** @import { Session } from '../shared/types.d.ts' */

const buttons = {
  remove: element('remove', HTMLButtonElement),
  restore: element('restore', HTMLButtonElement),
  delete: element('delete', HTMLButtonElement),
};
const removedOption = /** @type {HTMLOptionElement} */ (
  element('state', HTMLSelectElement).querySelector('[value=removed]')
);

/** @type {Record<'remove' | 'restore' | 'delete', (asset: string) => Promise<unknown>>} */
const ACTIONS = {
  remove: (asset) => postJson(`${asset}/remove`, {}),
  restore: (asset) => postJson(`${asset}/restore`, {}),
  delete: (asset) => deleteAt(asset),
};
const SAID = {
  remove: t('removed; “Show: removed ones” has them'),
  restore: t('restored'),
  delete: t('deleted for good'),
};

/**
 * Offers to manage things to somebody who may.
 * @param {Session | null} session
 * @param {{ chosen: () => string[], onDone: (said: string) => void }} page chosen: keys; onDone: is called with what was done
 */
export function offerManaging(session, { chosen, onDone }) {
  if (!session?.scopes.includes('manage')) return;
  removedOption.hidden = removedOption.disabled = false;
  let busy = false;
  const act = async (/** @type {keyof typeof ACTIONS} */ name) => {
    if (busy || reloadForOtherTenant()) return;
    busy = true;
    showBusy(true);
    const said = await doAll(chosen(), name);
    busy = false;
    showBusy(false);
    onDone(said);
  };
  buttons.remove.addEventListener('click', () => act('remove'));
  buttons.restore.addEventListener('click', () => act('restore'));
  onSecondPress(buttons.delete, t('Tap again: it cannot be undone'), () => act('delete'));
  document.body.dataset.manages = 'yes';
}

/**
 * Not by `disabled`, which would take the focus from the button that was pressed.
 * @param {boolean} busy
 */
function showBusy(busy) {
  for (const button of Object.values(buttons)) button.setAttribute('aria-disabled', String(busy));
}

/**
 * Shows the buttons for things of a state.
 * @param {boolean} removed whether removed things are shown
 */
export function showManaging(removed) {
  const manages = document.body.dataset.manages === 'yes';
  buttons.remove.hidden = !manages || removed;
  buttons.restore.hidden = buttons.delete.hidden = !manages || !removed;
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
