// /view/{key}: the asset, on a screen or in a headset.
import * as THREE from './three-0.187.0.module.js';
import { OrbitControls } from './three-0.187.0.orbit-controls.js';
import { getJson } from './api.js';
import { checked } from './catalogue.js';
import { dispose, frame, hintsOf, loadAsset, makeStage, shownLevel } from './stage.js';

const POLL_MS = 3000; // while a refined version may come
const AHEAD_M = 1.5; // arm's length and a step: the whole of a person-sized thing is in view
const EYE_SHARE = 0.75; // small things are lifted so that their middle is at this share of the eyes' height
const SMALL_M = 0.8; // a thing lower than this would lie at one's feet

const key = decodeURIComponent(location.pathname.split('/').pop());
const page = document.body;
const said = document.getElementById('said');
const enter = document.getElementById('enter-vr');
const { renderer, scene, camera } = stageOrReason(document.getElementById('stage'));
const controls = new OrbitControls(camera, renderer.domElement);
controls.enableDamping = true;
controls.listenToKeyEvents(renderer.domElement);

let shown = null; // { entry, object }
let hints = null; // points that stand for the thing before anything is shown
let placed = false;

function stageOrReason(canvas) {
  try {
    return makeStage(canvas);
  } catch (error) {
    tell({ code: 'NO_WEBGL', message: 'This browser cannot show 3D.', hints: ['Open this address in another one.'] });
    throw error;
  }
}

/** Fetch the entry; when its version is new, load it beside the old one and swap. */
async function refresh() {
  const told = await getJson(`/v1/assets/${encodeURIComponent(key)}`);
  if (shown && shown.entry.version === told.version) return;
  const entry = await checked(told);
  if (!shown) showHints(entry);
  const object = await loadAsset(entry, (level) => {
    page.dataset.loaded = `${page.dataset.loaded || ''} ${level}`.trim();
  });
  swap(entry, object);
}

async function showHints(entry) {
  const manifest = await getJson(entry.manifest.url).catch(() => ({}));
  const points = shown || hints ? null : hintsOf(manifest, entry.size_m);
  if (!points) return;
  hints = points;
  scene.add(hints);
  page.dataset.hints = manifest.anchors.xyz_m.length / 3;
  controls.target.copy(frame(camera, entry.size_m));
}

function swap(entry, object) {
  if (hints) {
    scene.remove(hints);
    dispose(hints);
    hints = null;
  }
  if (shown) {
    object.position.copy(shown.object.position);
    object.quaternion.copy(shown.object.quaternion);
    scene.remove(shown.object);
    dispose(shown.object);
  } else {
    controls.target.copy(frame(camera, entry.size_m));
  }
  scene.add(object);
  shown = { entry, object };
  page.dataset.version = entry.version;
  page.dataset.state = entry.state;
  describe(entry);
}

function describe(entry) {
  document.title = `${entry.label || entry.key} · capture2vr`;
  document.getElementById('label').textContent = entry.label || entry.key;
  const size = entry.size_m.map((side) => (side < 1 ? `${(side * 100).toFixed(0)} cm` : `${side.toFixed(2)} m`));
  const scale = entry.scale_confidence === 'unknown' ? ' (true size unknown)' : '';
  const origin = entry.origin === 'guess' ? 'A guess from one photo · ' : '';
  const triangles = entry.lods[0].triangles.toLocaleString('en');
  said.textContent = `${origin}${size.join(' × ')}${scale} · ${triangles} triangles · ${entry.state}, version ${entry.version}`;
}

function tell(problem) {
  page.dataset.state = 'error';
  page.dataset.code = problem.code || 'UNKNOWN';
  said.textContent = [problem.message, ...(problem.hints || [])].join(' ');
}

/** Stand the asset 1.5 m ahead of where the wearer looks, on the floor, or at a comfortable height when small. */
function placeAhead(xrCamera) {
  const eye = new THREE.Vector3().setFromMatrixPosition(xrCamera.matrixWorld);
  const ahead = new THREE.Vector3(0, 0, -1).transformDirection(xrCamera.matrixWorld).setY(0);
  if (ahead.lengthSq() < 1e-6) ahead.set(0, 0, -1);
  ahead.normalize();
  const [, height] = shown.entry.size_m;
  const position = eye.clone().addScaledVector(ahead, AHEAD_M);
  position.y = height < SMALL_M ? Math.max(0, eye.y * EYE_SHARE - height / 2) : 0;
  shown.object.position.copy(position);
  shown.object.rotation.set(0, Math.atan2(-ahead.x, -ahead.z), 0);
  page.dataset.placed = position.toArray().map((value) => value.toFixed(3)).join(' ');
}

renderer.xr.enabled = true;
renderer.xr.setReferenceSpaceType('local-floor');
renderer.setAnimationLoop(() => {
  if (!renderer.xr.isPresenting) controls.update();
  renderer.render(scene, camera);
  if (!shown) return;
  page.dataset.lod = shownLevel(shown.object);
  // After a frame was drawn the headset's pose is known.
  if (renderer.xr.isPresenting && !placed && renderer.xr.getCamera().cameras.length > 0) {
    placeAhead(renderer.xr.getCamera());
    placed = true;
  }
});

renderer.xr.addEventListener('sessionstart', () => {
  placed = false;
  page.dataset.xr = 'on';
  enter.textContent = 'Leave VR';
});
renderer.xr.addEventListener('sessionend', () => {
  page.dataset.xr = 'off';
  enter.textContent = 'Enter VR';
  if (!shown) return;
  shown.object.position.set(0, 0, 0);
  shown.object.rotation.set(0, 0, 0);
  controls.target.copy(frame(camera, shown.entry.size_m)); // the camera was left where the headset was
});

async function offerVr() {
  const possible = await navigator.xr?.isSessionSupported('immersive-vr').catch(() => false);
  enter.hidden = !possible;
  document.getElementById('headset').hidden = Boolean(possible);
}

enter.addEventListener('click', async () => {
  const session = renderer.xr.getSession();
  if (session) return session.end();
  enter.disabled = true; // a second request while the first is asked for would be refused
  try {
    const wanted = { requiredFeatures: ['local-floor'], optionalFeatures: ['hand-tracking'] };
    await renderer.xr.setSession(await navigator.xr.requestSession('immersive-vr', wanted));
  } catch (error) {
    tell({ code: 'XR_REFUSED', message: `The headset did not start: ${error.message}` });
  }
  enter.disabled = false;
});

document.getElementById('qr').src = `/v1/assets/${encodeURIComponent(key)}/qr.svg`;
document.getElementById('address').textContent = location.href;
navigator.xr?.addEventListener('devicechange', offerVr);
offerVr();
navigator.serviceWorker?.register('/web/sw.js', { scope: '/' }).catch(() => {}); // a private window does without

async function poll() {
  try {
    await refresh();
  } catch (problem) {
    // Once something stands there, a lost connection is no reason to take it away.
    if (!shown) tell(problem);
  }
  setTimeout(poll, POLL_MS);
}
poll();
