// More photos of a thing: the page then adds them to those that are stored, and the job makes the next version of the same asset.
import { expectMore } from './file-choice.js';
import { keepContinued } from './keeping.js';
import { getJson } from '../shared/api.js';
import { element, fillList } from '../shared/dom.js';
import { Problem } from '../shared/problems.js';
import { loadSentences, stored } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, CaptureSummary, Job, Manifest } from '../shared/types.d.ts' */

const NOT_FOUND = 404;
const OF_PHOTOS = ['photos', 'photo']; // formats of captures that photos can be added to

const page = {
  section: element('more-photos', HTMLElement),
  heading: element('more-heading', HTMLElement),
  lost: element('more-lost', HTMLElement),
  unseen: element('more-unseen', HTMLUListElement),
  details: element('details', HTMLElement),
  missing: element('missing', HTMLElement),
  add: element('add-photos', HTMLButtonElement),
};

/** @type {Job | null} */
let earlier = null;
let offered = ''; // id of the job whose photos the button adds to

/** Id of the job that the page's address names to add photos to; '' where the page makes a new thing. */
export const addedTo = () => new URLSearchParams(location.hash.slice(1)).get('add') ?? '';

/** The job that is continued, or null where the page makes a new thing. */
export const continuedJob = () => earlier;

/**
 * Offers to add photos to what a job has made, where its capture is one of photos.
 * @param {Job} job
 * @param {CaptureSummary | undefined} capture of the manifest
 */
export function offerMorePhotos(job, capture) {
  offered = job.id;
  page.add.hidden = job.state !== 'SUCCEEDED' || !OF_PHOTOS.includes(capture?.format ?? '');
}

/**
 * Goes on with the thing that the page's address names, if it names one. Resolves once `continuedJob` is known.
 * @throws {Problem} as `getJson`
 */
export async function startContinuing() {
  const id = addedTo();
  if (!id) return;
  keepContinued(id);
  /** @type {Job} */
  const job = await getJson(`/v1/jobs/${encodeURIComponent(id)}`).catch(withoutThing);
  earlier = job;
  showContinued(job);
}

/**
 * Where the thing is gone, its draft is no longer bound to it: the photos can make a new one.
 * @param {unknown} error
 * @returns {never}
 */
function withoutThing(error) {
  if (error instanceof Problem && error.status === NOT_FOUND) keepContinued('');
  throw error;
}

/** @param {Job} job */
async function showContinued({ id, asset_key: key, label, edits = {} }) {
  const name = label || key;
  page.section.hidden = false;
  page.details.hidden = true;
  page.heading.textContent = t('More photos of {name}', { name });
  page.lost.hidden = !(
    edits.crop ||
    edits.planes?.length ||
    edits.lassos?.length ||
    edits.up ||
    edits.front ||
    edits.length
  );
  expectMore(name);
  keepContinued(id, name);
  document.body.dataset.continues = key;
  const advice = await unseenSides(key);
  fillList(page.unseen, advice);
  page.missing.textContent = advice[0] ?? '';
  page.missing.hidden = advice.length === 0;
}

/**
 * What the newest version says of sides that were seen too little.
 * @param {string} key
 * @returns {Promise<string[]>} sentences
 */
async function unseenSides(key) {
  try {
    /** @type {AssetEntry} */
    const entry = await getJson(`/v1/assets/${encodeURIComponent(key)}`);
    /** @type {Manifest} */
    const { capture } = await getJson(entry.manifest.url);
    await loadSentences();
    return (capture?.unseen ?? []).map(({ advice, advice_i18n: code }) => stored(advice, code));
  } catch {
    return []; // nothing published yet, or no connection
  }
}

page.add.addEventListener('click', () => {
  location.hash = `add=${offered}`;
  location.reload();
});
