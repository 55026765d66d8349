// Which garments the wardrobe shows, and how fast, as the page's address says: ?season=summer, ?season=all or ?label=evening, and ?every=30.
import { seasonName } from './wardrobe-panel.js';
import { SEASONS, seasonOf } from '../catalogue/garments.js';
import { t } from '../shared/texts.js';

/** @import { Choice } from '../catalogue/garments.js' */

const [LEAST_S, MOST_S] = [2, 3600]; // from one garment to the next

/**
 * The choice in a page's address; without one this season.
 * @param {string} search
 * @returns {Choice}
 */
export function choiceIn(search) {
  const parameters = new URLSearchParams(search);
  const [season, label] = [parameters.get('season'), parameters.get('label')];
  if (label) return `label:${label}`;
  const named = season === 'all' ? season : SEASONS.find((each) => each === season);
  return named ?? seasonOf(new Date(), Intl.DateTimeFormat().resolvedOptions().timeZone);
}

/**
 * After how many seconds a page's address wants the next garment; 0 where it does not say: they change by hand.
 * @param {string} search
 */
export function secondsIn(search) {
  const every = Number(new URLSearchParams(search).get('every'));
  return every > 0 ? Math.min(MOST_S, Math.max(LEAST_S, every)) : 0;
}

/**
 * The page's address with another choice.
 * @param {Choice} choice
 */
export function addressOf(choice) {
  const parameters = new URLSearchParams(location.search);
  for (const name of ['label', 'season']) parameters.delete(name);
  if (choice.startsWith('label:')) parameters.set('label', choice.slice('label:'.length));
  else parameters.set('season', choice);
  return `${location.pathname}?${parameters}`;
}

/**
 * Why there is nothing of a choice.
 * @param {Choice} choice
 */
export function emptyText(choice) {
  if (choice === 'all') return t('No garment is here yet. Give an object a tag such as “summer” or “dress”.');
  const season = SEASONS.find((each) => each === choice);
  if (season) {
    return t('No garment has a tag of this season: {season}. Choose another one, or all garments.', {
      season: seasonName(season),
    });
  }
  return t('Nothing has this tag any more.');
}
