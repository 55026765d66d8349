// /: choose, name, send, watch, see it turn, hand it to the headset.
import { heading, mayHaveCompass, startCompass } from './compass.js';
import { guide, noteHeading } from './guidance.js';
import { showUnseen, showUsed } from './photo-verdicts.js';
import { Problem, followJob, getJson, keyFrom, postJson, uploadCapture } from '../shared/api.js';
import { isConnectionProblem } from '../shared/problems.js';
import { PREVIEW_MODULES_MS, withTimeLimit } from '../shared/time-limits.js';

const STAGES = [
  ['VALIDATING', 'Checking'],
  ['ALIGNING', 'Finding where the photos were taken'], // shown once it is heard of: other captures know
  ['POINT_CLOUD', 'Gathering points'],
  ['FITTING', 'Fitting the surface'],
  ['EXTRACTING', 'Making the mesh'],
  ['TEXTURING', 'Colouring'],
  ['PACKING', 'Packing'],
  ['PUBLISHING', 'Publishing'],
];
const TERMINAL = ['SUCCEEDED', 'FAILED', 'CANCELLED'];
const ofSize = (share) => `${(100 * share).toFixed(2)} % of its size`;
const percent = (share) => `${(100 * share).toFixed(1)} %`;
const count = (number) => Math.round(number).toLocaleString('en');
// Of a manifest's certificate, what people can read; an older worker's may lack some.
const FIGURES = [
  ['held_out_mean', 'From points it was not shown', ofSize],
  ['points_to_mesh_median', 'From the scanned points', ofSize],
  ['coverage', 'Points covered', percent],
  ['components', 'Pieces', count],
  ['boundary_loops', 'Open borders', count],
  ['non_manifold_edges', 'Edges of more than two sides', count],
  ['triangles', 'Triangles', count],
  ['steps', 'Steps of training', count],
  ['seconds', 'Computed in', (seconds) => duration(seconds)],
];
const CURVE_POINTS = 200; // as many as its figure has pixels to show
const LISTED = 6; // files named before "and N more"

const at = (id) => document.getElementById(id);
const page = document.body;
page.dataset.started = 'yes';
let files = [];
let compass = false; // whether the person lets the page ask the phone where its camera looks
let job = '';
let turning = 0; // version of the asset in the preview
let curve = []; // log10 of the training's loss, oldest first
let looking = Promise.resolve(); // looks at the job, and then previews, one after the other: an older answer never comes last
let showing = Promise.resolve();
let receipt = null; // of the upload: trying again does not send it twice
const orderKey = randomKey(); // nor does it make a second job

// ---- choosing -------------------------------------------------------------------------------------------------------

for (const id of ['files', 'photos', 'film', 'folder']) {
  at(id).addEventListener('change', async ({ target }) => {
    const chosen = [...target.files];
    if (chosen.length === 0) return;
    target.value = ''; // the same file can be chosen again once it was removed
    if (id === 'photos' && compass && chosen.length === 1) noteHeading(chosen[0], await heading());
    const adds = id === 'photos' || id === 'film';
    files = adds ? [...files, ...chosen] : chosen;
    showChosen();
  });
}

at('compass').hidden = !mayHaveCompass();
at('compass').addEventListener('click', async () => {
  compass = await startCompass();
  at('compass').disabled = compass;
  at('compass').textContent = compass ? 'The compass is used' : 'There is no compass; try again';
});

function showChosen() {
  const bytes = files.reduce((sum, file) => sum + file.size, 0);
  const what = files.length === 1 ? '1 file' : `${files.length} files`;
  at('chosen').textContent = files.length ? `${what}, ${(bytes / 1e6).toFixed(1)} MB` : 'Nothing chosen yet.';
  at('list').hidden = guide(files, (gone) => {
    files = files.filter((file) => !gone.includes(file));
    showChosen();
  });
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

/** What the workers offer; without an answer the automatic choice is all there is. */
async function offerPresets() {
  const { presets, default: first } = await getJson('/v1/presets').catch(() => ({ presets: [], default: '' }));
  const named = presets.filter(({ name, summary }) => name !== first && !summary.startsWith('baseline'));
  const auto = presets.find(({ name }) => name === first);
  if (auto) at('preset').options[0].textContent = `Automatic: ${auto.summary || auto.name}`;
  at('preset').append(...named.map(({ name, summary }) => new Option(summary ? `${name}: ${summary}` : name, name)));
}
offerPresets();

// ---- sending --------------------------------------------------------------------------------------------------------

at('form').addEventListener('submit', async (event) => {
  event.preventDefault();
  const name = at('name').value.trim();
  show('sending');
  at('doing').textContent = 'Uploading';
  try {
    receipt ??= await uploadCapture(files, name, (fraction) => {
      at('bar').value = fraction;
      at('detail').textContent = fraction < 1 ? `${Math.round(fraction * 100)} % sent` : 'Checking what was sent';
    });
    showReceipt(receipt);
    const made = await postJson('/v1/jobs', orderOf(receipt, name), { 'Idempotency-Key': orderKey });
    location.hash = `job=${made.id}`;
    watch(made);
  } catch (problem) {
    trouble(problem);
  }
});

function orderOf(capture, name) {
  const [isolate, centimetres] = [at('isolate').value, at('longest').valueAsNumber];
  return {
    capture: capture.capture,
    asset_key: keyFrom(name),
    label: name,
    preset: at('preset').value,
    isolate: isolate ? isolate === 'true' : null,
    longest_m: centimetres > 0 ? centimetres / 100 : null,
  };
}

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
  at('bar').value = 0; // the upload has filled it
  show('working');
  fill(at('stages'), STAGES.map(([, label]) => label));
  STAGES.forEach(([name], place) => { at('stages').children[place].hidden = name === 'ALIGNING'; });
  apply(made);
  if (TERMINAL.includes(made.state)) return;
  const stop = followJob(job, (type, data) => {
    showLost(type === 'lost');
    if (type === 'lost') return;
    if (type === 'progress') {
      showProgress(data);
      showLosses(data.losses);
    } else {
      looking = looking.then(look);
    }
  });

  async function look() {
    if (TERMINAL.includes(page.dataset.job)) return;
    const now = await getJson(`/v1/jobs/${job}`).catch(() => null); // offline: asked again once the stream is open again
    if (now) apply(now);
    if (now && TERMINAL.includes(now.state)) stop();
  }
}

/** The job goes on without this page, which tries by itself to follow it again; the button loads the page anew. */
function showLost(yes) {
  at('lost').hidden = !yes;
}

/** The whole of a job, as told by GET. */
function apply(now) {
  page.dataset.job = now.state;
  showProgress(now);
  at('cancel').hidden = TERMINAL.includes(now.state) || now.state === 'CANCELLING';
  const published = now.asset || now.preview;
  if (published) showing = showing.then(() => showResult(now, published)).catch(undrawn);
  if (now.state === 'FAILED') trouble(new Problem(now.error || {}));
  at('coming').hidden = TERMINAL.includes(now.state) || Boolean(now.asset);
  if (now.state === 'CANCELLED') trouble(new Problem({ code: 'CANCELLED', detail: 'The job was cancelled.', hints: now.preview ? ['Its preview stays.'] : [] }));
  if (now.state === 'SUCCEEDED') {
    at('work').hidden = true;
    at('ready').textContent = now.asset.state === 'refined' ? 'It is ready, refined' : 'It is ready';
    fill(at('warnings'), now.warnings);
    page.dataset.state = 'done';
  }
}

function showProgress({ stage, fraction, message, eta_s: eta }) {
  if (typeof fraction === 'number') at('bar').value = Math.max(at('bar').value, fraction);
  const index = STAGES.findIndex(([name]) => name === stage);
  at('doing').textContent = index < 0 ? 'Waiting for a worker' : STAGES[index][1];
  const left = eta >= 5 && !message?.endsWith(' left') ? `about ${duration(eta)} left` : '';
  at('detail').textContent = [message, left].filter(Boolean).join(' · ');
  [...at('stages').children].forEach((item, place) => {
    item.dataset.is = place < index ? 'past' : place === index ? 'now' : 'next';
    item.ariaCurrent = place === index ? 'step' : null;
    if (place === index) item.hidden = false;
  });
}

/** A training's loss over its steps: falling is good. */
function showLosses(losses) {
  if (!losses?.total) return;
  curve.push(Math.log10(losses.total));
  if (curve.length > CURVE_POINTS) curve = curve.filter((_, place) => place % 2 === 0); // the whole course, coarser
  const [low, high] = [Math.min(...curve), Math.max(...curve)];
  const across = (place) => (100 * place) / Math.max(1, curve.length - 1);
  const down = (value) => 28 - (26 * (value - low)) / Math.max(1e-9, high - low);
  at('losses').setAttribute('points', curve.map((value, place) => `${across(place).toFixed(1)},${down(value).toFixed(1)}`).join(' '));
  at('curve').toggleAttribute('hidden', curve.length < 3); // an SVG has no such property
}

function duration(seconds) {
  return seconds < 100 ? `${Math.round(seconds)} s` : `${Math.round(seconds / 60)} min`;
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
  const { turn } = await withTimeLimit(import('./preview.js'), PREVIEW_MODULES_MS);
  const entry = await getJson(`/v1/assets/${encodeURIComponent(now.asset_key)}`);
  await showCertificate(entry);
  await turn(at('preview'), entry);
  at('preview').hidden = false;
  at('undrawn').hidden = true;
  turning = entry.version;
  page.dataset.preview = turning;
  page.dataset.shown = entry.state;
}

/** The figures of the version on show and, in a refined one's manifest, those of the preview that it replaced. */
async function showCertificate(entry) {
  const { quality, capture } = await getJson(entry.manifest.url).catch(() => ({}));
  showUsed(at('used'), capture);
  showUnseen(at('unseen'), capture);
  if (!quality) return;
  const columns = [quality.preview && ['Preview', quality.preview], [entry.state === 'refined' ? 'Refined' : 'Preview', quality]].filter(Boolean);
  const rows = FIGURES.filter(([key]) => columns.some(([, figures]) => typeof figures[key] === 'number'));
  const told = rows.map(([key, label, said]) => [label, ...columns.map(([, figures]) => (typeof figures[key] === 'number' ? said(figures[key]) : '–'))]);
  at('figures').replaceChildren(row(['', ...columns.map(([name]) => name)]), ...told.map(row));
  at('certificate').hidden = rows.length === 0;
}

function row([label, ...cells]) {
  const made = document.createElement('tr');
  made.append(cell('th', label), ...cells.map((text) => cell('td', text)));
  return made;
}

function cell(kind, text) {
  const made = document.createElement(kind);
  made.textContent = text;
  return made;
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
  at('retry').hidden = !isConnectionProblem(problem);
  show('trouble');
}

at('retry').addEventListener('click', () => (location.hash ? location.reload() : at('form').requestSubmit()));
at('reload').addEventListener('click', () => location.reload());

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
