// The lists of the result: which photos were used, why others were left out, and which sides need more photos.
import { child, create, fillList } from '../shared/dom.js';
import { stored } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';

/** @import { CaptureSummary, PhotoVerdict } from '../shared/types.d.ts' */

/** @type {Record<string, string>} */
const REASONS = {
  ok: t('used'),
  blur: t('blurred'),
  dark: t('too dark'),
  duplicate: t('a copy'),
  no_overlap: t('no overlap'),
  unreadable: t('unreadable'),
};

/**
 * Lists which photos were used and which not. Hides the list of a capture that has neither photos nor a film.
 * @param {HTMLElement} details the element to fill
 * @param {CaptureSummary} [capture] of the manifest
 */
export function showVerdicts(details, { photos: verdicts = [], format } = {}) {
  const rejected = verdicts.filter(({ verdict }) => verdict !== 'ok');
  const used = verdicts.filter(({ verdict }) => verdict === 'ok');
  details.hidden = verdicts.length === 0;
  child(details, 'summary', HTMLElement).textContent =
    format === 'video'
      ? t('Used {count} of {total} pictures of the video', { count: used.length, total: verdicts.length })
      : t('Used {count} of {total} photos', { count: used.length, total: verdicts.length });
  child(details, 'ul', HTMLUListElement).replaceChildren(...[...rejected, ...used].map(verdictItem));
}

/** @param {PhotoVerdict} verdict */
function verdictItem({ name, verdict, advice, advice_i18n: code }) {
  const item = create('li');
  item.dataset.verdict = verdict;
  item.append(
    create('strong', { textContent: name }),
    ` ${REASONS[verdict] ?? verdict}${advice ? `. ${stored(advice, code)}` : ''}`,
  );
  return item;
}

/**
 * Lists the sides of the object that the capture shows too little of. Hides the list where there is none.
 * @param {HTMLElement} details the element to fill
 * @param {CaptureSummary} [capture] of the manifest
 */
export function showUnseenSides(details, { unseen: sides = [] } = {}) {
  details.hidden = sides.length === 0;
  fillList(
    child(details, 'ul', HTMLUListElement),
    sides.map(({ advice, advice_i18n: code }) => stored(advice, code)),
  );
}
