// Search in a collection: the assets whose name, key or labels contain all words, a page at a time.
import { loadRows } from '../shared/signed-catalogue.js';

/** @import { Collection, CollectionRow, Shard } from '../shared/types.d.ts' */

/**
 * A page of the assets that match. `count`: how many match in all; where not `exact`, at least so many.
 * @typedef {object} SearchResult
 * @property {CollectionRow[]} rows
 * @property {number} count
 * @property {boolean} exact
 * @property {Collection} collection
 */

export const PER_PAGE = 48; // divides into rows of 2, 3, 4 and 6

/** @type {Map<string, CollectionRow[]>} */
const rowCache = new Map(); // by the sha256 of a shard: typing a word searches all of them with every letter

/**
 * Finds a page of the assets that match. Reads only as many shards as it needs.
 * @param {Collection} collection
 * @param {string} query
 * @param {number} pageNumber from 1
 * @returns {Promise<SearchResult>}
 */
export async function search(collection, query, pageNumber) {
  const end = pageNumber * PER_PAGE;
  const matches = matcherFor(query);
  /** @type {CollectionRow[]} */
  const rows = [];
  let count = 0;
  let exact = true;
  for (const shard of collection.shards) {
    if (count > end) {
      exact = false; // enough for this page, and to know that another one follows
      break;
    }
    for (const row of (await rowsOf(collection, shard)).filter((each) => each.state !== 'removed' && matches(each))) {
      count += 1;
      if (count > end - PER_PAGE && count <= end) rows.push(row);
    }
  }
  return { rows, count, exact, collection };
}

/**
 * Loads the rows of a shard, or takes them from memory. Forgets those of shards that the collection no longer has.
 * @param {Collection} collection
 * @param {Shard} shard
 */
async function rowsOf(collection, shard) {
  const rows = rowCache.get(shard.sha256) ?? (await loadRows(collection, shard));
  rowCache.set(shard.sha256, rows);
  for (const sha256 of rowCache.keys()) if (!collection.shards.some((each) => each.sha256 === sha256)) rowCache.delete(sha256);
  return rows;
}

/**
 * Returns a function that says whether an asset matches: every word is part of its name, key or labels. Case and accents do
 * not count.
 * @param {string} query
 * @returns {(row: CollectionRow) => boolean}
 */
function matcherFor(query) {
  const words = simplify(query).split(/\s+/).filter(Boolean);
  return ({ key, label, labels }) => {
    const text = simplify([label, key, ...labels].join('\n'));
    return words.every((word) => text.includes(word));
  };
}

/**
 * Removes accents and capital letters.
 * @param {string} text
 */
const simplify = (text) => text.normalize('NFKD').replace(/\p{M}/gu, '').toLowerCase();
