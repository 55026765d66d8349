// The rows of a collection, read from its tree: a root or an index lists parts, which are shards of rows or nodes with further parts.
import { loadFile } from './verified-cache.js';
import { formatCount } from '../shared/format.js';
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { CataloguePart, Collection, CollectionIndex, CollectionRow, NodeDocument, ShardDocument } from '../shared/types.d.ts' */
/** @typedef {(collection: Collection, shard: CataloguePart) => Promise<CollectionRow[]>} LoadRows */

/** Rows that a page reads of one collection, and what else their shards hold: 1.4 MB. */
export const MOST_ROWS = 10_000;

const NAME = /^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$/; // of assets and collections; nothing else gets into an address
const HASH = /^[A-Za-z0-9_-]{43}$/; // a sha256 as rows have it: base64url without padding
const HEX_HASH = /^[0-9a-f]{64}$/;
const MOST_BYTES = 16 * 2 ** 20; // of a node or a shard
const MOST_DEPTH = 8; // 48^8 shards
const TOGETHER = 6; // as many requests as a browser makes to one server over HTTP/1.1

/**
 * The parts that a collection's signed text lists: those of a tree, or the shards of an index that is none.
 * @param {string} collection
 * @param {CollectionIndex} index
 * @returns {Pick<Collection, 'parts' | 'depth' | 'count'>}
 * @throws {Problem} CATALOGUE_TRUNCATED
 */
export function partsOf(collection, index) {
  if (index.children) {
    const depth = checkNumber(index.depth, MOST_DEPTH);
    const parts = treeParts(collection, depth, { columns: index.columns ?? [], children: index.children });
    return { parts, depth, count: checkNumber(index.count, Infinity) };
  }
  if (!index.shards) throw unreadable();
  const parts = index.shards.map((shard) => checkPart(collection, 0, shard));
  return { parts, depth: 0, count: parts.reduce((sum, { count }) => sum + count, 0) };
}

/**
 * Find the row of an asset. Of each level of the tree one part is loaded.
 * @param {Collection} collection
 * @param {string} key of the asset
 * @returns {Promise<CollectionRow | undefined>}
 * @throws {Problem} CATALOGUE_TRUNCATED, and what `loadFile` throws
 */
export async function findRow(collection, key) {
  let { parts } = collection;
  for (let { depth } = collection; ; depth--) {
    const part = parts.findLast(({ first }) => first <= key) ?? parts.at(0);
    if (!part) return undefined;
    if (depth === 0) return (await loadRows(collection, part)).find((row) => row.key === key);
    parts = await loadParts(collection, part, depth - 1);
  }
}

/**
 * Load rows in the order of their keys, a shard's at a time, and only as many shards as are asked for: a few at once, more of them the
 * longer it goes on.
 * @param {Collection} collection
 * @param {LoadRows} [load] of a shard
 * @returns {AsyncGenerator<CollectionRow[], void>}
 * @throws {Problem} as `findRow`
 */
export async function* walkRows(collection, load = loadRows) {
  const shards = shardsOf(collection, collection.parts, collection.depth);
  for (let together = 1; ; together = Math.min(2 * together, TOGETHER)) {
    const batch = [];
    while (batch.length < together) {
      const { value: shard } = await shards.next();
      if (!shard) break;
      batch.push(shard);
    }
    if (batch.length === 0) return;
    yield* await Promise.all(batch.map((shard) => load(collection, shard)));
  }
}

/**
 * Load the first rows of a collection: all of them, unless there are very many.
 * @param {Collection} collection
 * @param {LoadRows} [load] of a shard
 * @returns {Promise<{ rows: CollectionRow[], isCut: boolean }>} isCut: there are more
 * @throws {Problem} as `findRow`
 */
export async function loadFirstRows(collection, load = loadRows) {
  /** @type {CollectionRow[]} */
  const rows = [];
  for await (const some of walkRows(collection, load)) {
    rows.push(...some);
    if (rows.length >= MOST_ROWS) return { rows, isCut: rows.length < collection.count };
  }
  return { rows, isCut: false };
}

/** Says that a collection is too large for a page to look through all of it. */
export const cutText = () =>
  t('The collection is large: only its first {count} objects, by key, were looked through.', {
    count: formatCount(MOST_ROWS),
  });

/**
 * Load the rows of a shard. Rows that make no sense are left out.
 * @param {Collection} collection
 * @param {CataloguePart} shard
 * @returns {Promise<CollectionRow[]>}
 * @throws {Problem} what `loadFile` throws
 */
export async function loadRows(collection, shard) {
  /** @type {ShardDocument} */
  const { columns, words, rows } = await loadPart(collection, shard);
  return rows
    .map((cells) => rowFrom(columns, words, cells))
    .filter(({ key, manifest }) => NAME.test(key) && HASH.test(manifest));
}

/** @param {string} base64url */
export function toHex(base64url) {
  const bytes = Uint8Array.from(atob(base64url.replaceAll('-', '+').replaceAll('_', '/')), (letter) =>
    letter.charCodeAt(0),
  );
  return Array.from(bytes, (value) => value.toString(16).padStart(2, '0')).join('');
}

/**
 * @param {Collection} collection
 * @param {CataloguePart[]} parts
 * @param {number} depth
 * @returns {AsyncGenerator<CataloguePart, void>}
 */
async function* shardsOf(collection, parts, depth) {
  for (const part of parts) {
    if (depth === 0) yield part;
    else yield* shardsOf(collection, await loadParts(collection, part, depth - 1), depth - 1);
  }
}

/**
 * @param {Collection} collection
 * @param {CataloguePart} node
 * @param {number} depth of its children
 * @returns {Promise<CataloguePart[]>}
 */
async function loadParts(collection, node, depth) {
  return treeParts(collection.name, depth, await loadPart(collection, node));
}

/**
 * @template T
 * @param {Collection} collection
 * @param {CataloguePart} part
 * @returns {Promise<T>}
 */
async function loadPart({ base }, { name, sha256, bytes }) {
  const file = { url: new URL(name, base).href, sha256, bytes, file: t('the catalogue') };
  return JSON.parse(new TextDecoder().decode(await loadFile(file)));
}

/**
 * @param {string} collection
 * @param {number} depth
 * @param {NodeDocument} node
 * @returns {CataloguePart[]}
 */
function treeParts(collection, depth, { columns, children }) {
  return children.map((cells) => {
    const part = Object.fromEntries(columns.map((column, place) => [column, cells[place]]));
    if (!HASH.test(String(part.sha256))) throw unreadable();
    return checkPart(collection, depth, { ...part, sha256: toHex(String(part.sha256)) });
  });
}

/**
 * Checks what lists a part. Its name follows from collection and hash, whatever the list may say.
 * @param {string} collection
 * @param {number} depth
 * @param {Record<string, unknown>} record
 * @returns {CataloguePart}
 */
function checkPart(collection, depth, record) {
  const [sha256, first] = [String(record.sha256), String(record.first)];
  if (!HEX_HASH.test(sha256)) throw unreadable();
  const name = `collections/${collection}/${depth === 0 ? 'shard' : 'node'}.${sha256}.json`;
  return {
    name,
    sha256,
    first,
    bytes: checkNumber(record.bytes, MOST_BYTES),
    count: checkNumber(record.count, Infinity),
  };
}

/**
 * @param {unknown} value
 * @param {number} most
 */
function checkNumber(value, most) {
  if (typeof value !== 'number' || !(value >= 0 && value <= most)) throw unreadable();
  return value;
}

function unreadable() {
  const hints = [t('Load this page anew. If that does not help, tell whoever runs this server.')];
  return new Problem({
    code: 'CATALOGUE_TRUNCATED',
    detail: t('This page cannot read the catalogue of this server.'),
    hints,
  });
}

/**
 * @param {string[]} columns
 * @param {string[]} words
 * @param {unknown[]} cells
 * @returns {CollectionRow}
 */
function rowFrom(columns, words, cells) {
  const row = Object.fromEntries(columns.map((column, place) => [column, cells[place]]));
  const labels = /** @type {number[]} */ (row.labels).map((place) => String(words[place]));
  const state = /** @type {CollectionRow['state']} */ (words[Number(row.state)]);
  const [key, manifest] = [String(row.key), String(row.manifest)];
  const grade = String(words[Number(row.grade)] ?? ''); // older shards have no grade, and no size
  const facts = { version: Number(row.version), updated: Number(row.updated), bytes: Number(row.bytes ?? 0), grade };
  return { key, label: String(row.label || key), labels, state, manifest, ...facts };
}
