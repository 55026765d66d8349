// What a server says of an asset, checked against its signed collection: docs/catalogues.md has the chain from one
// signature down to the last file. Where a server signs nothing, it is believed as it is.
import { getJson, Problem } from './api.js';
import { bytesOf } from './vault.js';

const KEYS = 'capture2vr:keys';
const SEEN = 'capture2vr:seen:';

/**
 * The entry itself, with the hashes of its files as they were signed.
 * Throws Problem CATALOGUE_FORGED, CATALOGUE_OLDER, CATALOGUE_BEHIND, and what loading throws.
 */
export async function checked(entry) {
  const keys = await keysOf();
  if (!keys.length || !crypto.subtle) return entry;
  const [name] = entry.collections || ['default'];
  const envelope = await getJson(`/v1/collections/${encodeURIComponent(name)}`);
  const index = await indexOf(envelope, name, keys);
  const row = await rowOf(index, envelope.base, entry.key);
  if (!row || row.state === 'removed' || row.manifest !== entry.manifest.sha256) {
    // A new version is in its entry a moment before it is in the collection.
    throw new Problem({ code: 'CATALOGUE_BEHIND', detail: 'This version is not in the signed catalogue yet.', hints: ['Wait a moment.'] });
  }
  const manifest = parsed(await bytesOf({ ...entry.manifest, sha256: row.manifest, file: 'manifest.json' }));
  const signed = new Map(manifest.lods.map((lod) => [lod.name, lod.sha256]));
  return { ...entry, lods: entry.lods.map((lod) => ({ ...lod, sha256: signed.get(lod.name) })) };
}

/** The server's keys, kept from the first visit on: who takes the server over later has others. */
async function keysOf() {
  const kept = localStorage.getItem(KEYS);
  if (kept) return JSON.parse(kept);
  const { keys } = await getJson('/v1/keys');
  if (keys.length) localStorage.setItem(KEYS, JSON.stringify(keys));
  return keys;
}

async function indexOf(envelope, name, keys) {
  if (!(await someoneSigned(envelope, keys))) {
    throw forged('The catalogue of this server is not signed by whom it was before, so nothing of it is shown.');
  }
  const index = JSON.parse(envelope.signed);
  if (index.collection !== name) throw forged('The server answered with the catalogue of something else.');
  const seen = Number(localStorage.getItem(SEEN + name)) || 0;
  if (index.version < seen) {
    const hints = ['Somebody may want to show you what was taken back. Tell whoever runs this server.'];
    throw new Problem({ code: 'CATALOGUE_OLDER', detail: 'The server shows an older catalogue than this device has seen.', hints });
  }
  localStorage.setItem(SEEN + name, index.version);
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

async function rowOf(index, base, key) {
  const shard = index.shards.findLast((each) => each.first <= key) || index.shards[0];
  if (!shard) return null;
  const { columns, words, rows } = parsed(await bytesOf({ url: new URL(shard.name, base).href, sha256: shard.sha256, file: 'the catalogue' }));
  const cells = rows.find((each) => each[columns.indexOf('key')] === key);
  if (!cells) return null;
  const row = Object.fromEntries(columns.map((column, place) => [column, cells[place]]));
  return { state: words[row.state], manifest: hex(row.manifest) };
}

const parsed = (bytes) => JSON.parse(new TextDecoder().decode(bytes));
const unpacked = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const hex = (short) => Array.from(unpacked(short.replaceAll('-', '+').replaceAll('_', '/')), (value) => value.toString(16).padStart(2, '0')).join('');
