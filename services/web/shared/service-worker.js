// The service worker: caches the pages with all their modules as one set (the shell), and serves that when the server does not; sends the
// captures that were kept on the device, once there is a network.
// The network comes first, so that nobody sees an old version while there is a new one. Catalogue entries and files of assets are not its
// business: api.js and verified-cache.js cache them.
import { cacheNames, deleteCache, deleteEntry, hasEntry, openCache, readEntry, writeEntry } from './cache-storage.js';
import { fetchBytes } from './network.js';
import { sendKept } from './send-kept.js';
import { CACHED_COPY_MS, NETWORK_SILENCE_MS } from './time-limits.js';

const worker = /** @type {ServiceWorkerGlobalScope} */ (/** @type {unknown} */ (self)); // as the compiler cannot know
/** @typedef {{ version: string, files: string[] }} ShellList what belongs to the shell: addresses */

const PREFIX = 'shell-'; // of a cache's name; behind it comes the shell's version
const LIST = '/web/shell.json'; // a ShellList; written last, so a cache that has it is complete
const VERSIONED = /-\d+\.\d+\.\d+\./; // a file whose name has its version never changes
// Every asset has the same page, and so have every collection, every scene and every wardrobe: who has seen one can open another one's without the server.
const PAGE = /^\/(view|browse|scene|wardrobe)(\/[^/]+)?$/;
const CAPTURE_PAGE = '/';
const ONLINE = /^\/web\/((admin|login|pair|share)\/|vendor\/tus-js-client-)/; // files of pages that need the server in any case
const AT_ONCE = 4; // downloads, beside those of the page that is being shown

/** @type {Set<string>} */
const cachedClients = new Set(); // pages that got something from the cache get all the rest from there: versions do not mix

worker.addEventListener('install', (event) => event.waitUntil(updateShell().then(() => worker.skipWaiting())));
worker.addEventListener('activate', (event) => event.waitUntil(worker.clients.claim()));
// Background Sync, which TypeScript does not know: where this fails, the browser tries again later.
worker.addEventListener('sync', (event) => /** @type {ExtendableEvent} */ (event).waitUntil(sendKept()));
worker.addEventListener('fetch', (event) => {
  if (event.request.method === 'GET' && isShell(new URL(event.request.url))) event.respondWith(answer(event));
});

/**
 * Whether an address belongs to the pages that open without the server.
 * @param {URL} url
 * @returns {boolean}
 */
function isShell({ origin, pathname }) {
  const file = pathname.startsWith('/web/') && !ONLINE.test(pathname);
  return origin === worker.location.origin && (file || pathname === CAPTURE_PAGE || PAGE.test(pathname));
}

/**
 * An address as the shell's cache has it: the same for all assets, for all collections, and for all scenes.
 * @param {string} address
 * @returns {string}
 */
function cacheKey(address) {
  const { pathname } = new URL(address, worker.location.origin);
  const [, page] = PAGE.exec(pathname) || [];
  return page ? `/${page}/` : pathname;
}

/**
 * Answer a request for a page or a module, from the network or from the cache.
 * @param {FetchEvent} event
 * @returns {Promise<Response>}
 */
async function answer(event) {
  const { request, clientId } = event;
  const key = cacheKey(request.url);
  if (cachedClients.has(clientId) || VERSIONED.test(key)) {
    const copy = await readShell(key);
    if (copy) return copy;
  }
  try {
    const response = await fetchWhole(request, CACHED_COPY_MS);
    if (request.mode === 'navigate' && response.ok) event.waitUntil(updateShell().catch(() => {}));
    return response.status < 500 ? response : ((await fallBack(event, key)) ?? response);
  } catch {
    return (await fallBack(event, key)) ?? fetchWhole(request, NETWORK_SILENCE_MS).catch(() => Response.error());
  }
}

/**
 * The cached copy for a page that the server does not serve; the rest of that page comes from the cache too.
 * @param {FetchEvent} event
 * @param {string} key
 * @returns {Promise<Response | null>}
 */
async function fallBack({ clientId, resultingClientId }, key) {
  const copy = await readShell(key);
  if (copy) cachedClients.add(resultingClientId || clientId);
  return copy;
}

/**
 * @param {Request} request
 * @param {number} silenceMs
 * @returns {Promise<Response>} of which all has arrived
 */
async function fetchWhole(request, silenceMs) {
  const { response, bytes } = await fetchBytes(request, { silenceMs });
  if (!response.ok && response.status < 400) return response; // a redirection, which the browser follows by itself
  return new Response(bytes, { status: response.status, statusText: response.statusText, headers: response.headers });
}

// ---- the cache ----------------------------------------------------------------------------------------------------------

/**
 * The newest cache that is complete; null where there is none.
 * @returns {Promise<Cache | null>}
 */
async function openShell() {
  for (const name of (await cacheNames()).filter((each) => each.startsWith(PREFIX)).reverse()) {
    const cache = await openCache(name);
    if (await hasEntry(cache, LIST)) return cache;
  }
  return null;
}

/**
 * @param {string} key
 * @returns {Promise<Response | null>}
 */
async function readShell(key) {
  const cache = await openShell();
  const known = await hasEntry(cache, key);
  const copy = await readEntry(cache, key);
  if (known && !copy) await deleteEntry(cache, LIST); // damaged: the next visit with the server fills the cache anew
  return copy && new Response(copy.bytes, { headers: copy.headers });
}

/**
 * Cache the shell as the server has it now, unless this very version is cached, and delete the older ones.
 * @throws {Error} where a file did not come, or the device is full: then the older version stays
 */
async function updateShell() {
  const list = await fetchShell(LIST);
  const { version, files } = decodeList(list.bytes);
  const cache = await openCache(PREFIX + version);
  if (!(await hasEntry(cache, LIST))) {
    const missing = [...files];
    await Promise.all(Array.from({ length: AT_ONCE }, () => downloadAll(cache, missing)));
    const { bytes } = await fetchShell(LIST); // the server may have got new files meanwhile
    if (decodeList(bytes).version !== version) throw new Error('The pages changed while they were being cached.');
    await storeShell(cache, LIST, list);
  }
  const old = (await cacheNames()).filter((name) => name.startsWith(PREFIX) && name !== PREFIX + version);
  await Promise.all(old.map(deleteCache));
}

/**
 * @param {ArrayBuffer} bytes
 * @returns {ShellList}
 */
const decodeList = (bytes) => JSON.parse(new TextDecoder().decode(bytes));

/**
 * @param {Cache | null} cache
 * @param {string[]} missing addresses; each is taken out before it is downloaded
 */
async function downloadAll(cache, missing) {
  for (let address = missing.shift(); address; address = missing.shift()) {
    await storeShell(cache, cacheKey(address), await fetchShell(address));
  }
}

/**
 * @param {string} address
 * @returns {Promise<{response: Response, bytes: ArrayBuffer}>}
 */
async function fetchShell(address) {
  const { response, bytes } = await fetchBytes(address);
  if (!response.ok) throw new Error(`${address}: the server answered ${response.status}.`);
  return { response, bytes };
}

/**
 * @param {Cache | null} cache
 * @param {string} key
 * @param {{response: Response, bytes: ArrayBuffer}} content
 */
async function storeShell(cache, key, { response, bytes }) {
  if (!(await writeEntry(cache, key, bytes, response.headers))) {
    throw new Error('The device has no room for the pages.');
  }
}
