// Files of assets, cached on the device under their hash: a file that was loaded once needs no network again, and one that has rotted or was
// tampered with is never shown.
import { checksum, deleteCache, openCache, readEntry, writeEntry } from '../shared/cache-storage.js';
import { fetchBytes } from '../shared/network.js';
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { ownName } from '../shared/whose.js';

const NAME = 'assets-1';

/** @import { AssetFile } from '../shared/types.d.ts' */
/** @typedef {Pick<AssetFile, 'url' | 'sha256' | 'file'> & { bytes?: number }} CatalogueFile a file as a catalogue names it; `file` is its name for people, `bytes` its size where that is known */

/**
 * Load a file of a catalogue, from the device where it has it.
 * @param {CatalogueFile} file
 * @returns {Promise<ArrayBuffer>}
 * @throws {Problem} ASSET_TAMPERED, ASSET_ABSENT, OFFLINE, NO_ANSWER
 */
export async function loadFile(file) {
  const cache = await openCache(ownName(NAME));
  const key = `/vault/${file.sha256}`;
  const copy = await readEntry(cache, key, file.sha256);
  if (copy) return copy.bytes;
  const bytes = await fetchFile(file);
  await storeFile(cache, key, bytes);
  return bytes;
}

/**
 * @param {CatalogueFile} file
 * @returns {Promise<ArrayBuffer>}
 */
async function fetchFile(file) {
  // The browser's own cache may have rotted too: a wrong file is asked for once more, from the server.
  for (const cache of /** @type {const} */ (['default', 'reload'])) {
    const { response, bytes } = await fetchBytes(file.url, { cache, mostBytes: file.bytes });
    if (isDamaged(response.status, bytes)) throw tampered(file);
    if (!response.ok) {
      const hints = [t('Try again later.')];
      throw new Problem({
        code: 'ASSET_ABSENT',
        status: response.status,
        detail: t('{file} is not where the catalogue says.', { file: file.file }),
        hints,
      });
    }
    if (bytes.byteLength <= (file.bytes ?? Infinity) && (await hasHash(bytes, file.sha256))) return bytes;
  }
  throw tampered(file);
}

/**
 * Whether the server answered that its file is no longer the one that was published.
 * @param {number} status
 * @param {ArrayBuffer} body
 * @returns {boolean}
 */
function isDamaged(status, body) {
  if (status !== 503) return false;
  try {
    return JSON.parse(new TextDecoder().decode(body)).code === 'FILE_DAMAGED';
  } catch {
    return false; // a proxy's page
  }
}

/**
 * @param {CatalogueFile} file
 * @returns {Problem}
 */
function tampered(file) {
  const hints = [t('It was changed on its way or at its place. Tell whoever runs this server.')];
  return new Problem({
    code: 'ASSET_TAMPERED',
    detail: t('{file} is not what the catalogue promises, so it is not shown.', { file: file.file }),
    hints,
  });
}

/**
 * Whether bytes have the hash. Only where the browser lets pages compute one: over https, or on this machine.
 * @param {ArrayBuffer} bytes
 * @param {string} sha256
 * @returns {Promise<boolean>}
 */
async function hasHash(bytes, sha256) {
  return [sha256, ''].includes(await checksum(bytes));
}

/**
 * Cache a file for the next visit; where the device is full, all other files are deleted once.
 * @param {Cache | null} cache
 * @param {string} key
 * @param {ArrayBuffer} bytes
 */
async function storeFile(cache, key, bytes) {
  if (!cache || (await writeEntry(cache, key, bytes, { 'Content-Type': 'application/octet-stream' }))) return;
  await deleteCache(ownName(NAME));
  await writeEntry(await openCache(ownName(NAME)), key, bytes); // without success the next visit fetches it again
}
