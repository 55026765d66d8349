// Search in a collection: the assets of a state, date and size whose name, key or labels contain all words, in an order, a page at a time.
import { MOST_ROWS, loadFirstRows, loadRows, walkRows } from '../catalogue/collection-rows.js';
import { simplify } from '../shared/search-words.js';

/** @import { CataloguePart, Collection, CollectionRow } from '../shared/types.d.ts' */

/**
 * A page of the assets that match. `count`: how many match in all; where not `exact`, at least so many. `isCut`: of a large collection
 * only the first assets were looked through, and `count` of those match.
 * @typedef {object} SearchResult
 * @property {CollectionRow[]} rows
 * @property {number} count
 * @property {boolean} exact
 * @property {boolean} isCut
 * @property {Collection} collection
 */

/**
 * What is searched for.
 * @typedef {object} Query
 * @property {string} words
 * @property {string} order "" (by key), "name", "newest", "oldest", "largest" or "smallest"
 * @property {string} state "" (all but removed ones) or the one state
 * @property {string} since first day of the last change, as 2026-01-31, or ""
 * @property {string} until last day of it, or ""
 * @property {string} least megabytes of all files, or ""
 * @property {string} most
 */

export const PER_PAGE = 48; // divides into rows of 2, 3, 4 and 6

/** @type {Map<string, CollectionRow[]>} */
const rowCache = new Map(); // by the sha256 of a shard: typing a word searches all of them with every letter

/** @type {Record<string, (one: CollectionRow, other: CollectionRow) => number>} */
const ORDERS = {
  name: (one, other) => one.label.localeCompare(other.label, undefined, { numeric: true, sensitivity: 'base' }),
  newest: (one, other) => other.updated - one.updated,
  oldest: (one, other) => one.updated - other.updated,
  largest: (one, other) => other.bytes - one.bytes,
  smallest: (one, other) => one.bytes - other.bytes,
};
const MB = 1e6;

/**
 * Finds a page of the assets that match. By key it reads only as many shards as it needs.
 * @param {Collection} collection
 * @param {Query} query
 * @param {number} pageNumber from 1
 * @returns {Promise<SearchResult>}
 */
export async function search(collection, query, pageNumber) {
  return ORDERS[query.order] ? searchAll(collection, query, pageNumber) : searchByKey(collection, query, pageNumber);
}

/**
 * @param {Collection} collection
 * @param {Query} query
 * @param {number} pageNumber
 * @returns {Promise<SearchResult>}
 */
async function searchAll(collection, query, pageNumber) {
  const matches = matcherFor(query);
  const { rows, isCut } = await loadFirstRows(collection, rowsOf);
  const found = rows.filter(matches).sort(ORDERS[query.order]);
  const end = pageNumber * PER_PAGE;
  return { rows: found.slice(end - PER_PAGE, end), count: found.length, exact: !isCut, isCut, collection };
}

/**
 * @param {Collection} collection
 * @param {Query} query
 * @param {number} pageNumber
 * @returns {Promise<SearchResult>}
 */
async function searchByKey(collection, query, pageNumber) {
  const end = pageNumber * PER_PAGE;
  const matches = matcherFor(query);
  /** @type {CollectionRow[]} */
  const rows = [];
  let count = 0;
  let seen = 0;
  for await (const some of walkRows(collection, rowsOf)) {
    seen += some.length;
    for (const row of some.filter(matches)) {
      count += 1;
      if (count > end - PER_PAGE && count <= end) rows.push(row);
    }
    const isFull = count > end; // enough for this page, and to know that another one follows
    if (!isFull && seen < MOST_ROWS) continue;
    const exact = seen >= collection.count;
    return { rows, count, exact, isCut: !exact && !isFull, collection };
  }
  return { rows, count, exact: true, isCut: false, collection };
}

/**
 * Loads the rows of a shard, or takes them from memory, where those of one large search and of another one stay.
 * @param {Collection} collection
 * @param {CataloguePart} shard
 */
async function rowsOf(collection, shard) {
  const rows = rowCache.get(shard.sha256) ?? (await loadRows(collection, shard));
  rowCache.set(shard.sha256, rows);
  let held = [...rowCache.values()].reduce((sum, each) => sum + each.length, 0);
  for (const [oldest, { length }] of rowCache) {
    if (held <= 2 * MOST_ROWS) break;
    rowCache.delete(oldest);
    held -= length;
  }
  return rows;
}

/**
 * Returns a function that says whether an asset matches: its state, date and size, and every word is part of its name, key or
 * labels. Case and accents do not count.
 * @param {Query} query
 * @returns {(row: CollectionRow) => boolean}
 */
function matcherFor({ words: text, state: wanted, ...limits }) {
  const words = simplify(text).split(/\s+/).filter(Boolean);
  const isWithin = limitsFor(limits);
  return (row) => {
    const { key, label, labels, state } = row;
    if (wanted ? state !== wanted : state === 'removed') return false;
    if (!isWithin(row)) return false;
    const named = simplify([label, key, ...labels].join('\n'));
    return words.every((word) => named.includes(word));
  };
}

/**
 * Returns a function that says whether an asset's date and size are within the limits. One of unknown size is within no limits of size.
 * @param {Pick<Query, 'since' | 'until' | 'least' | 'most'>} limits
 * @returns {(row: CollectionRow) => boolean}
 */
function limitsFor({ since, until, least, most }) {
  const first = since ? new Date(`${since}T00:00`).getTime() / 1000 : -Infinity; // the day here, not in Greenwich
  const last = until ? new Date(`${until}T23:59:59.999`).getTime() / 1000 : Infinity;
  const [low, high] = [least ? Number(least) * MB : 0, most ? Number(most) * MB : Infinity];
  const sized = least || most;
  return ({ updated, bytes }) =>
    updated >= first && updated <= last && (!sized || (bytes > 0 && bytes >= low && bytes <= high));
}
