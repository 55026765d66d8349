// The collection page (/browse/{name}): pictures of all assets of a collection, to search, to open, and to choose from.
import { Card } from './card.js';
import { fillFilters, isLimited, listenToFilters, readFilters } from './filters.js';
import { offerManaging, showManaging } from './manage.js';
import { listScenes } from './scenes.js';
import { PER_PAGE, search } from './search.js';
import { summarize } from './summary.js';
import { cutText } from '../catalogue/collection-rows.js';
import { hangingOf } from '../catalogue/garments.js';
import { withNewest } from '../catalogue/signed-catalogue.js';
import { showAccount } from '../shared/account.js';
import { element } from '../shared/dom.js';
import { isConnectionProblem, sentences, toProblem } from '../shared/problems.js';
import { registerServiceWorker } from '../shared/register-service-worker.js';
import { t } from '../shared/texts.js';
import { ofShownTenant, reloadForOtherTenant } from '../shared/whose.js';

/** @import { SearchResult } from './search.js' */
/** @import { CollectionRow } from '../shared/types.d.ts' */

const MOST_CHOSEN = 24; // things in one scene of the viewer
const TYPING_MS = 200; // between two letters of one word
const LOAD_AHEAD = '300px'; // pictures are loaded before they scroll into view

document.body.dataset.started = 'yes';
const page = {
  name: element('name', HTMLElement),
  form: element('form', HTMLFormElement),
  search: element('search', HTMLInputElement),
  summary: element('said', HTMLElement),
  retry: element('again', HTMLButtonElement),
  grid: element('grid', HTMLElement),
  pages: element('pages', HTMLElement),
  pageNumber: element('where', HTMLElement),
  previous: element('before', HTMLButtonElement),
  next: element('next', HTMLButtonElement),
  choice: element('chosen', HTMLElement),
  choiceCount: element('count', HTMLElement),
  open: element('open', HTMLAnchorElement),
  clear: element('none', HTMLButtonElement),
  wardrobe: element('wardrobe', HTMLAnchorElement),
};

const name = decodeURIComponent(location.pathname.split('/').pop() ?? '');
const parameters = new URLSearchParams(location.search);
/** @type {Set<string>} */
const chosenKeys = new Set();
/** @type {Map<Element, Card>} */
const cards = new Map(); // by their elements
const visibility = new IntersectionObserver(loadVisible, { rootMargin: LOAD_AHEAD });

let query = parameters.get('q') || '';
let notice = ''; // of what was done, shown before the next summary
let pageNumber = Math.max(1, Math.floor(Number(parameters.get('page'))) || 1);
let lastRequest = 0; // an older one that is still loading shows nothing any more
let shownVersion = 0; // of the collection
let typingTimer = 0;

// ---- showing ----------------------------------------------------------------------------------------------------------

/** Searches, and shows the page of results. */
async function show() {
  if (reloadForOtherTenant()) return;
  const request = ++lastRequest;
  document.body.setAttribute('aria-busy', 'true');
  page.retry.hidden = true;
  if (document.body.dataset.state === 'error') page.summary.textContent = t('Loading …');
  try {
    const result = await withNewest(name, (collection) =>
      search(collection, { words: query, ...readFilters() }, pageNumber),
    );
    if (request === lastRequest) showResult(result);
  } catch (error) {
    if (request === lastRequest) showError(error);
  }
  document.body.removeAttribute('aria-busy');
}

/** @param {SearchResult} result */
function showResult({ rows, count, exact, isCut, collection }) {
  if (rows.length === 0 && pageNumber > 1) {
    goToPage(Math.max(1, Math.ceil(count / PER_PAGE))); // this page is gone, or never was: assets were removed
    return;
  }
  removeCards();
  for (const row of rows) {
    const card = new Card(collection, row, {
      chosen: chosenKeys.has(row.key),
      onLabel: searchFor,
      onChoose: (yes) => choose(row.key, yes),
      onLost: () => (page.retry.hidden = false),
    });
    cards.set(card.element, card);
  }
  page.grid.append(...cards.keys());
  if (rows.some(hangingOf)) page.wardrobe.hidden = false;
  for (const item of cards.keys()) visibility.observe(item);
  const asked = { words: query, state: readFilters().state, limited: isLimited() };
  const found = summarize(count, exact, collection.count, asked);
  page.summary.textContent = [notice, isCut ? `${found} · ${cutText()}` : found].filter(Boolean).join(' ');
  notice = '';
  showPageNumber(exact || isCut ? Math.ceil(count / PER_PAGE) : null);
  shownVersion = collection.version;
  document.body.dataset.state = 'shown';
  document.body.dataset.version = String(shownVersion);
  delete document.body.dataset.code;
}

/** @param {number | null} pages null where it is not known how many there are */
function showPageNumber(pages) {
  page.pages.hidden = pageNumber === 1 && pages !== null && pages <= 1;
  page.pageNumber.textContent = pages
    ? t('Page {number} of {pages}', { number: pageNumber, pages })
    : t('Page {number}', { number: pageNumber });
  setDisabled(page.previous, pageNumber === 1);
  setDisabled(page.next, pages !== null && pageNumber >= pages);
}

/**
 * Not by `disabled`, which would take the focus from a button that was pressed.
 * @param {HTMLButtonElement} button
 * @param {boolean} disabled
 */
function setDisabled(button, disabled) {
  button.setAttribute('aria-disabled', String(disabled));
}

/** Removes all cards and frees the memory of their pictures. */
function removeCards() {
  for (const card of cards.values()) card.dispose();
  cards.clear();
  visibility.disconnect();
  page.grid.replaceChildren();
}

/**
 * Loads the pictures of cards that come into view.
 * @param {IntersectionObserverEntry[]} entries
 */
function loadVisible(entries) {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    visibility.unobserve(target);
    cards.get(target)?.loadPicture();
  }
}

/**
 * Shows an error in place of all cards: nothing of a catalogue that was refused may be seen, not even what was shown before.
 * @param {unknown} error
 */
function showError(error) {
  const problem = toProblem(error);
  removeCards();
  page.pages.hidden = true;
  document.body.dataset.state = 'error';
  document.body.dataset.code = problem.code;
  const nothingYet = problem.code === 'COLLECTION_UNKNOWN' && name === 'default';
  page.summary.textContent = nothingYet ? t('Nothing is here yet.') : sentences(problem);
  page.retry.hidden = nothingYet;
}

// ---- searching and turning pages --------------------------------------------------------------------------------------

/** @param {string} text */
function searchFor(text) {
  page.search.value = text;
  if (text.trim() === query) return;
  query = text.trim();
  pageNumber = 1;
  writeAddress();
  show();
}

/**
 * Turns the page, unless there is none in that direction or it is being turned already.
 * @param {HTMLButtonElement} button
 * @param {1 | -1} by
 */
function turnPage(button, by) {
  if (button.getAttribute('aria-disabled') === 'true') return;
  for (const each of [page.previous, page.next]) setDisabled(each, true); // until it is shown
  goToPage(pageNumber + by);
}

/** @param {number} number */
function goToPage(number) {
  pageNumber = number;
  writeAddress();
  show().then(() => page.name.scrollIntoView());
}

/** Writes the search and the page into the address, for who comes back or sends it to others. */
function writeAddress() {
  const written = new URLSearchParams();
  if (query) written.set('q', query);
  for (const [filter, value] of Object.entries(readFilters())) if (value) written.set(filter, value);
  if (pageNumber > 1) written.set('page', String(pageNumber));
  history.replaceState(null, '', ofShownTenant([location.pathname, written.toString()].filter(Boolean).join('?')));
}

/** Listens to the search field, and to the buttons that turn the page. */
function listenToSearch() {
  page.search.value = query;
  page.search.addEventListener('input', () => {
    clearTimeout(typingTimer);
    typingTimer = setTimeout(() => searchFor(page.search.value), TYPING_MS);
  });
  page.form.addEventListener('submit', (event) => {
    event.preventDefault();
    searchFor(page.search.value);
  });
  listenToFilters(() => {
    clearChoice();
    goToPage(1);
  });
  page.previous.addEventListener('click', () => turnPage(page.previous, -1));
  page.next.addEventListener('click', () => turnPage(page.next, 1));
}

// ---- choosing ---------------------------------------------------------------------------------------------------------

/**
 * Chooses an asset to open, or no longer.
 * @param {string} key
 * @param {boolean} yes
 * @returns {boolean} whether it is chosen now
 */
function choose(key, yes) {
  if (yes && chosenKeys.size < MOST_CHOSEN) chosenKeys.add(key);
  if (!yes) chosenKeys.delete(key);
  const count = chosenKeys.size;
  const removed = readFilters().state === 'removed';
  showManaging(removed);
  page.open.hidden = removed;
  page.choice.hidden = count === 0;
  page.choiceCount.textContent =
    count < MOST_CHOSEN
      ? t('{count} chosen', { count })
      : t('{count} chosen, which is as many as a headset draws', { count });
  page.open.textContent = count === 1 ? t('Open it') : t('Open together');
  page.open.href = ofShownTenant(`/view?${new URLSearchParams([...chosenKeys].map((each) => ['key', each]))}`);
  return chosenKeys.has(key);
}

/** Chooses nothing. */
function clearChoice() {
  for (const key of [...chosenKeys]) choose(key, false);
  for (const box of page.grid.querySelectorAll('input')) box.checked = false;
}

/**
 * Shows the collection after something was done with the chosen things.
 * @param {string} said
 */
function showDone(said) {
  const hadFocus = page.choice.contains(document.activeElement);
  notice = said;
  clearChoice();
  if (hadFocus) page.summary.focus(); // the button that was pressed is hidden now
  show();
}

/** Shows the collection as it is by now, when the person comes back to this page. */
async function reloadIfChanged() {
  if (document.hidden || reloadForOtherTenant()) return;
  try {
    const version = await withNewest(name, async (collection) => collection.version);
    if (version !== shownVersion) show();
  } catch (error) {
    if (!isConnectionProblem(error)) showError(error);
  }
}

page.wardrobe.href = ofShownTenant(`/wardrobe/${encodeURIComponent(name)}`);
fillFilters(parameters);
listenToSearch();
page.retry.addEventListener('click', show);
page.clear.addEventListener('click', () => {
  clearChoice();
  page.search.focus();
});
document.addEventListener('visibilitychange', reloadIfChanged);
if (name !== 'default') {
  page.name.textContent = name;
  document.title = `${name} · capture2vr`;
}
registerServiceWorker();
show();
showAccount().then((session) => {
  const own = ofShownTenant('') === '' ? session : null;
  offerManaging(own, { chosen: () => [...chosenKeys], onDone: showDone });
  return listScenes(own);
});
