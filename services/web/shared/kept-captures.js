// Captures that wait on this device: photos that were taken and are not sent yet, and captures that found no server. Kept in IndexedDB, which
// pages and the service worker share.
import { t } from './texts.js';
import { KEPT_STORAGE_MS, withTimeLimit } from './time-limits.js';

const DATABASE = 'capture2vr-kept';
const [CAPTURES, FILES] = ['captures', 'files'];

/** @import { MarkedBox } from './upload-form.js' */
/** @typedef {{ path: string, body: Record<string, unknown> }} JobOrder what is posted, and where, once the capture's id is known */

/**
 * A capture that is kept. Times are milliseconds since 1970.
 * @typedef {object} KeptCapture
 * @property {string} id
 * @property {string} tenant who was logged in; '' where nobody had to
 * @property {number} created
 * @property {'draft' | 'waiting' | 'sent' | 'refused'} state a draft is still being made, and never sent
 * @property {string} name of the thing; '' where a draft has none yet
 * @property {string} jobKey with which the job is made once, however often it is asked for
 * @property {MarkedBox | null} box the rectangle that the object lies in
 * @property {JobOrder | null} order null for a draft
 * @property {string} continues id of the stored capture that these photos are added to; '' for none
 * @property {string} [adds] id of the job whose thing these photos are added to; '' for a new thing
 * @property {string} filetype media type of the form that is uploaded
 * @property {string} upload address of the upload, once it has begun
 * @property {string} capture id of the stored capture, once it is there
 * @property {string} job id of the job, once it is made
 * @property {string} trouble why the server refused it
 */

/**
 * A file of a capture, in the order in which they were added.
 * @typedef {object} KeptFile
 * @property {string} id of its capture
 * @property {number} number
 * @property {string} path
 * @property {number} lastModified
 * @property {number | null} heading degrees: where the camera looked
 * @property {Blob} body
 */

/** @type {Promise<IDBDatabase> | null} */
let opened = null;

/**
 * Reads all captures that are kept for a tenant, the oldest first. None where the browser keeps nothing.
 * @param {string} tenant
 * @returns {Promise<KeptCapture[]>}
 */
export async function listKept(tenant) {
  /** @type {KeptCapture[]} */
  const all = await run('readonly', (stores) => stores(CAPTURES).getAll()).catch(() => []);
  return all.filter((each) => each.tenant === tenant).sort((one, other) => one.created - other.created);
}

/**
 * Reads one as it is now; undefined where it is gone.
 * @param {string} id
 * @returns {Promise<KeptCapture | undefined>}
 */
export const readKept = (id) => run('readonly', (stores) => stores(CAPTURES).get(id));

/**
 * Reads the files of a capture.
 * @param {string} id
 * @returns {Promise<KeptFile[]>}
 */
export const readKeptFiles = (id) => run('readonly', (stores) => stores(FILES).getAll(rangeOf(id)));

/**
 * Keeps a capture, with some of its files: all of it, or nothing and an error.
 * @param {KeptCapture} capture
 * @param {KeptFile[]} [files] that are added, or that take the place of those with their numbers
 * @throws {DOMException} a full device, a private window, a browser without IndexedDB
 */
export async function keep(capture, files = []) {
  await run('readwrite', (stores) => {
    for (const file of files) stores(FILES).put(file);
    return stores(CAPTURES).put(capture);
  });
}

/**
 * Keeps a capture with these files alone, and forgets what else was kept of it: all of it, or nothing and an error.
 * @param {KeptCapture} capture
 * @param {KeptFile[]} added
 * @param {number[]} earlier numbers of the files that were kept before, and stay
 * @throws {DOMException} as `keep`
 */
export async function keepAlone(capture, added, earlier) {
  await run('readwrite', (stores) => {
    /** @type {IDBRequest<KeptFile[]>} */
    const before = stores(FILES).getAll(rangeOf(capture.id));
    before.onsuccess = () => {
      for (const { id, number } of before.result) if (!earlier.includes(number)) stores(FILES).delete([id, number]);
    };
    for (const file of added) stores(FILES).put(file);
    return stores(CAPTURES).put(capture);
  });
}

/**
 * Forgets one file of a capture.
 * @param {string} id
 * @param {number} number
 */
export const forgetFile = (id, number) => run('readwrite', (stores) => stores(FILES).delete([id, number]));

/**
 * Forgets the files of a capture that has been sent.
 * @param {string} id
 */
export const forgetFiles = (id) => run('readwrite', (stores) => stores(FILES).delete(rangeOf(id)));

/**
 * Forgets a capture with all its files.
 * @param {string} id
 */
export const forget = (id) =>
  run('readwrite', (stores) => {
    stores(FILES).delete(rangeOf(id));
    return stores(CAPTURES).delete(id);
  });

/**
 * A capture that begins now, as a draft.
 * @param {Pick<KeptCapture, 'id' | 'tenant' | 'jobKey' | 'filetype' | 'name' | 'adds'>} made
 * @returns {KeptCapture}
 */
export const newKept = (made) => ({
  ...made,
  created: Date.now(),
  state: 'draft',
  box: null,
  order: null,
  continues: '',
  upload: '',
  capture: '',
  job: '',
  trouble: '',
});

/** All files of a capture. @param {string} id */
const rangeOf = (id) => IDBKeyRange.bound([id], [id, []]); // an array sorts behind every number

/** @typedef {(name: string) => IDBObjectStore} Stores */

/**
 * Runs one transaction, and waits until it is on the disk.
 * @template T
 * @param {IDBTransactionMode} mode
 * @param {(stores: Stores) => IDBRequest<T>} work
 * @returns {Promise<T>} the result of the request
 */
async function run(mode, work) {
  const database = await withTimeLimit(open(), KEPT_STORAGE_MS);
  return withTimeLimit(
    new Promise((resolve, reject) => {
      const transaction = database.transaction([CAPTURES, FILES], mode, { durability: 'strict' });
      const request = work((name) => transaction.objectStore(name));
      transaction.oncomplete = () => resolve(request.result);
      transaction.onabort = () =>
        reject(transaction.error ?? new DOMException(t('The browser gave up.'), 'AbortError'));
    }),
    KEPT_STORAGE_MS,
  );
}

/** @returns {Promise<IDBDatabase>} */
function open() {
  opened ??= new Promise((resolve, reject) => {
    if (typeof indexedDB === 'undefined') throw new DOMException(t('This browser keeps nothing.'), 'NotSupportedError');
    const request = indexedDB.open(DATABASE, 1);
    request.onupgradeneeded = () => {
      request.result.createObjectStore(CAPTURES, { keyPath: 'id' });
      request.result.createObjectStore(FILES, { keyPath: ['id', 'number'] });
    };
    request.onsuccess = () => {
      request.result.onversionchange = () => request.result.close();
      request.result.onclose = () => (opened = null);
      resolve(request.result);
    };
    request.onerror = () =>
      reject(request.error ?? new DOMException(t('The browser keeps nothing here.'), 'UnknownError'));
  });
  opened.catch(() => (opened = null)); // the next one tries again
  return opened;
}
