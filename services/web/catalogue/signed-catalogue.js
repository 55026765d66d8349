// The catalogue of the assets, checked against the signed collection: docs/catalogues.md has the chain from one signature down to the
// last file. A server that signs nothing is believed.
import { findRow, partsOf, toHex } from './collection-rows.js';
import { loadFile } from './verified-cache.js';
import { getCachedJson } from '../shared/api.js';
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { ofShownTenant, ownNameOfShown } from '../shared/whose.js';

/** @import { AssetEntry, AssetProof, Collection, CollectionIndex, CollectionRow, Manifest, PublicKey, SignedEnvelope } from '../shared/types.d.ts' */

const KEYS = 'capture2vr:keys';
const SEEN = 'capture2vr:seen:';
const TRIES = 3; // shards and nodes are deleted a while after newer ones have come; the newest root names others

/**
 * Check an entry: it is returned with the hashes of its files as they were signed, and without files that were not.
 * @param {AssetEntry} entry
 * @returns {Promise<AssetEntry>}
 * @throws {Problem} CATALOGUE_FORGED, CATALOGUE_OLDER, CATALOGUE_BEHIND, and what loading throws
 */
export async function checkEntry(entry) {
  const keys = await loadKeys();
  if (!keys.length || !crypto.subtle) return entry;
  const [name] = entry.collections ?? ['default']; // none: the person may read none that lists it
  const { collection, row } = name
    ? await withNewest(name, async (index) => ({ collection: index, row: await findRow(index, entry.key) }))
    : {};
  if (!row && entry.proof) return checkProof(entry, entry.proof, keys);
  if (!collection || !row || row.state === 'removed' || toHex(row.manifest) !== entry.manifest.sha256) {
    // A new version is in its entry a moment before it is in the collection.
    throw new Problem({
      code: 'CATALOGUE_BEHIND',
      detail: t('This version is not in the signed catalogue yet.'),
      hints: [t('Wait a moment.')],
    });
  }
  return withSignedHashes(entry, await loadManifest(collection, row));
}

/**
 * Check an entry by the signature of its version alone: no collection that the person may read lists it.
 * @param {AssetEntry} entry
 * @param {SignedEnvelope} proof
 * @param {PublicKey[]} keys
 * @returns {Promise<AssetEntry>}
 */
async function checkProof(entry, proof, keys) {
  if (!(await hasGoodSignature(proof, keys))) {
    throw forged(t('This object is not signed by whom it should be, so it is not shown.'));
  }
  /** @type {AssetProof} */
  const { asset, version, manifest } = JSON.parse(proof.signed);
  if (asset !== entry.key || manifest !== entry.manifest.sha256) {
    throw forged(t('The server answered with the signature of something else.'));
  }
  rememberVersion(`${SEEN}asset:${asset}`, version);
  return withSignedHashes(
    entry,
    decodeJson(await loadFile({ url: entry.manifest.url, sha256: manifest, file: 'manifest.json' })),
  );
}

/**
 * @param {AssetEntry} entry
 * @param {Manifest} manifest
 * @returns {AssetEntry} with the hashes of the manifest
 */
function withSignedHashes(entry, manifest) {
  const signed = new Map(manifest.files.map((file) => [file.name, file.sha256]));
  const files = (entry.files ?? []).filter(({ name: file }) => signed.has(file));
  const lods = entry.lods.map((lod) => ({ ...lod, sha256: signed.get(lod.name) ?? '' })); // a file without a hash is refused
  return { ...entry, files, lods };
}

/**
 * Load a collection and check its signature.
 * @param {string} name
 * @returns {Promise<Collection>}
 * @throws {Problem} CATALOGUE_FORGED, CATALOGUE_OLDER, CATALOGUE_TRUNCATED, and what loading throws
 */
export async function loadCollection(name) {
  const keys = await loadKeys();
  /** @type {SignedEnvelope} */
  const envelope = await getCachedJson(ofShownTenant(`/v1/collections/${encodeURIComponent(name)}?form=tree`));
  /** @type {CollectionIndex} */
  const index = keys.length && crypto.subtle ? await checkIndex(envelope, name, keys) : JSON.parse(envelope.signed);
  return { name, version: index.version, base: envelope.base, ...partsOf(name, index) };
}

/**
 * Call a function with the newest version of a collection, and again with a newer one where a shard or a node was deleted meanwhile.
 * @template T
 * @param {string} name
 * @param {(collection: Collection) => Promise<T>} work
 * @returns {Promise<T>}
 */
export async function withNewest(name, work) {
  for (let left = TRIES; ; left--) {
    try {
      return await work(await loadCollection(name));
    } catch (error) {
      if (!(error instanceof Problem) || error.code !== 'ASSET_ABSENT' || left === 1) throw error;
    }
  }
}

/**
 * Load the manifest of a row's asset. Each of its `files` gets its address.
 * @param {Collection} collection
 * @param {CollectionRow} row
 * @returns {Promise<Manifest>}
 */
export async function loadManifest({ base }, { key, manifest: hash }) {
  const sha256 = toHex(hash);
  const url = new URL(`assets/${key}/manifest.${sha256}.json`, base).href;
  /** @type {Manifest} */
  const manifest = decodeJson(await loadFile({ url, sha256, file: 'manifest.json' }));
  return { ...manifest, files: manifest.files.map((file) => ({ ...file, url: new URL(file.name, base).href })) };
}

/**
 * The server's public keys, stored at the first visit: whoever takes the server over later has other ones.
 * @returns {Promise<PublicKey[]>}
 */
async function loadKeys() {
  const stored = readItem(KEYS);
  if (Array.isArray(stored)) return stored;
  /** @type {{ keys: PublicKey[] }} */
  const { keys } = await getCachedJson('/v1/keys');
  if (keys.length) writeItem(KEYS, keys);
  return keys;
}

/**
 * @param {SignedEnvelope} envelope
 * @param {string} name of the collection that was asked for
 * @param {PublicKey[]} keys
 * @returns {Promise<CollectionIndex>}
 */
async function checkIndex(envelope, name, keys) {
  if (!(await hasGoodSignature(envelope, keys))) {
    throw forged(t('The catalogue of this server is not signed by whom it was before, so nothing of it is shown.'));
  }
  /** @type {CollectionIndex} */
  const index = JSON.parse(envelope.signed);
  if (index.collection !== name) throw forged(t('The server answered with the catalogue of something else.'));
  rememberVersion(SEEN + name, index.version);
  return index;
}

/**
 * Remember a version that was signed, for each tenant by itself.
 * @param {string} item of the local storage
 * @param {number} version
 * @throws {Problem} CATALOGUE_OLDER where a newer one was seen
 */
function rememberVersion(item, version) {
  const key = ownNameOfShown(item);
  if (version < (Number(readItem(key)) || 0)) {
    const hints = [t('Somebody may want to show you what was taken back. Tell whoever runs this server.')];
    throw new Problem({
      code: 'CATALOGUE_OLDER',
      detail: t('The server shows an older catalogue than this device has seen.'),
      hints,
    });
  }
  writeItem(key, version);
}

/** @param {string} detail */
function forged(detail) {
  return new Problem({ code: 'CATALOGUE_FORGED', detail, hints: [t('Tell whoever runs this server.')] });
}

/**
 * Whether one of the keys has signed it.
 * @param {SignedEnvelope} envelope
 * @param {PublicKey[]} keys
 */
async function hasGoodSignature({ signed, signatures }, keys) {
  const text = new TextEncoder().encode(signed);
  for (const { key: id, ed25519: signature } of signatures) {
    const key = keys.find((each) => each.key === id);
    if (key && (await verify(key.ed25519, signature, text))) return true;
  }
  return false;
}

/**
 * Verify an Ed25519 signature.
 * @param {string} publicKey base64
 * @param {string} signature base64
 * @param {BufferSource} text
 */
async function verify(publicKey, signature, text) {
  const key = await crypto.subtle.importKey('raw', fromBase64(publicKey), { name: 'Ed25519' }, false, ['verify']);
  return crypto.subtle.verify({ name: 'Ed25519' }, key, fromBase64(signature), text);
}

/**
 * Read a value from the local storage; null where there is none, it is damaged, or the browser forbids the storage.
 * @param {string} key
 * @returns {unknown}
 */
function readItem(key) {
  try {
    return JSON.parse(localStorage.getItem(key) ?? 'null');
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

/** @param {ArrayBuffer} bytes */
const decodeJson = (bytes) => JSON.parse(new TextDecoder().decode(bytes));

/** @param {string} base64 */
const fromBase64 = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
