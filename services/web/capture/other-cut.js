// Says what was kept of the capture, and offers the other cut: the job runs again on the stored capture, without an upload.
import { showTrouble } from './page-state.js';
import { postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { stored } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';

/** @import { CaptureSummary, Cut, Job } from '../shared/types.d.ts' */

const page = {
  section: element('other-cut', HTMLElement),
  kept: element('kept', HTMLElement),
  button: element('recut', HTMLButtonElement),
};

/** @type {{ kept: string, name: string, other: Cut, offer: string }[]} */
const CUTS = [
  { kept: 'object', name: t('the object in the middle'), other: 'scene', offer: t('Keep everything that was seen') },
  {
    kept: 'scene',
    name: t('everything that was seen'),
    other: 'object',
    offer: t('Keep only the object in the middle'),
  },
];

/** @type {() => void} */
let recut = () => {};

/**
 * Shows what was kept of a job's capture, with a button for the other choice; nothing where there was no choice.
 * @param {Job} job
 * @param {CaptureSummary | undefined} capture
 */
export function showCut(job, capture) {
  const cut = capture?.cut;
  const choice = CUTS.find(({ kept }) => kept === cut?.kept);
  page.section.hidden = !cut || !choice;
  if (!cut || !choice) return;
  page.kept.textContent = t('What was kept: {what}; {because}.', {
    what: choice.name,
    because: stored(cut.because, cut.because_i18n),
  }); // a doubt stands among the warnings
  page.button.textContent = choice.offer;
  recut = () => repeatJob(job, choice.other);
}

/**
 * Starts the job again with another cut, and watches it.
 * @param {Job} job
 * @param {Cut} cut
 */
async function repeatJob(job, cut) {
  page.button.disabled = true; // one tap, one job; so does the key
  try {
    /** @type {Job} */
    const again = await postJson(job.links.again, { cut }, { 'Idempotency-Key': `${job.id}-${cut}` });
    location.hash = `job=${again.id}`;
    location.reload();
  } catch (error) {
    page.button.disabled = false;
    showTrouble(error);
  }
}

page.button.addEventListener('click', () => recut());
