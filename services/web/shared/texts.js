// The sentences of the pages in the reader's language. Modules that a worker loads may use it too: there, sentences are English.

/** @typedef {{ documentElement: { lang: string }, getElementById: (id: string) => { textContent: string | null } | null }} PageDocument */

const page = /** @type {{ document?: PageDocument }} */ (/** @type {unknown} */ (globalThis)).document; // a worker has none

/** The language of the page: the gateway has chosen it among those that the browser prefers. */
export const language = page?.documentElement.lang || 'en';

/** @type {Record<string, string>} */
const translations = JSON.parse(page?.getElementById('texts')?.textContent || '{}'); // of this page's sentences; none in an English page

/**
 * Translates a sentence of a page.
 * @param {string} text in English, as services/web/texts.json has it; `{name}` stands for a value
 * @param {Record<string, string | number>} [values] by name; text among them is taken as it is
 * @returns {string}
 */
export function t(text, values = {}) {
  return (translations[text] ?? text).replace(/\{(\w+)\}/g, (whole, name) => String(values[name] ?? whole));
}
