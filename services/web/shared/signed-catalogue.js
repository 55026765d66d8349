// What a server says of its assets, checked against the signed collection: docs/catalogues.md has the chain from one
// signature down to the last file. Where a server signs nothing, it is believed as it is.
import { getCachedJson, Problem } from './api.js';
import { loadFile } from './verified-cache.js';

const KEYS = 'capture2vr:keys';
const SEEN = 'capture2vr:seen:';
const TRIES = 3; // a shard goes once 32 newer ones have come; the index of that moment knows another
const NAME = /^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$/; // of assets and collections; anything else becomes no part of an address
const HASH = /^[A-Za-z0-9_-]{43}$/; // a sha256 as rows have it: base64url without padding

/**
 * The entry itself, with the hashes of its files as they were signed, and no file that was not.
 * Throws Problem CATALOGUE_FORGED, CATALOGUE_OLDER, CATALOGUE_BEHIND, and what loading throws.
 */
export async function checked(entry) {
  if (!(await keysOf()).length || !crypto.subtle) return entry;
  const [name] = entry.collections || ['default'];
  const { collection, row } = await newest(name, async (index) => ({ collection: index, row: await rowOf(index, entry.key) }));
  if (!row || row.state === 'removed' || hex(row.manifest) !== entry.manifest.sha256) {
    // A new version is in its entry a moment before it is in the collection.
    throw new Problem({ code: 'CATALOGUE_BEHIND', detail: 'This version is not in the signed catalogue yet.', hints: ['Wait a moment.'] });
  }
  const manifest = await manifestOf(collection, row);
  const signed = new Map(manifest.files.map((file) => [file.name, file.sha256]));
  const files = (entry.files || []).filter(({ name: file }) => signed.has(file));
  return { ...entry, files, lods: entry.lods.map((lod) => ({ ...lod, sha256: signed.get(lod.name) })) };
}

/**
 * A collection's index: {name, version, shards: [{name, sha256, count, first, last}], base}.
 * Throws Problem CATALOGUE_FORGED, CATALOGUE_OLDER, and what loading throws.
 */
export async function collectionNamed(name) {
  const keys = await keysOf();
  const envelope = await getCachedJson(`/v1/collections/${encodeURIComponent(name)}`);
  const index = keys.length && crypto.subtle ? await indexOf(envelope, name, keys) : JSON.parse(envelope.signed);
  return { name, version: index.version, shards: index.shards, base: envelope.base };
}

/** What `work` makes of a collection; it begins again with a newer index where a shard has gone meanwhile. */
export async function newest(name, work) {
  for (let left = TRIES; ; left--) {
    try {
      return await work(await collectionNamed(name));
    } catch (problem) {
      if (problem.code !== 'ASSET_ABSENT' || left === 1) throw problem;
    }
  }
}

/** The rows of a shard, those that make sense: [{key, label, labels, version, state, updated, manifest}]. */
export async function rowsOf(collection, shard) {
  const file = { url: new URL(shard.name, collection.base).href, sha256: shard.sha256, file: 'the catalogue' };
  const { columns, words, rows } = parsed(await loadFile(file));
  return rows.map((cells) => rowFrom(columns, words, cells)).filter(({ key, manifest }) => NAME.test(key) && HASH.test(manifest));
}

function rowFrom(columns, words, cells) {
  const row = Object.fromEntries(columns.map((column, place) => [column, cells[place]]));
  const labels = row.labels.map((place) => String(words[place]));
  return { ...row, label: String(row.label || row.key), labels, state: words[row.state] };
}

/** Everything about a row's asset, each of its `files` with its address. */
export async function manifestOf({ base }, { key, manifest: hash }) {
  const sha256 = hex(hash);
  const url = new URL(`assets/${key}/manifest.${sha256}.json`, base).href;
  const manifest = parsed(await loadFile({ url, sha256, file: 'manifest.json' }));
  return { ...manifest, files: manifest.files.map((file) => ({ ...file, url: new URL(file.name, base).href })) };
}

/** The server's keys, kept from the first visit on: who takes the server over later has others. */
async function keysOf() {
  const known = readItem(KEYS);
  if (Array.isArray(known)) return known;
  const { keys } = await getCachedJson('/v1/keys');
  if (keys.length) writeItem(KEYS, keys);
  return keys;
}

async function indexOf(envelope, name, keys) {
  if (!(await someoneSigned(envelope, keys))) {
    throw forged('The catalogue of this server is not signed by whom it was before, so nothing of it is shown.');
  }
  const index = JSON.parse(envelope.signed);
  if (index.collection !== name) throw forged('The server answered with the catalogue of something else.');
  const seen = Number(readItem(SEEN + name)) || 0;
  if (index.version < seen) {
    const hints = ['Somebody may want to show you what was taken back. Tell whoever runs this server.'];
    throw new Problem({ code: 'CATALOGUE_OLDER', detail: 'The server shows an older catalogue than this device has seen.', hints });
  }
  writeItem(SEEN + name, index.version);
  return index;
}

function forged(detail) {
  return new Problem({ code: 'CATALOGUE_FORGED', detail, hints: ['Tell whoever runs this server.'] });
}

async function someoneSigned({ signed, signatures }, keys) {
  const text = new TextEncoder().encode(signed);
  for (const { key, ed25519 } of signatures) {
    const known = keys.find((each) => each.key === key);
    if (known && (await isBy(known.ed25519, ed25519, text))) return true;
  }
  return false;
}

async function isBy(key, signature, text) {
  const by = await crypto.subtle.importKey('raw', unpacked(key), { name: 'Ed25519' }, false, ['verify']);
  return crypto.subtle.verify({ name: 'Ed25519' }, by, unpacked(signature), text);
}

async function rowOf(collection, key) {
  const shard = collection.shards.findLast((each) => each.first <= key) || collection.shards[0];
  return shard ? (await rowsOf(collection, shard)).find((row) => row.key === key) : null;
}

/**
 * Read a value from the local storage; null where there is none, it is damaged, or the browser forbids the storage.
 * @param {string} key
 * @returns {any}
 */
function readItem(key) {
  try {
    return JSON.parse(localStorage.getItem(key));
  } catch {
    return null;
  }
}

/**
 * @param {string} key
 * @param {unknown} value
 */
function writeItem(key, value) {
  try {
    localStorage.setItem(key, JSON.stringify(value));
  } catch {
    // A full or forbidden storage: the next visit meets this server as if for the first time.
  }
}

const parsed = (bytes) => JSON.parse(new TextDecoder().decode(bytes));
const unpacked = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const hex = (short) => Array.from(unpacked(short.replaceAll('-', '+').replaceAll('_', '/')), (value) => value.toString(16).padStart(2, '0')).join('');
