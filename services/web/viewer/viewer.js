// /view/{key} and /view?key=a&key=b: things on a screen or in a headset, side by side where there are several.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { getCachedJson } from '../shared/api.js';
import { makeArranger } from './drag.js';
import { checked } from '../shared/signed-catalogue.js';
import { drawing } from './render-loop.js';
import { makeGrasp } from './grab.js';
import { makeHands } from './xr-input.js';
import { offerSessions } from './xr-session.js';
import { isConnectionProblem } from '../shared/problems.js';
import { registerServiceWorker } from '../shared/register-service-worker.js';
import { loadFile } from '../shared/verified-cache.js';
import { Piece } from './scene-item.js';
import { sideBySide } from './layout-and-lod.js';
import { breath, prepare } from '../graphics/gpu-warmup.js';
import { frame, hintsOf, makeStage } from '../graphics/scene.js';
import { caption, notice, showQuickLook, showThings, tell } from '../shared/messages.js';

const POLL_MS = 3000; // while a refined version may come
const CALM_MS = 15_000; // once everything is refined
const LEAST_MS = 1000; // between two questions, however many things there are
const MOST = 24; // things in one scene
const MOVE_HELP = matchMedia('(hover: hover)').matches
  ? 'Drag a thing to move it, with Shift to lift it. Scroll on it to scale it, drag with the right button to turn it. Keys: arrows, page up and down, comma, point, plus, minus.'
  : 'Drag a thing to move it. Two fingers scale and turn it.';

const page = document.body;
page.dataset.started = 'yes';
const at = (id) => document.getElementById(id);
await breath(); // reading the modules was one task, which needs no longer one behind it
const stage = stageOrReason(at('stage'));
await breath();
const { renderer, scene, camera } = stage;
const root = new THREE.Group(); // what moves in front of the wearer: all things and the floor under them
scene.add(root);
const controls = new OrbitControls(camera, renderer.domElement);
controls.enableDamping = true;
controls.listenToKeyEvents(renderer.domElement);

let pieces = keysOf(location).map((key) => new Piece(key));
for (const { group } of pieces) root.add(group);
const present = () => pieces.filter((piece) => piece.entry);

function keysOf({ pathname, search }) {
  const named = pathname.split('/')[2];
  const keys = named ? [decodeURIComponent(named)] : new URLSearchParams(search).getAll('key');
  return [...new Set(keys)].slice(0, MOST);
}

function stageOrReason(canvas) {
  try {
    return makeStage(canvas);
  } catch (error) {
    tell({ code: 'NO_WEBGL', message: 'This browser cannot show 3D.', hints: ['Open this address in another one.'] });
    throw error;
  }
}

// ---- what is shown ----------------------------------------------------------------------------------------------------

/** Fetch the entry; when its version is new, load it beside the old one and swap. */
async function refresh(piece) {
  const told = await getCachedJson(`/v1/assets/${encodeURIComponent(piece.key)}`);
  const before = piece.entry;
  if (before && before.version === told.version) return;
  const entry = await checked(told);
  if (!before) showHints(piece, entry);
  await piece.show(entry, renderer, { prepare: (group) => prepare(stage, group), onChange: redraw });
  if (!pieces.includes(piece)) return piece.remove(); // it was taken away meanwhile
  if (!before) arrived();
  else notice(newer(before, piece));
  describe();
}

function newer(before, { name, entry }) {
  const refined = before.state === 'preview' && entry.state === 'refined';
  return `${refined ? 'The refined version' : 'A new version'} of ${name} took its place: version ${entry.version}.`;
}

async function showHints(piece, entry) {
  const manifest = await loadManifest(entry).catch(() => ({}));
  const points = piece.entry || !pieces.includes(piece) ? null : hintsOf(manifest, entry.size_m);
  if (!points) return;
  piece.showHints(points);
  redraw();
  page.dataset.hints = manifest.anchors.xyz_m.length / 3;
  if (present().length === 0) controls.target.copy(frame(camera, entry.size_m));
}

async function loadManifest({ manifest: { url, sha256 } }) {
  return JSON.parse(new TextDecoder().decode(await loadFile({ url, sha256, file: 'manifest.json' })));
}

/** One more thing is there: all stand side by side, or where people put them, and all of them are in view. */
function arrived() {
  const places = sideBySide(present().map((piece) => piece.entry.size_m));
  present().forEach((piece, place) => {
    piece.home.set(places[place][0], 0, places[place][1]);
    if (grasp.handsOn(piece) === 0) piece.place();
  });
  moved();
  look();
}

function look() {
  if (renderer.xr.isPresenting || present().length === 0) return;
  const whole = new THREE.Box3();
  for (const piece of present()) whole.union(piece.box.applyMatrix4(piece.group.matrixWorld));
  const [size, middle] = [whole.getSize(new THREE.Vector3()), whole.getCenter(new THREE.Vector3())];
  controls.target.copy(frame(camera, size.toArray(), middle));
}

function describe() {
  redraw();
  caption(present(), pieces.length, pieces.filter(hasFailed).length);
  showThings(pieces, { chosen, onChoose: (piece) => moving(true, piece), onRemove: remove });
  showQuickLook(pieces.length === 1 ? present()[0]?.entry : null);
  const [first] = present();
  if (first) at('collection').href = `/browse/${encodeURIComponent(first.entry.collections?.[0] || 'default')}`;
}

/** Take a thing out of the scene, and out of the page's address. */
function remove(piece) {
  grasp.letGoOf(piece);
  pieces = pieces.filter((each) => each !== piece);
  piece.remove();
  if (pieces.length === 0) return;
  history.replaceState(null, '', `/view?${new URLSearchParams(pieces.map(({ key }) => ['key', key]))}`);
  arrived();
  describe();
}

function reset() {
  for (const piece of present()) {
    grasp.letGoOf(piece);
    piece.reset();
  }
  look();
  moved();
}

// ---- moving -----------------------------------------------------------------------------------------------------------

let chosen = null;
const arranger = makeArranger({ camera, canvas: renderer.domElement }, { pieces: present, onMoved: left, onChosen: choose });
const grasp = makeGrasp(left);
const hands = makeHands(renderer, scene, { pieces: present, grasp, onReset: reset, ownHands: () => page.dataset.mode === 'vr' });

function left(piece) {
  piece.leave();
  headset.understood();
  moved();
}

/** Where things stand, for who looks at the page from outside. */
function moved() {
  const short = (numbers) => numbers.map((value) => value.toFixed(3)).join(' ');
  redraw();
  page.dataset.moved = present().map(({ group }) => `${short(group.position.toArray())} ${group.scale.x.toFixed(3)}`).join('; ');
}

function choose(piece) {
  chosen = piece;
  describe();
}

function moving(yes, piece = null) {
  at('move').setAttribute('aria-pressed', yes);
  arranger.on(yes);
  if (piece) arranger.choose(piece);
  notice(yes ? MOVE_HELP : '', { stays: true });
}

at('move').addEventListener('click', () => moving(at('move').getAttribute('aria-pressed') !== 'true'));
at('reset').addEventListener('click', reset);

// ---- the headset, and each frame --------------------------------------------------------------------------------------

const headset = offerSessions({ renderer, scene, root }, { vr: at('enter-vr'), ar: at('enter-ar') }, {
  height: () => Math.max(0, ...present().map((piece) => piece.entry.size_m[1])),
  onMode(mode) {
    page.dataset.xr = mode ? 'on' : 'off';
    page.dataset.mode = mode;
    hands.letGo();
    look(); // the camera was left where the headset was
    redraw();
  },
  onPlaced: (metres) => (page.dataset.placed = metres.map((value) => value.toFixed(3)).join(' ')),
  onRefused: (error) => tell({ code: 'XR_REFUSED', message: `The headset did not start: ${error.message}` }),
});

const { redraw } = drawing(stage, { present, controls, onHeadset: hands.tick, onDrawn: headset.tick });

// ---- what is new ------------------------------------------------------------------------------------------------------

async function follow() {
  await Promise.all(pieces.map(attempt));
  for (let turn = 0; pieces.length > 0; turn++) {
    const mayChange = pieces.some(({ entry }) => entry?.state !== 'refined');
    const pause = Math.max(LEAST_MS, (mayChange ? POLL_MS : CALM_MS) / pieces.length);
    await new Promise((resolve) => setTimeout(resolve, pause));
    if (!document.hidden || renderer.xr.isPresenting) await attempt(pieces[turn % pieces.length]);
  }
}

const attempts = new Map(); // piece → its attempt that has not ended: a second one would load the same files again

function attempt(piece) {
  if (!attempts.has(piece)) {
    const ended = refresh(piece).catch((problem) => failed(piece, problem)).finally(() => attempts.delete(piece));
    attempts.set(piece, ended);
  }
  return attempts.get(piece);
}

/** Once something stands there, a lost connection is no reason to take it away; that its owner took it back is one. */
function failed(piece, problem) {
  const news = problem.message !== piece.problem;
  piece.problem = problem.message;
  piece.code = problem.code || 'UNKNOWN';
  if (problem.code === 'ASSET_REMOVED' && piece.entry) {
    remove(piece);
    notice(`${piece.name} was taken back by whoever published it.`, { stays: true });
  } else if (news && !isConnectionProblem(problem) && pieces.length > 1) {
    notice(`${piece.name}: ${problem.message}`);
  }
  if (present().length === 0) tell(problem, { again: true });
  else if (!piece.entry) describe();
}

/** Whether a thing is missing for a reason that trying again may mend; one that is not published yet is on its way. */
const hasFailed = ({ entry, code }) => !entry && Boolean(code) && !['ASSET_UNKNOWN', 'CATALOGUE_BEHIND'].includes(code);

at('again').addEventListener('click', () => {
  if (present().length === 0) return location.reload(); // whatever hangs in this page goes with it
  at('again').hidden = true;
  pieces.filter(hasFailed).forEach((piece) => {
    piece.code = '';
    attempt(piece);
  });
  describe();
});

at('address').textContent = location.href;
at('qr').src = `/v1/assets/${encodeURIComponent(pieces[0]?.key ?? '')}/qr.svg`;
at('qr').hidden = pieces.length !== 1; // the code of several would be that of the first
registerServiceWorker();
follow();
