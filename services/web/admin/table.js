// Tables of the operator's page.
import { child, create, element } from '../shared/dom.js';

/** @typedef {string | HTMLElement | { number: string } | { bad: string }} Cell */

/**
 * Fills a table with rows; says so where there are none.
 * @param {string} id
 * @param {Cell[][]} rows
 * @param {string} [none] what stands there without rows
 */
export function fillTable(id, rows, none = 'none') {
  const table = element(id, HTMLTableElement);
  const columns = child(table, 'thead tr', HTMLTableRowElement).cells.length;
  const empty = create('tr');
  empty.append(create('td', { colSpan: columns, className: 'quiet', textContent: none }));
  child(table, 'tbody', HTMLTableSectionElement).replaceChildren(...(rows.length ? rows.map(createRow) : [empty]));
}

/**
 * Adds rows to those that a table has.
 * @param {string} id
 * @param {Cell[][]} rows
 */
export function addRows(id, rows) {
  child(element(id, HTMLTableElement), 'tbody', HTMLTableSectionElement).append(...rows.map(createRow));
}

/** @param {Cell[]} cells */
function createRow(cells) {
  const row = create('tr');
  row.append(...cells.map(createCell));
  return row;
}

/** @param {Cell} cell */
function createCell(cell) {
  if (typeof cell === 'string') return create('td', { textContent: cell });
  if ('number' in cell) return create('td', { className: 'number', textContent: cell.number });
  if ('bad' in cell) return create('td', { className: 'bad', textContent: cell.bad });
  const made = create('td');
  made.append(cell);
  return made;
}

/**
 * Seconds for people: 45 s, 12 min, 3 h, 2 days.
 * @param {number} seconds
 */
export function formatSeconds(seconds) {
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172_800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86_400)} days`;
}

/**
 * Bytes for people: 512 B, 1.5 GB. Powers of ten, as disks are sold.
 * @param {number} bytes
 */
export function formatBytes(bytes) {
  const units = ['B', 'kB', 'MB', 'GB', 'TB', 'PB'];
  const power = bytes < 1000 ? 0 : Math.min(units.length - 1, Math.floor(Math.log10(bytes) / 3));
  const shown = bytes / 1000 ** power;
  return `${power && shown < 100 ? shown.toFixed(1) : Math.round(shown)} ${units[power]}`;
}

/**
 * A time in the zone of the reader; "never" for none.
 * @param {string | null} iso
 */
export const formatTime = (iso) =>
  iso ? new Date(iso).toLocaleString(undefined, { dateStyle: 'medium', timeStyle: 'short' }) : 'never';
