// What the viewer's page says: of what is shown, of what has changed, and of what went wrong.

import { sentences } from './problems.js';

const NOTICE_MS = 10_000; // long enough to read, short enough not to lie about the present

const page = document.body;
const at = (id) => document.getElementById(id);
let fading = 0;

/** Name, size and state of what is shown; `wanted`: how many things were asked for, `failed`: how many of them could not be loaded. */
export function caption(pieces, wanted, failed) {
  if (pieces.length === 0) return;
  at('again').hidden = failed === 0;
  const entries = pieces.map(({ entry }) => entry);
  const name = pieces.length === 1 ? pieces[0].name : `${pieces.length} things`;
  document.title = `${name} · capture2vr`;
  at('label').textContent = name;
  at('said').textContent = wanted === 1 ? aboutOne(entries[0]) : aboutAll(entries, wanted, failed);
  page.dataset.version = entries.map(({ version }) => version).join('; ');
  page.dataset.state = entries.every(({ state }) => state === 'refined') ? 'refined' : 'preview';
  delete page.dataset.code;
}

function aboutOne(entry) {
  const scale = entry.scale_confidence === 'unknown' ? ' (true size unknown)' : '';
  const origin = entry.origin === 'guess' ? 'A guess from one photo · ' : '';
  return `${origin}${sizeOf(entry)}${scale} · ${trianglesOf([entry])} · ${entry.state}, version ${entry.version}`;
}

function aboutAll(entries, wanted, failed) {
  const coming = wanted - entries.length - failed;
  const more = coming > 0 ? `${coming} more ${coming === 1 ? 'is' : 'are'} on the way` : '';
  return [trianglesOf(entries), more, failed > 0 ? `${failed} could not be loaded` : ''].filter(Boolean).join(' · ');
}

function sizeOf({ size_m: size }) {
  return size.map((side) => (side < 1 ? `${(side * 100).toFixed(0)} cm` : `${side.toFixed(2)} m`)).join(' × ');
}

function trianglesOf(entries) {
  const sum = entries.reduce((all, { lods }) => all + Math.max(...lods.map(({ triangles }) => triangles)), 0);
  return `${counted(sum)} triangles`;
}

/** 1234567 as 1,234,567: the browser's own way loads tables for a twentieth of a second first. */
export const counted = (many) => String(many).replace(/\B(?=(\d{3})+$)/g, ',');

/** The list of several things: to choose whom the keys move, and to take one away. Nothing for one alone. */
export function showThings(pieces, { chosen, onChoose, onRemove }) {
  const list = at('things');
  list.hidden = pieces.length < 2;
  const focused = list.contains(document.activeElement) ? document.activeElement.dataset.act : null;
  list.replaceChildren(...pieces.map((piece) => thing(piece, piece === chosen, onChoose, onRemove)));
  if (focused) [...list.querySelectorAll('button')].find(({ dataset }) => dataset.act === focused)?.focus();
}

function thing(piece, chosen, onChoose, onRemove) {
  const item = document.createElement('li');
  item.dataset.key = piece.key;
  const choose = button(piece.entry ? piece.name : `${piece.name} …`, `choose ${piece.key}`, () => onChoose(piece));
  choose.setAttribute('aria-pressed', chosen);
  choose.disabled = !piece.entry;
  const remove = button('✕', `remove ${piece.key}`, () => onRemove(piece));
  remove.setAttribute('aria-label', `Take ${piece.name} away`);
  item.append(choose, remove);
  return item;
}

function button(text, act, does) {
  const made = document.createElement('button');
  made.textContent = text;
  made.dataset.act = act;
  made.addEventListener('click', does);
  return made;
}

/** The link to an asset's USDZ, where the browser is one of Apple's that show it in the room. */
export function showQuickLook(entry) {
  const link = at('quick-look');
  const file = entry?.files?.find(({ file: name }) => name === 'asset.usdz');
  link.hidden = !file || !link.relList.supports?.('ar');
  if (link.hidden || link.href === file.url) return;
  link.href = file.url;
  link.querySelector('img').src = entry.preview?.url || '/web/shared/icon.svg';
}

/** A sentence for a while, or until the next one. */
export function notice(text, { stays = false } = {}) {
  clearTimeout(fading);
  at('notice').textContent = text;
  if (text && !stays) fading = setTimeout(() => (at('notice').textContent = ''), NOTICE_MS);
}

/** Say what went wrong; `again`: with the button to try again. */
export function tell(problem, { again = false } = {}) {
  page.dataset.state = 'error';
  page.dataset.code = problem.code || 'UNKNOWN';
  at('said').textContent = sentences(problem);
  if (!again) return;
  at('label').textContent = 'Not loaded';
  at('again').hidden = false;
}
