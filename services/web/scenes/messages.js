// Texts of the viewer's page: what is shown, the list of things, notices, and errors.
import { child, create, element } from '../shared/dom.js';
import { formatCount, formatNumber, stateText } from '../shared/format.js';
import { sentences, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, SizeM } from '../shared/types.d.ts' */
/** @typedef {{ key: string, name: string, entry: AssetEntry | null }} ListedItem a thing in the scene; without an entry it is not loaded */

const TILE = /^tile-.*\.glb$/; // of a large scene, whose levels of the whole only stand for them until they come
const NOTICE_MS = 10_000; // long enough to read; later it may no longer be true

const page = {
  canvas: element('stage', HTMLCanvasElement),
  label: element('label', HTMLElement),
  summary: element('said', HTMLElement),
  description: element('description', HTMLElement),
  notice: element('notice', HTMLElement),
  retry: element('again', HTMLButtonElement),
  list: element('things', HTMLElement),
  quickLook: element('quick-look', HTMLAnchorElement),
};
let noticeTimer = 0;

/**
 * How many things were asked for, and what did not come.
 * @typedef {object} Wanted
 * @property {string} title of the scene; '' for one that is not saved
 * @property {number} wanted how many things were asked for
 * @property {number} failed how many of them could not be loaded
 * @property {string[]} gone keys of those that were deleted
 */

/**
 * Shows name, size and state of what is shown.
 * @param {{ name: string, entry: AssetEntry }[]} items those that are loaded
 * @param {Wanted} of
 */
export function showCaption(items, { title, wanted, failed, gone }) {
  if (items.length === 0 && !title) return;
  page.retry.hidden = failed === 0;
  const entries = items.map(({ entry }) => entry);
  const name = title || (items.length === 1 ? items[0].name : t('{count} objects', { count: items.length }));
  document.title = `${name} · capture2vr`;
  page.label.textContent = name;
  page.summary.textContent =
    wanted === 1 && !title ? aboutOne(entries[0]) : aboutAll(entries, { title, wanted, failed, gone });
  page.canvas.ariaLabel = [name, page.summary.textContent].join(': ');
  page.description.textContent = items.length === 1 ? (entries[0].description ?? '') : '';
  page.description.hidden = !page.description.textContent;
  const { dataset } = document.body;
  dataset.version = entries.map(({ version }) => version).join('; ');
  dataset.state = entries.every(({ state }) => state === 'refined') ? 'refined' : 'preview';
  delete dataset.code;
}

/**
 * What is said first of a shape that was not measured.
 * @param {AssetEntry} entry
 */
function originText({ origin }) {
  if (origin === 'generated') return `${t('Generated from one photo, not measured')} · `;
  return origin === 'guess' ? `${t('A guess from one photo')} · ` : '';
}

/** @param {AssetEntry} entry */
function aboutOne(entry) {
  const scale = entry.scale_confidence === 'unknown' ? ` (${t('true size unknown')})` : '';
  const origin = originText(entry);
  const version = t('{state}, version {version}', { state: stateText(entry.state), version: entry.version });
  return `${origin}${sizeText(entry.size_m)}${scale} · ${trianglesText([entry])} · ${version}`;
}

/**
 * @param {AssetEntry[]} entries
 * @param {Wanted} of
 */
function aboutAll(entries, { title, wanted, failed, gone }) {
  const coming = wanted - entries.length - failed - gone.length;
  const count = title && (wanted === 1 ? t('1 object') : t('{count} objects', { count: wanted }));
  const more = coming > 0 ? t('{count} more on the way', { count: coming }) : '';
  const lost = gone.length > 0 ? t('Not here any more, deleted or taken back: {keys}', { keys: gone.join(', ') }) : '';
  return [
    count,
    trianglesText(entries),
    more,
    failed > 0 ? t('{count} could not be loaded', { count: failed }) : '',
    lost,
  ]
    .filter(Boolean)
    .join(' · ');
}

/** @param {SizeM} size */
function sizeText(size) {
  return size
    .map((side) => (side < 1 ? `${(side * 100).toFixed(0)} cm` : `${formatNumber(side.toFixed(2))} m`))
    .join(' × ');
}

/** @param {AssetEntry[]} entries */
function trianglesText(entries) {
  const tiles = entries.flatMap(({ files = [] }) => files).filter(({ file }) => TILE.test(file)).length;
  if (tiles) return t('{count} tiles', { count: formatCount(tiles) });
  const sum = entries.reduce((all, { lods }) => all + Math.max(...lods.map(({ triangles }) => triangles)), 0);
  return t('{count} triangles', { count: formatCount(sum) });
}

/**
 * Lists several things: to select the one that the keys move, and to remove one. Nothing for one alone.
 * @template {ListedItem} T
 * @param {T[]} items
 * @param {{ selected: ListedItem | null, onSelect: (item: T) => void, onRemove: (item: T) => void }} options
 */
export function showList(items, { selected, onSelect, onRemove }) {
  const focus = document.activeElement;
  const action = focus instanceof HTMLElement && page.list.contains(focus) ? focus.dataset.act : undefined;
  page.list.hidden = items.length < 2;
  page.list.replaceChildren(
    ...items.map((item) =>
      createListItem(
        item,
        item === selected,
        () => onSelect(item),
        () => onRemove(item),
      ),
    ),
  );
  if (action) [...page.list.querySelectorAll('button')].find(({ dataset }) => dataset.act === action)?.focus();
}

/**
 * @param {ListedItem} item
 * @param {boolean} selected
 * @param {() => void} onSelect
 * @param {() => void} onRemove
 */
function createListItem({ key, name, entry }, selected, onSelect, onRemove) {
  const item = create('li');
  item.dataset.key = key;
  const select = createButton(entry ? name : `${name} …`, `choose ${key}`, onSelect);
  select.setAttribute('aria-pressed', String(selected));
  select.disabled = !entry;
  const remove = createButton('✕', `remove ${key}`, onRemove);
  remove.setAttribute('aria-label', t('Take {name} away', { name }));
  item.append(select, remove);
  return item;
}

/**
 * @param {string} text
 * @param {string} action by which it gets the focus back when the list is drawn anew
 * @param {() => void} onClick
 */
function createButton(text, action, onClick) {
  const button = create('button', { textContent: text });
  button.dataset.act = action;
  button.addEventListener('click', onClick);
  return button;
}

/**
 * Shows the link to an asset's USDZ file, in those of Apple's browsers that show it in the room (Quick Look).
 * @param {AssetEntry | null | undefined} entry without one the link is hidden
 */
export function showQuickLook(entry) {
  const link = page.quickLook;
  const file = entry?.files?.find(({ file: name }) => name === 'asset.usdz');
  const supported = link.relList.supports?.('ar');
  link.hidden = !file || !supported;
  if (!file || !supported || link.href === file.url) return;
  link.href = file.url;
  child(link, 'img', HTMLImageElement).src = entry?.preview?.url || '/web/shared/icon.svg';
}

/**
 * Shows a sentence for a while, or until the next one.
 * @param {string} text
 * @param {{ stays?: boolean }} [options] stays: until the next one in any case
 * @returns {() => void} takes it away, if no other one has taken its place
 */
export function showNotice(text, { stays = false } = {}) {
  clearTimeout(noticeTimer);
  page.notice.textContent = text;
  const clear = () => {
    if (page.notice.textContent === text) page.notice.textContent = '';
  };
  if (text && !stays) noticeTimer = setTimeout(clear, NOTICE_MS);
  return clear;
}

/**
 * Shows that there is nothing to see, and why.
 * @param {string} name of what would be there
 * @param {string} reason
 */
export function showNothing(name, reason) {
  document.title = `${name} · capture2vr`;
  page.label.textContent = name;
  page.summary.textContent = reason;
  page.canvas.ariaLabel = [name, reason].join(': ');
  page.description.hidden = page.retry.hidden = true;
  document.body.dataset.state = 'empty';
}

/**
 * Shows an error.
 * @param {unknown} error
 * @param {{ canRetry?: boolean }} [options] canRetry: with the button to try again
 */
export function showError(error, { canRetry = false } = {}) {
  document.body.dataset.state = 'error';
  const problem = toProblem(error);
  document.body.dataset.code = problem.code;
  page.summary.textContent = sentences(problem);
  page.canvas.ariaLabel = page.summary.textContent;
  if (!canRetry) return;
  page.label.textContent = t('Not loaded');
  page.retry.hidden = false;
}
