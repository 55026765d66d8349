// Keeps what the page has on the device: photos as they are taken, and the whole capture when the server cannot be reached. What cannot be kept
// is said, and stays in the page.
import { forget, forgetFile, keep, keepAlone, newKept, readKept, readKeptFiles } from '../shared/kept-captures.js';
import { exclusively } from '../shared/send-kept.js';
import { t } from '../shared/texts.js';
import { newFiletype, pathOf, randomKey } from '../shared/upload-form.js';
import { ownTenant } from '../shared/whose.js';

/** @import { JobOrder, KeptCapture, KeptFile } from '../shared/kept-captures.js' */
/** @import { About } from '../shared/upload-form.js' */

const SYNC = 'send-captures'; // the service worker listens to this

let continued = { adds: '', name: '' }; // the job whose thing the photos are added to, and what that thing is called
/** @type {KeptCapture} */
let kept = begin();
/** @type {Map<File, number>} */
const numbers = new Map(); // of the files that are on the device
let lastNumber = 0;
/** @type {Promise<unknown>} */
let queue = Promise.resolve(); // one write after the other

/** A capture of this page; nothing of it is on the device yet. */
function begin() {
  return newKept({
    id: `${Date.now()}-${randomKey()}`,
    tenant: ownTenant(),
    jobKey: randomKey(),
    filetype: newFiletype(),
    ...continued,
  });
}

/**
 * Writes down whose thing the photos are added to, so that a draft is added to it later too.
 * @param {string} adds id of the job that made it; '' for a new thing
 * @param {string} [name] of the thing, once it is known
 */
export const keepContinued = (adds, name = '') =>
  inTurn(async () => {
    continued = { adds, name };
    kept = { ...kept, adds, name: name || kept.name };
    if (numbers.size > 0) await keep(kept).catch(() => {}); // the next photo writes it too
  });

/** Begins another capture: photos that the person has replaced are nowhere else, and stay on the device as a draft. */
export const beginAnother = () =>
  inTurn(async () => {
    kept = begin();
    numbers.clear();
  });

/** The key with which this capture's job is made once, from here or by the service worker. */
export const jobKey = () => kept.jobKey;

/** The capture's id on the device. */
export const keptId = () => kept.id;

/**
 * Keeps a photo that was taken here, and is nowhere else.
 * @param {File} file
 * @param {number | null} heading degrees
 * @returns {Promise<string>} why that is impossible, as a sentence; '' where it is done
 */
export const keepPhoto = (file, heading) =>
  inTurn(async () => {
    askForDurability();
    return attempt([newFile(file, heading)], (rows) => keep(kept, rows));
  });

/**
 * Forgets a photo that the person has removed.
 * @param {File} file
 */
export function forgetPhoto(file) {
  const number = numbers.get(file);
  numbers.delete(file);
  if (number === undefined) return;
  inTurn(() => (numbers.size > 0 ? forgetFile(kept.id, number) : forget(kept.id)).catch(() => {}));
}

/**
 * Keeps the whole capture, to be sent later.
 * @param {File[]} files
 * @param {{ name: string, about: About, order: JobOrder, capture: string }} told `capture`: its id, where the server has it already
 * @returns {Promise<string>} why that is impossible, as a sentence; '' where it is done
 */
export const keepWhole = (files, { name, about, order, capture }) =>
  inTurn(async () => {
    Object.assign(kept, { ...about, state: 'waiting', name, order, capture });
    const earlier = files.flatMap((file) => numbers.get(file) ?? []);
    const added = files.filter((file) => !numbers.has(file)).map((file) => newFile(file, null));
    const trouble = await attempt(added, (rows) => keepAlone(kept, rows, earlier));
    if (trouble) kept.state = 'draft';
    else await askForSync();
    return trouble;
  });

/** Makes a draft again of a capture that waits: the person changes it, and nobody sends it meanwhile. */
export const keepAsDraft = () =>
  inTurn(async () => {
    if (kept.state !== 'waiting') return;
    kept.state = 'draft';
    await keep(kept).catch(() => {}); // the next photo writes it too
  });

/**
 * Sends the capture from this page, unless the service worker has sent it meanwhile, and forgets it on the device.
 * @template T
 * @param {() => Promise<T>} work
 * @returns {Promise<T | string>} what the work gives, or the id of the job that is there already
 */
export const sendOnce = (work) =>
  exclusively(async () => {
    const now = await inTurn(() => readKept(kept.id)).catch(() => undefined);
    const sent = now?.state === 'sent' ? now.job : await work();
    await inTurn(() => forget(kept.id).catch(() => {})); // before anybody else may send: what still waits would be sent again
    return sent;
  });

/**
 * Goes on with a draft that was kept earlier, or with what was refused. Its photos now belong to what this page makes.
 * @param {KeptCapture} draft
 * @returns {Promise<{ file: File, heading: number | null }[]>} its photos
 */
export const goOnWith = (draft) =>
  inTurn(async () => {
    const files = await readKeptFiles(draft.id);
    kept = { ...draft, adds: continued.adds, name: continued.name || draft.name };
    if (draft.state === 'refused') {
      Object.assign(kept, { state: 'draft', jobKey: randomKey(), upload: '', capture: '', trouble: '' });
    }
    await keep(kept).catch(() => {}); // the next photo writes it too
    numbers.clear();
    return files.map(({ number, path, body, lastModified, heading }) => {
      const file = new File([body], path, { type: body.type, lastModified });
      numbers.set(file, number);
      lastNumber = Math.max(lastNumber, number);
      return { file, heading };
    });
  });

/**
 * @param {File} file
 * @param {number | null} heading
 * @returns {[File, KeptFile]}
 */
function newFile(file, heading) {
  lastNumber += 1;
  return [
    file,
    { id: kept.id, number: lastNumber, path: pathOf(file), lastModified: file.lastModified, heading, body: file },
  ];
}

/**
 * @param {[File, KeptFile][]} files
 * @param {(rows: KeptFile[]) => Promise<void>} write
 * @returns {Promise<string>}
 */
async function attempt(files, write) {
  try {
    await write(files.map(([, row]) => row));
  } catch (error) {
    return reasonOf(error);
  }
  for (const [file, { number }] of files) numbers.set(file, number);
  return '';
}

/** @param {unknown} error */
function reasonOf(error) {
  const full = error instanceof DOMException && error.name === 'QuotaExceededError';
  const reason = full
    ? t('This device has no room for it.')
    : t('This browser keeps nothing on the device here; a private window never does.');
  return `${reason} ${t('It is in this page only: leave the page open until it is sent.')}`;
}

/**
 * @template T
 * @param {() => Promise<T>} work
 * @returns {Promise<T>}
 */
function inTurn(work) {
  const result = queue.then(work);
  queue = result.catch(() => {});
  return result;
}

let asked = false;
/** Asks the browser not to throw away what is kept when the device fills up. */
function askForDurability() {
  if (!asked) navigator.storage?.persist?.().catch(() => {});
  asked = true;
}

/** Asks the browser to start the service worker when there is a network again, also after this page was closed; not every browser can. */
async function askForSync() {
  /** @type {(ServiceWorkerRegistration & { sync?: { register: (tag: string) => Promise<void> } }) | undefined} */
  const registration = await navigator.serviceWorker?.getRegistration().catch(() => undefined);
  await registration?.sync?.register(SYNC).catch(() => {});
}
