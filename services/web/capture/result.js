// The result of a job: the preview that turns, the address of the viewer, which photos were used, and the quality figures.
import { durationText } from '../shared/job-progress.js';
import { offerMorePhotos } from './continuing.js';
import { showUnseenSides, showVerdicts } from './photo-verdicts.js';
import { showCut } from './run-again.js';
import { getJson, getSession, getVersion, restoreVersion } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { formatCount, formatNumber } from '../shared/format.js';
import { gradeReason, gradeText } from '../shared/grade.js';
import { loadSentences } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';
import { PREVIEW_MODULES_MS, withTimeLimit } from '../shared/time-limits.js';

/** @import { AnchorPoints, AssetEntry, Job, JobState, Manifest, PublishedVersion, QualityFigures } from '../shared/types.d.ts' */
/** @typedef {(value: number) => string} Format */

/** States of a job that has ended. @type {JobState[]} */
export const FINAL = ['SUCCEEDED', 'FAILED', 'CANCELLED'];

/** @type {Format} */
const ofSize = (share) => t('{percent} % of its size', { percent: formatNumber((100 * share).toFixed(2)) });
/** @type {Format} */
const percent = (share) => `${formatNumber((100 * share).toFixed(1))} %`;
/** @type {Format} */
const count = (number) => formatCount(Math.round(number));

/** @type {[key: keyof QualityFigures, label: string, format: Format][]} */
const FIGURES = [
  ['held_out_mean', t('From points it was not shown'), ofSize],
  ['points_to_mesh_median', t('From the scanned points'), ofSize],
  ['coverage', t('Points covered'), percent],
  ['components', t('Pieces'), count],
  ['boundary_loops', t('Open borders'), count],
  ['non_manifold_edges', t('Edges of more than two sides'), count],
  ['triangles', t('Triangles'), count],
  ['steps', t('Steps of training'), count],
  ['seconds', t('Computed in'), durationText],
];

const page = {
  result: element('result', HTMLElement),
  pointed: element('pointed', HTMLElement),
  ready: element('ready', HTMLElement),
  reason: element('reason-of-grade', HTMLElement),
  made: element('made', HTMLElement),
  held: element('held', HTMLElement),
  heldBack: element('held-back', HTMLElement),
  keep: element('keep', HTMLButtonElement),
  keepRefused: element('keep-refused', HTMLElement),
  opened: element('opened', HTMLElement),
  view: element('view', HTMLAnchorElement),
  link: element('link', HTMLElement),
  qr: element('qr', HTMLImageElement),
  preview: element('preview', HTMLCanvasElement),
  notDrawn: element('undrawn', HTMLElement),
  used: element('used', HTMLElement),
  unseen: element('unseen', HTMLElement),
  certificate: element('certificate', HTMLElement),
  figures: element('figures', HTMLTableElement),
};

/** @type {() => void} */
let keep = () => {};
page.keep.addEventListener('click', () => keep());

let shownVersion = 0; // of the asset in the preview
/** @type {Promise<void>} */
let queue = Promise.resolve(); // one version after the other, so that an older one never replaces a newer one

/**
 * Shows a version that a job has published, once those before it are shown.
 * @param {Job} job
 * @param {PublishedVersion} published
 */
export function showResult(job, published) {
  showGrade(job, published);
  queue = queue
    .then(() => showHeld(job, published))
    .then(() => showVersion(job, published))
    .catch(showWithoutPreview);
}

/**
 * Says first how good the result is, why, and what to do; where nothing can tell, that it is ready.
 * @param {Job} job
 * @param {PublishedVersion} published
 */
function showGrade({ state: jobState }, { grade, state }) {
  const done = state === 'refined' ? t('It is ready, refined') : t('It is ready');
  const ready = jobState === 'SUCCEEDED' ? done : t('The preview is ready');
  page.ready.textContent = (grade && gradeText(grade.level)) || ready;
  page.reason.textContent = grade ? gradeReason(grade) : '';
  page.reason.hidden = !page.reason.textContent;
}

/**
 * Says that a version is held back, unless somebody has kept it, and offers to keep it once the job has ended.
 * @param {Job} job
 * @param {PublishedVersion} published
 */
async function showHeld({ asset_key: key, state }, { version, held }) {
  /** @type {AssetEntry | null} */
  const entry = held ? await getJson(`/v1/assets/${encodeURIComponent(key)}`).catch(() => null) : null;
  const waits = entry !== null && !entry.versions?.some(({ restored }) => restored === version);
  page.held.hidden = !waits;
  const isElsewhere = waits && entry.version !== version; // its page shows the version that goes on being served
  for (const part of [page.view, page.opened]) part.hidden = isElsewhere;
  if (!waits) return;
  const isFinal = FINAL.includes(state);
  const session = isFinal ? await getSession().catch(() => null) : null;
  const manages = Boolean(session?.scopes.includes('manage'));
  page.heldBack.textContent = [
    isElsewhere
      ? t('It is held back: version {version} goes on being shown.', { version: entry.version })
      : t('It is held back: no list shows it.'),
    isFinal && !manages ? t('Somebody whose access key may manage can keep it.') : '',
  ]
    .filter(Boolean)
    .join(' ');
  page.keep.hidden = !manages;
  keep = () => attempt(page.keepRefused, () => keepVersion(key, version), page.keep);
}

/**
 * Publishes what was held back.
 * @param {string} key
 * @param {number} version
 */
async function keepVersion(key, version) {
  await restoreVersion(key, version);
  page.heldBack.textContent = t('It is kept: it is published now.');
  page.keep.hidden = true;
  for (const part of [page.view, page.opened]) part.hidden = false;
}

/**
 * Shows a few points of the thing until there is a mesh. Where they cannot be drawn, nothing is shown.
 * @param {AnchorPoints} anchors
 */
export function showAnchors(anchors) {
  queue = queue.then(() => drawAnchors(anchors)).catch(hideAnchors);
}

/** Takes the points away: the job has ended, and no mesh follows. */
export function hideAnchors() {
  queue = queue.then(() => {
    if (page.made.hidden) page.result.hidden = true;
  });
}

/** @param {AnchorPoints} anchors */
async function drawAnchors(anchors) {
  if (shownVersion) return; // a reloaded page gets all events again
  const { showPoints } = await withTimeLimit(import('./preview.js'), PREVIEW_MODULES_MS);
  showStage(false);
  showPoints(page.preview, anchors);
  document.body.dataset.points = String(anchors.xyz_m.length / 3);
}

/**
 * Shows the canvas, with all that is told of a version, or with its heading alone while there is none.
 * @param {boolean} made whether there is a version
 */
function showStage(made) {
  page.result.hidden = false;
  page.pointed.hidden = made;
  page.ready.hidden = !made;
  page.reason.hidden = !made || !page.reason.textContent;
  page.made.hidden = !made;
}

/**
 * @param {Job} job
 * @param {PublishedVersion} published
 */
async function showVersion(job, published) {
  const key = job.asset_key;
  if (published.version <= shownVersion) return;
  const view = new URL(`/view/${encodeURIComponent(key)}`, location.href).href;
  showStage(true);
  page.view.href = view;
  page.link.textContent = view;
  page.qr.src = `/v1/assets/${encodeURIComponent(key)}/qr.svg`;
  // Only now: a phone that merely uploads never loads the 3D library.
  const { showPreview } = await withTimeLimit(import('./preview.js'), PREVIEW_MODULES_MS);
  /** @type {AssetEntry} */
  const entry = await (published.held
    ? getVersion(key, published.version)
    : getJson(`/v1/assets/${encodeURIComponent(key)}`));
  await showManifest(job, entry);
  await showPreview(page.preview, entry);
  page.preview.hidden = false;
  page.notDrawn.hidden = true;
  shownVersion = entry.version;
  document.body.dataset.preview = String(shownVersion);
  document.body.dataset.shown = entry.state;
}

/** Says that the preview cannot be drawn. The asset is published all the same, and the headset can show it. */
function showWithoutPreview() {
  if (shownVersion) return; // an earlier version is shown
  page.preview.hidden = true;
  page.notDrawn.hidden = false;
}

/**
 * Shows what the manifest says of the capture and of the quality. A refined version has the figures of its preview too.
 * @param {Job} job
 * @param {AssetEntry} entry
 */
async function showManifest(job, entry) {
  /** @type {Partial<Manifest>} */
  const { quality, capture } = await getJson(entry.manifest.url).catch(() => ({}));
  await loadSentences();
  showVerdicts(page.used, capture);
  showUnseenSides(page.unseen, capture);
  showCut(job, capture);
  offerMorePhotos(job, capture);
  if (!quality) return;
  /** @type {[title: string, figures: QualityFigures][]} */
  const columns = [[entry.state === 'refined' ? t('Refined') : t('Preview'), quality]];
  if (quality.preview) columns.unshift([t('Preview'), quality.preview]);
  const rows = FIGURES.filter(([key]) => columns.some(([, figures]) => typeof figures[key] === 'number'));
  page.figures.replaceChildren(
    createRow(['', ...columns.map(([title]) => title)]),
    ...rows.map(([key, label, format]) =>
      createRow([label, ...columns.map(([, figures]) => figureText(figures[key], format))]),
    ),
  );
  page.certificate.hidden = rows.length === 0;
}

/**
 * @param {unknown} value
 * @param {Format} format
 */
function figureText(value, format) {
  return typeof value === 'number' ? format(value) : '–';
}

/**
 * Creates a row of the table: a heading, then cells.
 * @param {string[]} texts
 */
function createRow([label, ...texts]) {
  const row = create('tr');
  row.append(create('th', { textContent: label }), ...texts.map((text) => create('td', { textContent: text })));
  return row;
}
