// /browse/{name}: the pictures of all things of a collection, a page at a time, to search, to open, and to choose from.
import { cardOf } from './card.js';
import { newest, rowsOf } from '../shared/signed-catalogue.js';
import { isConnectionProblem, sentences } from '../shared/problems.js';
import { registerServiceWorker } from '../shared/register-service-worker.js';
import { counted } from '../shared/messages.js';

const PER_PAGE = 48; // divides into rows of 2, 3, 4 and 6
const MOST = 24; // things in one scene, as the viewer has it
const TYPING_MS = 200; // between two letters of one word
const AHEAD = '300px'; // pictures are loaded before they scroll into view

const page = document.body;
page.dataset.started = 'yes';
const at = (id) => document.getElementById(id);
const name = decodeURIComponent(location.pathname.split('/').pop());
const asked = new URLSearchParams(location.search);
const chosen = new Set();
const rowsBy = new Map(); // sha256 of a shard → its rows
const seeing = new IntersectionObserver(seen, { rootMargin: AHEAD });

let wanted = asked.get('q') || '';
let number = Math.max(1, Math.floor(Number(asked.get('page'))) || 1);
let turn = 0; // of showing: an older one that is still loading shows nothing any more
let version = 0; // of what is shown

// ---- finding ----------------------------------------------------------------------------------------------------------

/** The rows of a page, and how many match: exactly, or, where not every shard had to be read, at least. */
async function find(collection) {
  const until = number * PER_PAGE;
  const matching = matcherOf(wanted);
  const rows = [];
  let count = 0;
  let exact = true;
  for (const shard of collection.shards) {
    if (count > until) {
      exact = false; // enough for this page and to know that another one follows
      break;
    }
    for (const row of (await known(collection, shard)).filter((each) => each.state !== 'removed' && matching(each))) {
      count += 1;
      if (count > until - PER_PAGE && count <= until) rows.push(row);
    }
  }
  return { rows, count, exact, collection };
}

/** Rows that were read stay in memory: who types a word searches all of them with every letter. */
async function known(collection, shard) {
  const { sha256 } = shard;
  if (!rowsBy.has(sha256)) rowsBy.set(sha256, await rowsOf(collection, shard));
  for (const other of rowsBy.keys()) if (!collection.shards.some((each) => each.sha256 === other)) rowsBy.delete(other);
  return rowsBy.get(sha256);
}

/** Every word is part of the name, of the key or of a label; case and accents do not count. */
function matcherOf(text) {
  const words = plain(text).split(/\s+/).filter(Boolean);
  return ({ key, label, labels }) => {
    const text = plain([label, key, ...labels].join('\n'));
    return words.every((word) => text.includes(word));
  };
}

const plain = (text) => text.normalize('NFKD').replace(/\p{M}/gu, '').toLowerCase();

// ---- showing ----------------------------------------------------------------------------------------------------------

async function show() {
  const mine = ++turn;
  page.setAttribute('aria-busy', 'true');
  at('again').hidden = true;
  if (page.dataset.state === 'error') at('said').textContent = 'Loading …';
  try {
    const found = await newest(name, find);
    if (mine === turn) fill(found);
  } catch (problem) {
    if (mine === turn) tell(problem);
  }
  page.removeAttribute('aria-busy');
}

function fill({ rows, count, exact, collection }) {
  if (rows.length === 0 && number > 1) return turnTo(1); // the page is gone: things were taken back
  empty();
  const cards = rows.map((row) => cardOf(collection, row, {
    chosen: chosen.has(row.key),
    onLabel: search,
    onChoose: (yes) => choose(row.key, yes),
    onLost: () => (at('again').hidden = false),
  }));
  at('grid').append(...cards);
  cards.forEach((card) => seeing.observe(card));
  const whole = collection.shards.reduce((sum, shard) => sum + shard.count, 0);
  at('said').textContent = summary(count, exact, whole);
  const pages = exact ? Math.ceil(count / PER_PAGE) : null;
  at('pages').hidden = number === 1 && pages !== null && pages <= 1;
  at('where').textContent = pages ? `Page ${number} of ${pages}` : `Page ${number}`;
  at('before').disabled = number === 1;
  at('next').disabled = pages !== null && number >= pages;
  version = collection.version;
  page.dataset.state = 'shown';
  page.dataset.version = version;
  delete page.dataset.code;
}

function summary(count, exact, whole) {
  const things = (many) => `${counted(many)} ${many === 1 ? 'thing' : 'things'}`;
  if (!wanted) return count === 0 ? 'Nothing is here yet.' : exact ? things(count) : `About ${things(whole)}`;
  if (count === 0) return `Nothing matches “${wanted}”.`;
  return `${exact ? things(count) : `More than ${things(count)}`} for “${wanted}”`;
}

function empty() {
  for (const card of at('grid').children) card.leave();
  seeing.disconnect();
  at('grid').replaceChildren();
}

function seen(entries) {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    seeing.unobserve(target);
    target.look();
  }
}

/** Nothing of a catalogue that is refused is shown, not even what stood here before. */
function tell(problem) {
  empty();
  at('pages').hidden = true;
  page.dataset.state = 'error';
  page.dataset.code = problem.code || 'UNKNOWN';
  const nothingYet = problem.code === 'COLLECTION_UNKNOWN' && name === 'default';
  at('said').textContent = nothingYet ? 'Nothing is here yet.' : sentences(problem);
  at('again').hidden = nothingYet;
}

// ---- searching and turning pages --------------------------------------------------------------------------------------

function search(text) {
  at('search').value = text;
  if (text.trim() === wanted) return;
  wanted = text.trim();
  number = 1;
  note();
  show();
}

function turnTo(page) {
  number = page;
  note();
  show().then(() => at('name').scrollIntoView());
}

/** In the address, for whoever comes back or sends it to others. */
function note() {
  const facts = [...(wanted ? [['q', wanted]] : []), ...(number > 1 ? [['page', number]] : [])];
  history.replaceState(null, '', `${location.pathname}${facts.length ? `?${new URLSearchParams(facts)}` : ''}`);
}

let typing = 0;
at('search').value = wanted;
at('search').addEventListener('input', () => {
  clearTimeout(typing);
  typing = setTimeout(() => search(at('search').value), TYPING_MS);
});
at('form').addEventListener('submit', (event) => {
  event.preventDefault();
  search(at('search').value);
});
at('before').addEventListener('click', () => turnTo(number - 1));
at('next').addEventListener('click', () => turnTo(number + 1));

// ---- choosing ---------------------------------------------------------------------------------------------------------

/** Whether it is chosen now. */
function choose(key, yes) {
  if (yes && chosen.size < MOST) chosen.add(key);
  if (!yes) chosen.delete(key);
  at('chosen').hidden = chosen.size === 0;
  at('count').textContent = chosen.size < MOST ? `${chosen.size} chosen` : `${chosen.size} chosen, which is as many as a headset draws`;
  at('open').textContent = chosen.size === 1 ? 'Open it' : 'Open together';
  at('open').href = `/view?${new URLSearchParams([...chosen].map((each) => ['key', each]))}`;
  return chosen.has(key);
}

at('none').addEventListener('click', () => {
  for (const key of [...chosen]) choose(key, false);
  for (const box of at('grid').querySelectorAll(':checked')) box.checked = false;
  at('search').focus();
});

// Whoever comes back to this page finds it as the collection is by then.
document.addEventListener('visibilitychange', () => {
  if (document.hidden) return;
  const changed = (now) => (now === version ? null : show());
  newest(name, async (collection) => collection.version).then(changed, (problem) => isConnectionProblem(problem) || tell(problem));
});

if (name !== 'default') {
  at('name').textContent = name;
  document.title = `${name} · capture2vr`;
}
at('again').addEventListener('click', () => show());
registerServiceWorker();
show();
