// Progress of an upload and of a job: the bar, the list of stages, the time left, and the curve of the training's loss.
import { create, element } from './dom.js';
import { t } from './texts.js';

/** @import { JobProgress } from './types.d.ts' */

/** @type {[stage: string, label: string][]} */
const STAGES = [
  ['VALIDATING', t('Checking')],
  ['ALIGNING', t('Finding where the photos were taken')], // of photos and films alone: hidden until the job is in it
  ['POINT_CLOUD', t('Gathering points')],
  ['FITTING', t('Fitting the surface')],
  ['EXTRACTING', t('Making the mesh')],
  ['TEXTURING', t('Colouring')],
  ['PACKING', t('Packing')],
  ['PUBLISHING', t('Publishing')],
];
const CURVE_POINTS = 200; // as many as the curve has pixels to show
const LEAST_ETA_S = 5; // shorter times are not worth a sentence

const page = {
  title: element('doing', HTMLElement),
  bar: element('bar', HTMLProgressElement),
  detail: element('detail', HTMLElement),
  stages: element('stages', HTMLElement),
  curve: element('curve', SVGElement),
  losses: element('losses', SVGElement),
};

/** @type {number[]} */
let lossCurve = []; // log10 of the training's loss, oldest first
/** @type {HTMLLIElement[]} */
let stageItems = [];

/** Shows the beginning of an upload. */
export function startUploadProgress() {
  page.title.textContent = t('Uploading');
  page.bar.value = 0;
}

/**
 * Shows how much of an upload is sent.
 * @param {number} fraction
 */
export function showUploadProgress(fraction) {
  page.bar.value = fraction;
  page.detail.textContent =
    fraction < 1 ? t('{percent} % sent', { percent: Math.round(fraction * 100) }) : t('Checking what was sent');
}

/**
 * Shows that an upload has lost its connection, and goes on by itself.
 * @param {number} fraction
 */
export function showUploadWaits(fraction) {
  page.detail.textContent = t('{percent} % sent. The connection is lost; it goes on by itself.', {
    percent: Math.round(fraction * 100),
  });
}

/** Shows the stages of a job that begins. */
export function startJobProgress() {
  page.bar.value = 0; // the upload has filled it
  stageItems = STAGES.map(([stage, label]) => create('li', { textContent: label, hidden: stage === 'ALIGNING' }));
  page.stages.replaceChildren(...stageItems);
}

/**
 * Shows how far a job is. The bar never goes back.
 * @param {JobProgress} progress
 */
export function showJobProgress({ stage, fraction, message = '', message_i18n: said, eta_s: eta = 0, losses }) {
  if (typeof fraction === 'number') page.bar.value = Math.max(page.bar.value, fraction);
  const current = STAGES.findIndex(([name]) => name === stage);
  page.title.textContent = current < 0 ? t('Waiting for a worker') : STAGES[current][1];
  const timeLeft =
    eta >= LEAST_ETA_S && !['s_left', 'min_left'].includes(said?.code ?? '')
      ? t('about {time} left', { time: durationText(eta) })
      : '';
  page.detail.textContent = [message, timeLeft].filter(Boolean).join(' · ');
  stageItems.forEach((item, place) => showStage(item, place - current));
  if (losses?.total) showLoss(losses.total);
}

/**
 * Shows a sentence below the progress bar.
 * @param {string} text
 */
export function showProgressNote(text) {
  page.detail.textContent = text;
}

/**
 * @param {HTMLLIElement} item
 * @param {number} distance in stages from the current one
 */
function showStage(item, distance) {
  item.dataset.is = distance < 0 ? 'past' : distance === 0 ? 'now' : 'next';
  item.ariaCurrent = distance === 0 ? 'step' : null;
  if (distance === 0) item.hidden = false;
}

/**
 * Adds a value to the curve of the training's loss.
 * @param {number} loss
 */
function showLoss(loss) {
  lossCurve.push(Math.log10(loss));
  if (lossCurve.length > CURVE_POINTS) lossCurve = lossCurve.filter((_, place) => place % 2 === 0); // the whole curve, coarser
  const [low, high] = [Math.min(...lossCurve), Math.max(...lossCurve)];
  const points = lossCurve.map((value, place) => {
    const x = (100 * place) / Math.max(1, lossCurve.length - 1);
    const y = 28 - (26 * (value - low)) / Math.max(1e-9, high - low);
    return `${x.toFixed(1)},${y.toFixed(1)}`;
  });
  page.losses.setAttribute('points', points.join(' '));
  page.curve.toggleAttribute('hidden', lossCurve.length < 3); // an SVG has no such property
}

/**
 * @param {number} seconds
 * @returns {string} "90 s", or "3 min"
 */
export function durationText(seconds) {
  return seconds < 100 ? `${Math.round(seconds)} s` : `${Math.round(seconds / 60)} min`;
}
