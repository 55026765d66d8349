// Forgets what this browser keeps of accounts: caches and placements whose names end with a tenant. The versions that were seen stay: they
// guard against older ones.
import { cacheNames, deleteCache } from './cache-storage.js';

const OF_ACCOUNT = /:(?<tenant>[a-z0-9-]+)$/;
const PLACED = /^capture2vr:placed(?:@[a-z0-9-]+)?:(?<tenant>[a-z0-9-]+)$/;

/**
 * Delete what is kept of all accounts but one.
 * @param {string} [kept] the tenant whose caches stay; none by default
 */
export async function forgetAccounts(kept = '') {
  const names = (await cacheNames()).filter((name) => isForgotten(OF_ACCOUNT.exec(name), kept));
  await Promise.all(names.map(deleteCache));
  try {
    for (const key of Object.keys(localStorage)) if (isForgotten(PLACED.exec(key), kept)) localStorage.removeItem(key);
  } catch {
    // The browser forbids the storage, so nothing is in it.
  }
}

/**
 * @param {RegExpExecArray | null} found
 * @param {string} kept
 */
const isForgotten = (found, kept) => Boolean(found) && found?.groups?.tenant !== kept;
