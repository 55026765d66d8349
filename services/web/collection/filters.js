// What the collection page is searched by, besides words: order, state, date and size, in fields and in the address.
import { element } from '../shared/dom.js';

/** @import { Query } from './search.js' */

/** @typedef {Omit<Query, 'words'>} Filters */

const fields = {
  order: element('order', HTMLSelectElement),
  state: element('state', HTMLSelectElement),
  since: element('since', HTMLInputElement),
  until: element('until', HTMLInputElement),
  least: element('least', HTMLInputElement),
  most: element('most', HTMLInputElement),
};
const NAMES = /** @type {(keyof Filters)[]} */ (Object.keys(fields));
const limits = element('limits', HTMLDetailsElement);
const clear = element('any', HTMLButtonElement);
const LIMITS = /** @type {const} */ (['since', 'until', 'least', 'most']);

/**
 * Fills the fields from the address. What a field cannot hold is left out.
 * @param {URLSearchParams} parameters
 */
export function fillFilters(parameters) {
  for (const name of NAMES) fields[name].value = parameters.get(name) ?? '';
  if (fields.order.selectedIndex < 0) fields.order.value = '';
  if (fields.state.selectedIndex < 0) fields.state.value = '';
  limits.open = isLimited();
  clear.hidden = !isLimited();
}

/** @returns {Filters} what the fields say; of a field whose text is no number or day: nothing */
export function readFilters() {
  return /** @type {Filters} */ (Object.fromEntries(NAMES.map((name) => [name, fields[name].value])));
}

/** Whether a date or a size is asked for. */
export const isLimited = () => LIMITS.some((name) => fields[name].value !== '');

/**
 * Calls a function whenever a field has changed.
 * @param {() => void} onChange
 */
export function listenToFilters(onChange) {
  for (const field of Object.values(fields)) {
    field.addEventListener('change', () => {
      clear.hidden = !isLimited();
      onChange();
    });
  }
  clear.addEventListener('click', () => {
    for (const name of LIMITS) fields[name].value = '';
    clear.hidden = true;
    onChange();
  });
}
