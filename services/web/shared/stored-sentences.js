// Sentences that are stored with a thing, in the reader's language. A manifest's bytes are hashed, so the server cannot translate them; it
// keeps the codes of their sentences beside the English. What answers of the API say is in the reader's language already.
import { getJson } from './api.js';
import { language } from './texts.js';

/** @import { SentenceCode, SentenceValue } from './types.d.ts' */

/** @type {Record<string, string>} */
let catalogue = {}; // by code; empty in an English page, and until it is loaded

/** Loads the sentences of the page's language, once. Without them sentences stay English. */
export async function loadSentences() {
  const address = document.documentElement.dataset.sentences;
  if (address && !Object.keys(catalogue).length) catalogue = await getJson(address).catch(() => ({}));
}

/**
 * Returns a stored sentence in the page's language; its English where the code is missing or unknown.
 * @param {string} english
 * @param {SentenceCode | null} [coded] what the manifest has beside it
 * @returns {string}
 */
export function stored(english, coded) {
  if (!coded || language === 'en') return english;
  const { code, values } = coded;
  if (code === 'row' && Array.isArray(values.parts)) {
    return values.parts.map((part) => shown(part)).join(String(values.joint));
  }
  if (code === 'capital') return capitalised(shown(values.part));
  const text = Object.hasOwn(catalogue, code) ? catalogue[code] : undefined;
  if (text === undefined) return english;
  return text.replace(/\{(\w+)(?::([^{}]*))?\}/g, (whole, name, format = '') =>
    Object.hasOwn(values, name) ? shown(values[name], format) : whole,
  );
}

/**
 * @param {string[]} sentences
 * @param {(SentenceCode | null)[]} [codes]
 */
export const allStored = (sentences, codes = []) => sentences.map((each, place) => stored(each, codes[place]));

/**
 * @param {SentenceValue} value
 * @param {string} [format] as Python writes it: `,` `.2f` `,.0f` `.1%` `.3g`
 * @returns {string}
 */
function shown(value, format = '') {
  if (typeof value === 'number') return numberText(value, format);
  return typeof value === 'object' && 'code' in value ? stored(value.text ?? '', value) : String(value);
}

/**
 * @param {number} value
 * @param {string} format
 */
function numberText(value, format) {
  const [, comma, places, kind] = /^(,?)(?:\.(\d+))?([f%g]?)$/.exec(format) ?? [];
  const number = kind === '%' ? 100 * value : value;
  const digits = kind === 'g' ? { maximumSignificantDigits: Number(places ?? 6) } : fixedDigits(places);
  return `${number.toLocaleString(language, { useGrouping: comma === ',', ...digits })}${kind === '%' ? '%' : ''}`;
}

/** @param {string} [places] */
const fixedDigits = (places) =>
  places === undefined
    ? { maximumFractionDigits: 15 }
    : { minimumFractionDigits: Number(places), maximumFractionDigits: Number(places) };

/** @param {string} text */
const capitalised = (text) => text.charAt(0).toUpperCase() + text.slice(1);
