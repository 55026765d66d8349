// What gateway and worker say, in the reader's language. They speak English: to programs, to logs, and to people through a page.
// Modules that a worker loads may use it too: there, sentences are English.
import { language, readTable } from './texts.js';

const LONGEST = 1_000; // characters of a text that is translated: names in it are other people's, and each place of a value is tried
const MOST_KEPT = 1_000; // texts whose translations are remembered
const LEAST_LETTERS = 12; // of a sentence beside its values: what has fewer only joins others, and would fit by chance

/** @typedef {{ letters: number, pattern: RegExp, names: string[], german: string }} Template a sentence with values in it */

/** @type {Record<string, string> | undefined} */
let table; // of server-texts.json; read when the first sentence is to be shown
/** @type {Template[]} */
let templates = [];
/** @type {Map<string, string | undefined>} */
const known = new Map(); // by text: a value is looked for by every sentence that may quote it

/**
 * Translates a sentence of the server, and what it quotes. What is not known stays as it is.
 * @param {string} text
 * @returns {string}
 */
export function told(text) {
  if (language === 'en' || text.length > LONGEST) return text;
  if (known.size > MOST_KEPT) known.clear();
  return find(text) ?? text;
}

/**
 * @param {string} text
 * @returns {string | undefined}
 */
function find(text) {
  if (!known.has(text)) known.set(text, translate(text));
  return known.get(text);
}

/** @param {string} text */
function translate(text) {
  if (!table) {
    table = readTable('server-texts');
    templates = Object.entries(table).filter(([english]) => english.includes('{')).map(createTemplate)
      .toSorted((a, b) => b.letters - a.letters); // the one that says most fits best
  }
  return about(text) ?? byTable(text) ?? otherCase(text)
    ?? listed(text, /(?<=[.!?]) (?=[A-Z])/, ' ') ?? listed(text, '; ', '; ') ?? listed(text, ', ', ', ');
}

/** @param {string} text */
const byTable = (text) => (table && Object.hasOwn(table, text) ? table[text] : filled(text));

/**
 * The same sentence, begun with the other kind of letter.
 * @param {string} text
 */
function otherCase(text) {
  const first = text.charAt(0);
  const isUpper = first !== first.toLowerCase();
  const other = isUpper ? first.toLowerCase() : first.toUpperCase();
  const german = other === first ? undefined : byTable(other + text.slice(1));
  return german && (isUpper ? german.charAt(0).toUpperCase() + german.slice(1) : german);
}

/**
 * A sentence with values in it, of which some are sentences themselves.
 * @param {string} text
 */
function filled(text) {
  for (const { letters, pattern, names, german } of templates) {
    const values = pattern.exec(text)?.slice(1);
    if (!values || (letters < LEAST_LETTERS && values.some((value) => isSentence(value) && !find(value)))) continue;
    const by = new Map(names.map((name, place) => [name, germanNumber(values[place]) ?? find(values[place]) ?? values[place]]));
    return german.replace(/\{(\w+)\}/g, (whole, name) => by.get(name) ?? whole);
  }
  return undefined;
}

/**
 * 1,000.5 as 1.000,5; undefined where it is no number.
 * @param {string} value
 */
function germanNumber(value) {
  const separators = /** @type {Record<string, string>} */ ({ ',': '.', '.': ',' });
  return /^\d+(,\d{3})*(\.\d+)?%?$/.test(value) ? value.replace(/[,.]/g, (each) => separators[each]) : undefined;
}

/** @param {string} value */
const isSentence = (value) => /[a-z] [a-z]/i.test(value);

/**
 * A sentence about a file, whose name stands before it and is not translated, whatever words it has.
 * @param {string} text
 */
function about(text) {
  const [, name = '', said = ''] = /^(\S+: |[^:]*\.[^:]*: )(.+)$/s.exec(text) ?? [];
  const german = said && find(said);
  return german ? name + german : undefined;
}

/**
 * Several known ones in a row.
 * @param {string} text
 * @param {string | RegExp} between
 * @param {string} joint
 */
function listed(text, between, joint) {
  const parts = text.split(between);
  const german = parts.length > 1 ? parts.map(find) : [];
  return german.length && !german.includes(undefined) ? german.join(joint) : undefined;
}

/**
 * Any text may stand for a value, but for `{count}` and `{number}` none with a space.
 * @param {[english: string, german: string]} texts
 * @returns {Template}
 */
function createTemplate([english, german]) {
  const names = Array.from(english.matchAll(/\{(\w+)\}/g), ([, name]) => name);
  const parts = english.split(/\{\w+\}/);
  const sources = parts.map((part, place) => part.replace(/[.*+?^${}()|[\]\\]/g, '\\$&') + (names[place] ? valueOf(names[place]) : ''));
  return { letters: parts.join('').replace(/\W/g, '').length, pattern: new RegExp(`^${sources.join('')}$`, 's'), names, german };
}

/** @param {string} name */
const valueOf = (name) => (name === 'count' || name === 'number' ? String.raw`(\S+)` : '(.+?)');
