// The line of the collection page that says how many things were found.
import { formatCount } from '../shared/format.js';

/**
 * What was searched for. `limited`: by date or size
 * @typedef {{ words: string, state: string, limited: boolean }} Asked
 */

/**
 * Says how many things were found.
 * @param {number} count of assets that match
 * @param {boolean} exact whether that is all of them
 * @param {number} size of the collection
 * @param {Asked} asked
 */
export function summarize(count, exact, size, asked) {
  if (count === 0) return sayNothingFound(asked);
  const things = `${formatCount(count)} ${count === 1 ? 'thing' : 'things'}`;
  const found = exact ? things : `More than ${things}`;
  if (asked.words) return `${found} for “${asked.words}”`;
  if (asked.state) return `${found}, ${asked.state}`;
  return exact || asked.limited ? found : `About ${formatCount(size)} things`;
}

/** @param {Asked} asked */
function sayNothingFound({ words, state, limited }) {
  if (limited) return 'Nothing matches; look at “Date and size”.';
  if (words) return `Nothing matches “${words}”.`;
  return state ? `There are no ${state} things.` : 'Nothing is here yet.';
}
