// /view/{key} and /view?key=a&key=b: things on a screen or in a headset, side by side where there are several.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { getJson } from '../shared/api.js';
import { DragControls } from './drag.js';
import { checked } from '../shared/signed-catalogue.js';
import { startRenderLoop } from './render-loop.js';
import { Grabber } from './grab.js';
import { XrInput } from './xr-input.js';
import { XrSession } from './xr-session.js';
import { keepShell } from '../shared/register-service-worker.js';
import { SceneItem, isLoaded } from './scene-item.js';
import { placeSideBySide } from './layout-and-lod.js';
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

let pieces = keysOf(location).map((key) => new SceneItem(key));
for (const { group } of pieces) root.add(group);
const present = () => pieces.filter(isLoaded);

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
  const told = await getJson(`/v1/assets/${encodeURIComponent(piece.key)}`);
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
  const manifest = await getJson(entry.manifest.url).catch(() => ({}));
  const points = piece.entry || !pieces.includes(piece) ? null : hintsOf(manifest, entry.size_m);
  if (!points) return;
  piece.showHints(points);
  redraw();
  page.dataset.hints = manifest.anchors.xyz_m.length / 3;
  if (present().length === 0) controls.target.copy(frame(camera, entry.size_m));
}

/** One more thing is there: all stand side by side, or where people put them, and all of them are in view. */
function arrived() {
  const places = placeSideBySide(present().map((piece) => piece.entry.size_m));
  present().forEach((piece, place) => {
    piece.home.set(places[place][0], 0, places[place][1]);
    if (grasp.handCount(piece) === 0) piece.place();
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
  caption(present(), pieces.length);
  showThings(pieces, { chosen, onChoose: (piece) => moving(true, piece), onRemove: remove });
  showQuickLook(pieces.length === 1 ? present()[0]?.entry : null);
  const [first] = present();
  if (first) at('collection').href = `/browse/${encodeURIComponent(first.entry.collections?.[0] || 'default')}`;
}

/** Take a thing out of the scene, and out of the page's address. */
function remove(piece) {
  grasp.drop(piece);
  pieces = pieces.filter((each) => each !== piece);
  piece.remove();
  if (pieces.length === 0) return;
  history.replaceState(null, '', `/view?${new URLSearchParams(pieces.map(({ key }) => ['key', key]))}`);
  arrived();
  describe();
}

function reset() {
  for (const piece of present()) {
    grasp.drop(piece);
    piece.resetPlace();
  }
  look();
  moved();
}

// ---- moving -----------------------------------------------------------------------------------------------------------

let chosen = null;
const arranger = new DragControls(camera, renderer.domElement, { items: present, onMove: left, onSelect: choose });
const grasp = new Grabber(left);
const hands = new XrInput(renderer, scene, { items: present, grabber: grasp, onReset: reset, showHands: () => page.dataset.mode === 'vr' });

function left(piece) {
  piece.savePlace();
  headset.hideHelp();
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
  arranger.enable(yes);
  if (piece) arranger.select(piece);
  notice(yes ? MOVE_HELP : '', { stays: true });
}

at('move').addEventListener('click', () => moving(at('move').getAttribute('aria-pressed') !== 'true'));
at('reset').addEventListener('click', reset);

// ---- the headset, and each frame --------------------------------------------------------------------------------------

const headset = new XrSession({ renderer, scene, root }, { vr: at('enter-vr'), ar: at('enter-ar') }, {
  height: () => Math.max(0, ...present().map((piece) => piece.entry.size_m[1])),
  onMode(mode) {
    page.dataset.xr = mode ? 'on' : 'off';
    page.dataset.mode = mode;
    hands.releaseAll();
    look(); // the camera was left where the headset was
    redraw();
  },
  onPlaced: (metres) => (page.dataset.placed = metres.map((value) => value.toFixed(3)).join(' ')),
  onRefused: (error) => tell({ code: 'XR_REFUSED', message: `The headset did not start: ${error.message}` }),
});

const { redraw } = startRenderLoop(stage, { items: present, controls, onHeadsetFrame: (seconds) => hands.update(seconds), onDrawn: () => headset.update() });

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

async function attempt(piece) {
  try {
    await refresh(piece);
  } catch (problem) {
    failed(piece, problem);
  }
}

/** Once something stands there, a lost connection is no reason to take it away; that its owner took it back is one. */
function failed(piece, problem) {
  const news = problem.message !== piece.problem;
  piece.problem = problem.message;
  if (problem.code === 'ASSET_REMOVED' && piece.entry) {
    remove(piece);
    notice(`${piece.name} was taken back by whoever published it.`, { stays: true });
  } else if (news && problem.code !== 'OFFLINE' && pieces.length > 1) {
    notice(`${piece.name}: ${problem.message}`);
  }
  if (present().length === 0) tell(problem);
}

at('address').textContent = location.href;
at('qr').src = `/v1/assets/${encodeURIComponent(pieces[0]?.key ?? '')}/qr.svg`;
at('qr').hidden = pieces.length !== 1; // the code of several would be that of the first
keepShell();
follow();
