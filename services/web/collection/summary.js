// The line of the collection page that says how many things were found.
import { formatCount, stateText } from '../shared/format.js';
import { t } from '../shared/texts.js';

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
  const things = count === 1 ? t('1 object') : t('{count} objects', { count: formatCount(count) });
  const found = exact ? things : t('More than {things}', { things });
  if (asked.words) return t('{found} for “{words}”', { found, words: asked.words });
  if (asked.state) return `${found}, ${stateText(asked.state)}`;
  return exact || asked.limited ? found : t('About {count} objects', { count: formatCount(size) });
}

/** @param {Asked} asked */
function sayNothingFound({ words, state, limited }) {
  if (limited) return t('Nothing matches; look at “Date and size”.');
  if (words) return t('Nothing matches “{words}”.', { words });
  return state ? t('There are no {state} objects.', { state: stateText(state) }) : t('Nothing is here yet.');
}
