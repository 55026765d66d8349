// The browser's Cache Storage with a time limit on every operation, and with a checksum in every entry: a cache that hangs is done without,
// and an entry that was cut or has rotted is not used.
import { CACHE_STORAGE_MS, withTimeLimit } from './time-limits.js';

const CHECKSUM = 'X-Content-SHA-256';
// Headers of the transfer, which do not belong to a body that has arrived and was unpacked.
const TRANSFER_HEADERS = ['Content-Encoding', 'Content-Length', 'Transfer-Encoding', 'Vary', 'Connection'];

let hangs = false; // one operation that hung is enough: each further one would cost the person the same time again

/**
 * Open a cache by its name; null where there is none: over plain http, in some private windows, or when it hangs.
 * @param {string} name
 * @returns {Promise<Cache | null>}
 */
export async function openCache(name) {
  return typeof caches === 'undefined' ? null : attempt(() => caches.open(name), null);
}

/**
 * The names of all caches.
 * @returns {Promise<string[]>}
 */
export const cacheNames = () => attempt(() => caches.keys(), []);

/**
 * Delete a whole cache.
 * @param {string} name
 * @returns {Promise<boolean>}
 */
export const deleteCache = (name) => attempt(() => caches.delete(name), false);

/**
 * Whether a cache has an entry. Its content is not checked.
 * @param {Cache | null} cache
 * @param {string} key
 * @returns {Promise<boolean>}
 */
export const hasEntry = async (cache, key) => Boolean(cache && (await attempt(() => cache.match(key), undefined)));

/**
 * Read an entry and check its content; null where there is none. A damaged entry is deleted.
 * @param {Cache | null} cache
 * @param {string} key
 * @param {string} [sha256] what the content must have; by default the checksum with which it was written
 * @returns {Promise<{bytes: ArrayBuffer, headers: Headers} | null>}
 */
export async function readEntry(cache, key, sha256) {
  if (!cache) return null;
  return attempt(async () => {
    const response = await cache.match(key);
    if (!response) return null;
    const bytes = await response.arrayBuffer().catch(() => new ArrayBuffer(0));
    if ((await checksum(bytes)) === (sha256 ?? response.headers.get(CHECKSUM))) {
      return { bytes, headers: response.headers };
    }
    await cache.delete(key);
    return null;
  }, null);
}

/**
 * Write an entry. Returns whether it is there: a full device, or a cache that hangs, is no reason to fail.
 * @param {Cache | null} cache
 * @param {string} key
 * @param {ArrayBuffer} bytes
 * @param {HeadersInit} [headers] of the answer from which the bytes come
 * @returns {Promise<boolean>}
 */
export async function writeEntry(cache, key, bytes, headers = {}) {
  if (!cache) return false;
  return attempt(async () => {
    const stored = new Headers(headers);
    for (const name of TRANSFER_HEADERS) stored.delete(name);
    stored.set(CHECKSUM, await checksum(bytes));
    await cache.put(key, new Response(bytes.slice(0), { headers: stored }));
    return true;
  }, false);
}

/**
 * Delete an entry.
 * @param {Cache | null} cache
 * @param {string} key
 * @returns {Promise<boolean>}
 */
export const deleteEntry = async (cache, key) => (cache ? attempt(() => cache.delete(key), false) : false);

/**
 * SHA-256 as hexadecimal digits; '' where the browser lets pages compute none: anywhere but over https and on this machine.
 * @param {ArrayBuffer} bytes
 * @returns {Promise<string>}
 */
export async function checksum(bytes) {
  if (!crypto.subtle) return '';
  const digest = new Uint8Array(await crypto.subtle.digest('SHA-256', bytes));
  return Array.from(digest, (value) => value.toString(16).padStart(2, '0')).join('');
}

/**
 * @template T
 * @param {() => Promise<T>} operation
 * @param {T} otherwise the result where the operation fails or hangs
 * @returns {Promise<T>}
 */
async function attempt(operation, otherwise) {
  if (hangs) return otherwise;
  try {
    return await withTimeLimit(operation(), CACHE_STORAGE_MS);
  } catch (error) {
    hangs ||= error instanceof DOMException && error.name === 'TimeoutError';
    return otherwise;
  }
}
