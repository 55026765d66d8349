// The capture page (/): choose files, name the object, upload, watch the job, see the result.
import { continuedJob, startContinuing } from './continuing.js';
import { openDraft, resumeDraft } from './drafts.js';
import { chosenFiles, chosenName, hasUnkept, startFileChoice } from './file-choice.js';
import { showUploadProgress, showUploadWaits, startUploadProgress } from '../shared/job-progress.js';
import { watchJob } from './job-watch.js';
import { jobKey, keepAsDraft, keepWhole, sendOnce } from './keeping.js';
import { startKeptList } from './kept-list.js';
import { showState, showTrouble } from './page-state.js';
import { chosenBox } from './photo-box.js';
import { sendCapture, unfinishedFiles } from './resumable-upload.js';
import { showAccount } from '../shared/account.js';
import { getJson, keyFrom, postJson } from '../shared/api.js';
import { element, fillList } from '../shared/dom.js';
import { isConnectionProblem, offline } from '../shared/problems.js';
import { registerServiceWorker } from '../shared/register-service-worker.js';
import { joinWords, splitWords } from '../shared/search-words.js';
import { t } from '../shared/texts.js';

/** @import { JobOrder, KeptCapture } from '../shared/kept-captures.js' */
/** @import { CaptureReceipt, Cut, Job, JobRequest, Presets, Visibility } from '../shared/types.d.ts' */

document.body.dataset.started = 'yes';
const NEW_JOB = '/v1/jobs';
const page = {
  form: element('form', HTMLFormElement),
  preset: element('preset', HTMLSelectElement),
  description: element('description', HTMLTextAreaElement),
  words: element('words', HTMLInputElement),
  collection: element('collection', HTMLInputElement),
  target: element('target', HTMLSelectElement),
  cut: element('cut', HTMLSelectElement),
  fill: element('fill', HTMLSelectElement),
  longest: element('longest', HTMLInputElement),
  sharing: element('sharing', HTMLElement),
  visibility: element('visibility', HTMLSelectElement),
  cancel: element('cancel', HTMLButtonElement),
  receipt: element('receipt', HTMLElement),
  stripped: element('stripped', HTMLElement),
  unfinished: element('unfinished', HTMLElement),
};
/** @type {{ receipt: CaptureReceipt, files: File[], about: string } | null} */
let upload = null; // what the server has, and of which files
let isKept = false; // on the device, to be sent later

/** Fills the list of presets with what the workers offer. Without an answer only the automatic choice is there. */
async function offerPresets() {
  /** @type {Presets} */
  const { presets, default: automatic } = await getJson('/v1/presets').catch(() => ({ presets: [], default: '' }));
  const others = presets.filter(({ name }) => name !== automatic);
  const first = presets.find(({ name }) => name === automatic);
  if (first) page.preset.options[0].textContent = t('Automatic: {preset}', { preset: first.summary || first.name });
  page.preset.append(...others.filter((each) => !each.literature).map(presetOption));
  const literature = others.filter((each) => each.literature);
  if (!literature.length) return;
  const group = document.createElement('optgroup');
  group.label = t('Methods from the literature');
  group.append(...literature.map(presetOption));
  page.preset.append(group);
}

/** The choice of a preset, with what it does and the time that it takes. @param {Presets['presets'][number]} preset */
function presetOption({ name, summary, takes }) {
  const words = [summary, takes && t('takes {time}', { time: takes })].filter(Boolean).join('; ');
  return new Option(words ? `${name}: ${words}` : name, name);
}

/** Uploads the chosen files, starts a job with them, and watches it. What finds no server is kept on the device. */
async function send() {
  showState('sending');
  page.cancel.hidden = true;
  startUploadProgress();
  try {
    await (continuing = continuing.catch(startContinuing)); // who is quick would make a new thing instead of adding to that one
    showState('sending'); // it was trouble where the first question for that thing was lost
  } catch (error) {
    showTrouble(error);
    return;
  }
  try {
    const sent = await sendOnce(sendNow);
    const job = typeof sent === 'string' ? await getJson(`/v1/jobs/${sent}`) : sent;
    location.hash = `job=${job.id}`;
    watchJob(job);
  } catch (error) {
    showTrouble(error, isConnectionProblem(error) ? { more: await keepForLater() } : { canChange: true });
  }
}

/** Returns to the form, with all that was to be sent. */
async function change() {
  isKept = false;
  await keepAsDraft();
  showState('choosing');
}

/** Whether the fields can be sent; shows the first that cannot. What is hidden is not sent. */
function checkFields() {
  page.collection.value = page.collection.value.trim(); // phones' keyboards add a space
  const wrong = page.form.querySelector('input:invalid:not([hidden] *)');
  if (!(wrong instanceof HTMLInputElement)) return true;
  const folded = wrong.closest('details');
  if (folded) folded.open = true;
  return wrong.reportValidity();
}

/** @returns {Promise<Job>} */
async function sendNow() {
  const name = chosenName();
  if (!navigator.onLine) throw offline();
  const progress = { onProgress: showUploadProgress, onWaiting: showUploadWaits };
  const receipt = knownReceipt() ?? (await sendCapture(chosenFiles(), name, about(), progress));
  upload = { receipt, files: chosenFiles(), about: JSON.stringify(about()) };
  showReceipt(receipt);
  const { path, body } = jobOrder(name);
  return postJson(path, { ...body, capture: receipt.capture }, { 'Idempotency-Key': jobKey() });
}

/** What the server has said of the chosen files, where it has them: they are not sent twice. */
function knownReceipt() {
  return upload?.files === chosenFiles() && upload.about === JSON.stringify(about()) ? upload.receipt : null;
}

/** What the upload says of its capture. */
const about = () => ({ box: chosenBox(chosenFiles()), continues: continuedJob()?.capture ?? '' });

/**
 * The job to start: of a new thing, or again with more photos.
 * @param {string} name
 * @returns {JobOrder}
 */
function jobOrder(name) {
  const earlier = continuedJob();
  return earlier ? { path: earlier.links.again, body: {} } : { path: NEW_JOB, body: jobRequest(name) };
}

/** Keeps the capture on the device. @returns {Promise<string>} what to tell the person */
async function keepForLater() {
  const name = chosenName();
  const trouble = await keepWhole(chosenFiles(), {
    name,
    about: about(),
    order: jobOrder(name),
    capture: knownReceipt()?.capture ?? '',
  });
  isKept = !trouble;
  return (
    trouble ||
    t(
      'It is kept on this device, and sent when the server can be reached: by itself, or when you open this page again.',
    )
  );
}

/**
 * @param {string} name
 * @returns {Omit<JobRequest, 'capture'>}
 */
function jobRequest(name) {
  const centimetres = page.longest.valueAsNumber;
  return {
    asset_key: keyFrom(name),
    label: name,
    description: page.description.value,
    labels: splitWords(page.words.value),
    collection: page.collection.value.trim(),
    target: page.target.value,
    preset: page.preset.value,
    cut: /** @type {Cut} */ (page.cut.value),
    longest_m: centimetres > 0 ? centimetres / 100 : null,
    fill: page.fill.value,
    box: chosenBox(chosenFiles()),
    visibility: /** @type {Visibility | ''} */ (page.visibility.value),
  };
}

/**
 * Fills the fields as they were when a capture was sent.
 * @param {KeptCapture} [capture] one that was never sent, or added to a thing, has no fields
 */
async function showFields(capture) {
  if (capture?.order?.path !== NEW_JOB) return;
  await offering; // the preset is among what is offered
  const request = /** @type {Omit<JobRequest, 'capture'>} */ (/** @type {unknown} */ (capture.order.body));
  page.words.value = joinWords(request.labels);
  page.longest.value = request.longest_m ? String(Number((100 * request.longest_m).toFixed(6))) : '';
  for (const name of /** @type {const} */ ([
    'description',
    'collection',
    'target',
    'preset',
    'cut',
    'fill',
    'visibility',
  ])) {
    page[name].value = request[name];
  }
}

/**
 * Lists which files the server has left out, and which metadata it has removed from the others.
 * @param {CaptureReceipt} receipt
 */
function showReceipt({ files = [] }) {
  const lines = files
    .map(({ file, verdict, stripped = [] }) => [file, verdict === 'ok' ? stripped.join(', ') : verdict])
    .filter(([, what]) => what)
    .map(([file, what]) => `${file}: ${what}`);
  page.receipt.hidden = lines.length === 0;
  fillList(page.stripped, lines);
}

/** Goes on watching the job of the address, after a reload or when the page is opened again from the phone's history. */
function resumeJob() {
  const id = new URLSearchParams(location.hash.slice(1)).get('job');
  if (id) getJson(`/v1/jobs/${encodeURIComponent(id)}`).then(watchJob, showTrouble);
}

/** Tells whose upload has stopped: pages cannot open a person's files by themselves. */
function offerToGoOn() {
  const names = unfinishedFiles();
  page.unfinished.hidden = names.length === 0;
  page.unfinished.textContent = t(
    'The upload of {files} has stopped on its way. Choose the same files again, and it goes on.',
    { files: names.join(', ') },
  );
}

/** Tries again after a lost connection: to watch the job, or to send the files. */
function retry() {
  if (location.hash.startsWith('#job=')) location.reload();
  else page.form.requestSubmit();
}

/** Starts again with an empty form. */
function restart() {
  location.hash = '';
  location.reload();
}

page.form.addEventListener('submit', (event) => {
  event.preventDefault();
  if (checkFields()) send();
});
element('change', HTMLButtonElement).addEventListener('click', change);
element('retry', HTMLButtonElement).addEventListener('click', retry);
element('reload', HTMLButtonElement).addEventListener('click', () => location.reload());
for (const id of ['again', 'another']) element(id, HTMLButtonElement).addEventListener('click', restart);
// An upload that is interrupted waits for the same files, and what could not be kept is lost: the browser asks before it leaves the page.
window.addEventListener('beforeunload', (event) => {
  const { state } = document.body.dataset;
  if (state === 'sending' || (hasUnkept() && (state === 'choosing' || state === 'trouble'))) event.preventDefault();
});
window.addEventListener('online', () => {
  if (isKept && document.body.dataset.state === 'trouble') send();
});
startFileChoice();
const offering = offerPresets();
offerToGoOn();
resumeJob();
let continuing = startContinuing(); // the thing that photos are added to is known
continuing.catch(showTrouble).then(resumeDraft).then(showFields);
startKeptList((draft) => openDraft(draft).then(showFields));
registerServiceWorker();
showAccount().then((session) => (page.sharing.hidden = session?.via !== 'session')); // without keys everybody sees everything
