// /: choose, name, send, watch, see it turn, hand it to the headset.
import { Problem, followJob, getJson, keyFrom, postJson, uploadCapture } from './api.js';

const STAGES = [
  ['VALIDATING', 'Checking'],
  ['POINT_CLOUD', 'Gathering points'],
  ['FITTING', 'Fitting the surface'],
  ['EXTRACTING', 'Making the mesh'],
  ['TEXTURING', 'Colouring'],
  ['PACKING', 'Packing'],
  ['PUBLISHING', 'Publishing'],
];
const TERMINAL = ['SUCCEEDED', 'FAILED', 'CANCELLED'];
const LISTED = 6; // files named before "and N more"

const at = (id) => document.getElementById(id);
const page = document.body;
let files = [];
let job = '';
let turning = 0; // version of the asset in the preview
let looking = Promise.resolve(); // looks at the job, and then previews, one after the other: an older answer never comes last
let showing = Promise.resolve();

// ---- choosing -------------------------------------------------------------------------------------------------------

for (const id of ['files', 'photos', 'folder']) {
  at(id).addEventListener('change', (event) => {
    files = id === 'photos' ? [...files, ...event.target.files] : [...event.target.files];
    showChosen();
  });
}

function showChosen() {
  const bytes = files.reduce((sum, file) => sum + file.size, 0);
  const what = files.length === 1 ? '1 file' : `${files.length} files`;
  at('chosen').textContent = files.length ? `${what}, ${(bytes / 1e6).toFixed(1)} MB` : 'Nothing chosen yet.';
  const names = files.slice(0, LISTED).map((file) => file.webkitRelativePath || file.name);
  if (files.length > LISTED) names.push(`… and ${files.length - LISTED} more`);
  fill(at('list'), names);
  if (!at('name').value && files.length) at('name').value = nameOf(files[0]);
  showKey();
}

function nameOf(file) {
  const path = (file.webkitRelativePath || file.name).split('/');
  return (path.length > 1 ? path[0] : path[0].replace(/\.[^.]+$/, '')).replace(/[_-]+/g, ' ');
}

function showKey() {
  const key = keyFrom(at('name').value);
  at('key').textContent = key || '…';
  at('send').disabled = !(key && files.length);
}

at('name').addEventListener('input', showKey);

// ---- sending --------------------------------------------------------------------------------------------------------

at('form').addEventListener('submit', async (event) => {
  event.preventDefault();
  const name = at('name').value.trim();
  show('sending');
  at('doing').textContent = 'Uploading';
  try {
    const capture = await uploadCapture(files, name, (fraction) => {
      at('bar').value = fraction;
      at('detail').textContent = fraction < 1 ? `${Math.round(fraction * 100)} % sent` : 'Checking what was sent';
    });
    showReceipt(capture);
    const request = { capture: capture.capture, asset_key: keyFrom(name), label: name, isolate: at('isolate').checked };
    const made = await postJson('/v1/jobs', request, { 'Idempotency-Key': randomKey() });
    location.hash = `job=${made.id}`;
    watch(made);
  } catch (problem) {
    trouble(problem);
  }
});

/** crypto.randomUUID exists in secure contexts only, and a phone may come over plain HTTP in the home network. */
function randomKey() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

function showReceipt(capture) {
  const lines = (capture.files || []).filter((file) => file.stripped?.length);
  at('receipt').hidden = lines.length === 0;
  fill(at('stripped'), lines.map((file) => `${file.file}: ${file.stripped.join(', ')}`));
}

// ---- watching -------------------------------------------------------------------------------------------------------

function watch(made) {
  job = made.id;
  show('working');
  fill(at('stages'), STAGES.map(([, label]) => label));
  apply(made);
  if (TERMINAL.includes(made.state)) return;
  const stop = followJob(job, (type, data) => {
    if (type === 'progress') return showProgress(data);
    looking = looking.then(look);
  });

  async function look() {
    if (TERMINAL.includes(page.dataset.job)) return;
    const now = await getJson(`/v1/jobs/${job}`).catch(() => null); // offline: asked again once the stream is open again
    if (now) apply(now);
    if (now && TERMINAL.includes(now.state)) stop();
  }
}

/** The whole of a job, as told by GET. */
function apply(now) {
  page.dataset.job = now.state;
  showProgress(now);
  at('cancel').hidden = TERMINAL.includes(now.state) || now.state === 'CANCELLING';
  const published = now.asset || now.preview;
  if (published) showing = showing.then(() => showResult(now, published)).catch(undrawn);
  if (now.state === 'FAILED') trouble(new Problem(now.error || {}));
  if (now.state === 'CANCELLED') trouble(new Problem({ code: 'CANCELLED', detail: 'The job was cancelled.' }));
  if (now.state === 'SUCCEEDED') {
    at('work').hidden = true;
    at('ready').textContent = 'It is ready';
    page.dataset.state = 'done';
  }
}

function showProgress({ stage, fraction, message }) {
  if (typeof fraction === 'number') at('bar').value = Math.max(at('bar').value, fraction);
  const index = STAGES.findIndex(([name]) => name === stage);
  at('doing').textContent = index < 0 ? 'Waiting for a worker' : STAGES[index][1];
  at('detail').textContent = message || '';
  [...at('stages').children].forEach((item, place) => {
    item.dataset.is = place < index ? 'past' : place === index ? 'now' : 'next';
    item.ariaCurrent = place === index ? 'step' : null;
  });
}

at('cancel').addEventListener('click', async () => {
  at('cancel').disabled = true;
  try {
    await postJson(`/v1/jobs/${job}/cancel`, {});
  } catch (problem) {
    at('detail').textContent = problem.message; // the job goes on, and so does the watching
  }
  at('cancel').disabled = false;
});

// ---- the result -----------------------------------------------------------------------------------------------------

async function showResult(now, published) {
  if (published.version <= turning) return;
  const view = new URL(`/view/${encodeURIComponent(now.asset_key)}`, location.href).href;
  at('result').hidden = false;
  at('view').href = view;
  at('link').textContent = view;
  at('qr').src = `/v1/assets/${encodeURIComponent(now.asset_key)}/qr.svg`;
  // Only now: a phone that merely uploads never loads the 3D library.
  const { turn } = await import('./turntable.js');
  const entry = await getJson(`/v1/assets/${encodeURIComponent(now.asset_key)}`);
  await turn(at('preview'), entry);
  at('preview').hidden = false;
  at('undrawn').hidden = true;
  turning = entry.version;
  page.dataset.preview = turning;
}

/** The asset stands on the store all the same, and the headset can show it. */
function undrawn() {
  if (turning) return; // an earlier version is on show
  at('preview').hidden = true;
  at('undrawn').hidden = false;
}

// ---- trouble --------------------------------------------------------------------------------------------------------

function trouble(problem) {
  page.dataset.code = problem.code || 'UNKNOWN';
  const reason = problem.file && !problem.message.includes(problem.file) ? `${problem.file}: ${problem.message}` : problem.message;
  at('reason').textContent = reason;
  fill(at('hints'), problem.hints || []);
  show('trouble');
}

for (const id of ['again', 'another']) {
  at(id).addEventListener('click', () => {
    location.hash = '';
    location.reload();
  });
}

// Nothing remembers an upload that is left half-way.
window.addEventListener('beforeunload', (event) => page.dataset.state === 'sending' && event.preventDefault());

function show(state) {
  page.dataset.state = state;
  at('form').hidden = state !== 'choosing';
  at('work').hidden = !['sending', 'working'].includes(state);
  at('trouble').hidden = state !== 'trouble';
  if (state === 'sending') at('bar').value = 0;
  at('cancel').hidden = state === 'sending';
}

function fill(list, lines) {
  list.replaceChildren(
    ...lines.map((line) => {
      const item = document.createElement('li');
      item.textContent = line;
      return item;
    }),
  );
}

// A page that was reloaded, or opened again from the phone's history, goes on watching its job.
const known = new URLSearchParams(location.hash.slice(1)).get('job');
if (known) getJson(`/v1/jobs/${encodeURIComponent(known)}`).then(watch, trouble);
