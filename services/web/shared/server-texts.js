// What gateway and worker say, in the reader's language. They speak English: to programs, to logs, and to people through a page.
// Modules that a worker loads may use it too: there, sentences are English.
import { language, readTable } from './texts.js';

const LEAST_LETTERS = 12; // of a sentence beside its values: what has fewer only joins others, and would fit by chance

/** @typedef {{ letters: number, pattern: RegExp, names: string[], german: string }} Template a sentence with values in it */

/** @type {Record<string, string> | undefined} */
let table; // of server-texts.json; read when the first sentence is to be shown
/** @type {Template[]} */
let templates = [];

/**
 * Translates a sentence of the server, and what it quotes. What is not known stays as it is.
 * @param {string} text
 * @returns {string}
 */
export function told(text) {
  return language === 'en' ? text : find(text) ?? text;
}

/**
 * @param {string} text
 * @returns {string | undefined}
 */
function find(text) {
  if (!table) {
    table = readTable('server-texts');
    templates = Object.entries(table).filter(([english]) => english.includes('{')).map(createTemplate)
      .toSorted((a, b) => b.letters - a.letters); // the one that says most fits best
  }
  return exact(text) ?? otherCase(text) ?? filled(text) ?? about(text)
    ?? listed(text, /(?<=[.!?]) (?=[A-Z])/, ' ') ?? listed(text, '; ', '; ') ?? listed(text, ', ', ', ');
}

/** @param {string} text */
const exact = (text) => (table && Object.hasOwn(table, text) ? table[text] : undefined);

/**
 * The same sentence, begun with the other kind of letter.
 * @param {string} text
 */
function otherCase(text) {
  const first = text.charAt(0);
  const isUpper = first === first.toUpperCase();
  const german = exact((isUpper ? first.toLowerCase() : first.toUpperCase()) + text.slice(1));
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
    const by = new Map(names.map((name, place) => [name, germanNumber(values[place]) ?? told(values[place])]));
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
 * A sentence about a file, whose name stands before it.
 * @param {string} text
 */
function about(text) {
  const end = text.indexOf(': ');
  const german = end < 0 ? undefined : find(text.slice(end + 2));
  return german && text.slice(0, end + 2) + german;
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
