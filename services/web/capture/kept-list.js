// The list of captures that are kept on this device: photos that were not sent yet, what waits for the server, and what came of it.
import { forget, listKept, readKeptFiles } from '../shared/kept-captures.js';
import { sendKept } from '../shared/send-kept.js';
import { create, element } from '../shared/dom.js';
import { sentences } from '../shared/problems.js';
import { ownTenant } from '../shared/whose.js';
import { keptId } from './keeping.js';
import { t } from '../shared/texts.js';

/** @import { KeptCapture } from '../shared/kept-captures.js' */

const page = {
  section: element('kept-captures', HTMLElement),
  list: element('kept-list', HTMLElement),
  trouble: element('kept-trouble', HTMLElement),
};

/** @type {(draft: KeptCapture) => void} */
let onGoOn = () => {};
/** @type {Promise<void> | null} */
let sending = null;

/**
 * Shows what is kept, and sends what waits: now, and whenever there is a network again.
 * @param {(draft: KeptCapture) => void} goOn is called with a draft, or what was refused, that the person wants to go on with
 */
export async function startKeptList(goOn) {
  onGoOn = goOn;
  window.addEventListener('online', sendWaiting);
  await showKept();
  await sendWaiting();
}

/** Sends what waits, and shows how that goes. */
async function sendWaiting() {
  sending ??= sendAll().finally(() => (sending = null));
  await sending;
}

async function sendAll() {
  if (!(await listKept(ownTenant())).some(({ state }) => state === 'waiting')) return;
  page.trouble.textContent = '';
  try {
    await sendKept((capture, fraction) => {
      const text = document.getElementById(`kept-${capture.id}`);
      if (text) {
        text.textContent = `${capture.name}: ${t('{percent} % sent', { percent: Math.round(100 * fraction) })}.`;
      }
    });
  } catch (error) {
    page.trouble.textContent = sentences(error);
  }
  await showKept();
}

/** Shows what is kept, but for the capture that this page is making. */
export async function showKept() {
  const others = (await listKept(ownTenant())).filter(({ id }) => id !== keptId());
  const items = await Promise.all(others.map(itemOf));
  page.list.replaceChildren(...items);
  page.section.hidden = items.length === 0;
  document.body.dataset.kept = others.map(({ state }) => state).join(' ');
}

/** @param {KeptCapture} capture */
async function itemOf(capture) {
  const item = create('li');
  const buttons = create('div', { className: 'kept-buttons' });
  item.append(create('span', { id: `kept-${capture.id}`, textContent: await sentenceOf(capture) }), buttons);
  if (capture.state === 'draft') buttons.append(button(t('Go on'), () => onGoOn(capture)));
  if (capture.state === 'refused') buttons.append(button(t('Change it'), () => onGoOn(capture)));
  if (capture.state === 'waiting') buttons.append(button(t('Send now'), sendWaiting));
  if (capture.state === 'sent') buttons.append(button(t('See it'), () => seeJob(capture)));
  buttons.append(button(capture.state === 'sent' ? t('Done') : t('Delete'), () => remove(capture)));
  return item;
}

/** @param {KeptCapture} capture */
async function sentenceOf({ id, state, name, created, trouble }) {
  if (state === 'sent') return t('{name}: sent.', { name });
  if (state === 'refused') return `${name}: ${trouble}`;
  if (state === 'waiting') return t('{name}: it waits for the server.', { name });
  const count = (await readKeptFiles(id)).length;
  const photos = count === 1 ? t('1 photo') : t('{count} photos', { count });
  const text = t('{photos} of {date}, not sent.', { photos, date: new Date(created).toLocaleString() });
  return name ? `${name}: ${text}` : text;
}

/**
 * @param {string} text
 * @param {() => void} work
 */
function button(text, work) {
  const made = create('button', { type: 'button', textContent: text });
  made.addEventListener('click', work);
  return made;
}

/** @param {KeptCapture} capture */
async function seeJob({ id, job }) {
  await forget(id);
  location.hash = `job=${job}`;
  location.reload();
}

/** @param {KeptCapture} capture */
async function remove({ id, state }) {
  if (state !== 'sent' && !window.confirm(t('Delete these photos? They are on this device only.'))) return;
  await forget(id);
  await showKept();
}
