// Going on with photos that were taken earlier and not sent, and with what the server has refused: on the page of the thing that they belong to.
import { addedTo } from './continuing.js';
import { goOn } from './file-choice.js';
import { showKept } from './kept-list.js';
import { listKept } from '../shared/kept-captures.js';
import { ownTenant } from '../shared/whose.js';

/** @import { KeptCapture } from '../shared/kept-captures.js' */

/**
 * Goes on with a draft here, or opens the page of its thing with it where this one is another's, or shows no form.
 * @param {KeptCapture} draft
 * @returns {Promise<KeptCapture | undefined>} the draft, where the form has it now
 */
export async function openDraft(draft) {
  const { id, adds = '' } = draft;
  if (adds === addedTo() && document.body.dataset.state === 'choosing') {
    return takeDraft(draft);
  }
  location.hash = String(new URLSearchParams(adds ? { add: adds, draft: id } : { draft: id }));
  location.reload();
  return undefined;
}

/** Goes on with the draft that the page's address names, if it names one that is there; returns it. */
export async function resumeDraft() {
  const id = new URLSearchParams(location.hash.slice(1)).get('draft');
  const draft = (await listKept(ownTenant())).find(
    (each) => each.id === id && ['draft', 'refused'].includes(each.state),
  );
  return draft && takeDraft(draft);
}

/** @param {KeptCapture} draft */
async function takeDraft(draft) {
  await goOn(draft);
  await showKept();
  return draft;
}
