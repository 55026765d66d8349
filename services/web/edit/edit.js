// The edit page (/edit/KEY): what to cut away of a stored capture, which way is up, how large it is; saved as a new version.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { showSides, startDragging, startSides } from './box-control.js';
import { CropBoxTool } from './crop-box.js';
import { CutPreview, planesOf } from './cut-preview.js';
import { pick, watchTaps } from '../graphics/picking.js';
import { PlaneList } from './plane-list.js';
import { runEdited } from './saving.js';
import { findJob, loadVersion, notStored } from './shown-version.js';
import { startTabs } from './tabs.js';
import { TrueSize } from './true-size.js';
import { Upright } from './upright.js';
import { showVersions } from './version-list.js';
import { Comparison } from '../graphics/compare.js';
import { pause } from '../graphics/gpu-warmup.js';
import { createStage, frame } from '../graphics/scene.js';
import { getJson, restoreVersion } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { formatRounded } from '../shared/format.js';
import { Problem, sentences } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { ShownVersion } from './shown-version.js' */
/** @import { LassoCut } from './lasso-cut.js' */
/** @import { PhotoLassos } from './photo-lassos.js' */
/** @import { AssetEntry, Edits, Job, PhotoLasso, Presets, Session } from '../shared/types.d.ts' */

const REDRAW_MS = 300; // after the last change
const GLIMPSE_PX = 130; // longer side of the small picture of the thing beside the photo's choices
const MARGIN = 0.04; // of a new box around the thing, of its size: a coarse mesh is smaller than the thing
const REDRAW_EVENTS = ['pointermove', 'wheel', 'keydown', 'webglcontextrestored'];

document.body.dataset.started = 'yes';
const key = decodeURIComponent(location.pathname.split('/')[2] ?? '');
const page = {
  canvas: element('stage', HTMLCanvasElement),
  glimpse: element('glimpse', HTMLCanvasElement),
  cross: element('cross', HTMLElement),
  label: element('label', HTMLElement),
  said: element('said', HTMLElement),
  trouble: element('trouble', HTMLElement),
  save: element('save', HTMLButtonElement),
  reset: element('reset', HTMLButtonElement),
  recipe: element('recipe', HTMLAnchorElement),
  back: element('back', HTMLAnchorElement),
};
const choices = ['cut', 'fill', 'preset', 'target'].map((id) => element(id, HTMLSelectElement));
const picks = new Map(['plane', 'ground', 'length'].map((kind) => [kind, element(`${kind}-pick`, HTMLButtonElement)]));

await pause(); // between two long tasks of the main thread: loading the modules, and creating the WebGL context
const stage = createStage(page.canvas);
const { scene, camera, renderer } = stage;
const root = new THREE.Group(); // turned so that up is up
const tools = new THREE.Group(); // what is drawn of the recipe
const box = new CropBoxTool();
const planes = new PlaneList(change);
const upright = new Upright(camera, change);
const size = new TrueSize(change);
const preview = new CutPreview(renderer);
const comparison = new Comparison(element('picture', HTMLElement), redraw);
const controls = new OrbitControls(camera, page.canvas);

/** @type {AssetEntry} the newest version */
let newest;
/** @type {ShownVersion} */
let shown;
/** @type {Job | null} */
let job = null;
/** @type {Session | null} */
let session = null;
/** @type {PhotoLasso[]} */
let lassos = [];
/** @type {PhotoLassos | null} */
let photos = null; // once their tab is opened
/** @type {Promise<LassoCut | null> | null} */
let lassoCut = null; // of the version that is shown, once a line is drawn
let picking = ''; // what the next tap chooses: plane, ground, length
let isChanged = false;
let drawUntil = 0;

function redraw() {
  drawUntil = performance.now() + REDRAW_MS;
}

// ---- the recipe -------------------------------------------------------------------------------------------------------

/** The recipe of what is set on the page, in the capture frame. */
function recipe() {
  const { box: kept } = box;
  const length = size.recipe(shown.frame);
  /** @type {Edits} */
  const edits = { schema: 1 };
  if (job?.capture) edits.capture = job.capture;
  if (kept) edits.crop = shown.frame.boxToCapture(kept);
  if (planes.planes.length) edits.planes = planes.recipe(shown.frame);
  if (lassos.length) edits.lassos = lassos;
  if (upright.up) edits.up = shown.frame.directionToCapture(upright.up);
  if (upright.front) edits.front = shown.frame.directionToCapture(upright.front);
  if (length) edits.length = length;
  for (const { id, value } of choices) if (value) Object.assign(edits, { [id]: value });
  return edits;
}

/** @param {Edits} edits */
function showRecipe(edits) {
  const diagonal = shown.bounds.getSize(new THREE.Vector3()).length();
  box.show(edits.crop ? shown.frame.boxToAsset(edits.crop) : null, shown.bounds);
  planes.show(edits.planes ?? [], shown.frame, diagonal);
  lassos = edits.lassos ?? [];
  photos?.show(lassos);
  attempt(page.trouble, previewLassos);
  upright.show(edits, shown.frame);
  size.show(edits.length ?? null, shown.frame);
  const said = new Map(Object.entries(edits));
  for (const choice of choices) choice.value = String(said.get(choice.id) ?? '');
  showSides(box);
  showPreview();
}

/** Shows what the recipe now keeps, and that there is something to save. */
function change() {
  isChanged = true;
  showPreview();
}

function showPreview() {
  const middle = shown.bounds.getCenter(new THREE.Vector3());
  root.quaternion.copy(upright.turn);
  root.position.copy(middle).sub(middle.clone().applyQuaternion(root.quaternion));
  const { box: kept } = box;
  preview.take(shown.model.object);
  const left = preview.apply(shown.model.object, [...(kept ? planesOf(kept) : []), ...planes.planes]);
  const extent = new THREE.Box3().setFromPoints(left.map((place) => place.clone().applyQuaternion(root.quaternion)));
  const metres = extent.getSize(new THREE.Vector3()).multiplyScalar(size.factor);
  page.said.textContent = left.length
    ? `${metres
        .toArray()
        .map((side) => formatRounded(100 * side))
        .join(' × ')} cm`
    : t('Nothing of it is left.');
  page.save.disabled = !(job && isChanged && left.length > 0 && !size.fault);
  page.recipe.href = `data:application/json,${encodeURIComponent(JSON.stringify(recipe(), null, 2))}`;
  Object.assign(document.body.dataset, { kept: preview.share.toFixed(3), changed: isChanged ? 'yes' : 'no' });
  redraw();
}

// ---- choosing on the thing --------------------------------------------------------------------------------------------

/** @param {string} kind what the next tap chooses; '' for nothing */
function choose(kind) {
  picking = kind;
  for (const [each, button] of picks) button.setAttribute('aria-pressed', String(each === kind));
  page.cross.hidden = kind === '';
  if (kind) page.canvas.focus();
}

/** @param {THREE.Vector2} place in the view, from -1 to 1 */
function tap(place) {
  if (!picking) return;
  const picked = pick(shown.model.object, place, camera, preview.world);
  if (!picked) return;
  if (picking === 'length') {
    if (size.add(picked)) choose('');
    return;
  }
  if (picking === 'plane' && !planes.isFull) planes.add(picked);
  if (picking === 'ground') upright.choose(picked);
  choose('');
}

/** @param {boolean} on */
function switchBox(on) {
  const [middle, extent] = [shown.bounds.getCenter(new THREE.Vector3()), shown.bounds.getSize(new THREE.Vector3())];
  const around = extent.addScalar(2 * MARGIN * extent.length());
  box.show(on ? { middle, turn: new THREE.Quaternion(), size: around } : null, shown.bounds);
  showSides(box);
  change();
}

/** Shows the photos of the capture, to draw lines in them; hides them where another tool is chosen. @param {boolean} on */
async function showPhotos(on) {
  document.body.dataset.photos = on ? 'yes' : 'no';
  photos?.close();
  if (!on || !shown) return;
  if (!job) throw notStored();
  if (!session?.scopes.includes('manage')) {
    throw new Problem({
      code: 'SCOPE_MISSING',
      detail: t('Photos are shown only with an access key that may manage.'),
    });
  }
  const { PhotoLassos: Tool } = await import('./photo-lassos.js');
  photos ??= new Tool((drawn) => {
    lassos = drawn;
    change();
    attempt(page.trouble, previewLassos);
  });
  await photos.open(job.capture, shown.cameras, lassos, () => document.body.dataset.photos === 'yes');
  redraw();
}

/** Shows what the lines leave out that the version on the page has not left out already. */
async function previewLassos() {
  if (lassos.length === 0 && !lassoCut) return;
  const { drawnSince, LassoCut: Cut } = await import('./lasso-cut.js');
  const { surface } = preview;
  if (!lassoCut && surface && drawnSince(shown.edits.lassos ?? [], lassos).length) {
    lassoCut = Cut.load(shown.cameras, surface);
  }
  const [asked, cut] = [lassoCut, await lassoCut];
  if (asked !== lassoCut) return; // another version is shown
  const drawn = drawnSince(shown.edits.lassos ?? [], lassos);
  preview.leaveOut(cut && drawn.length ? (places) => cut.leavesOut(places, drawn) : null);
  photos?.tellPreview(drawn.length === 0 || (cut?.knows(drawn) ?? false));
  showPreview();
}

/** Shows the thing small beside the photo's choices: the photo covers it, and a line changes what is kept of it. */
function drawGlimpse() {
  const { glimpse, canvas } = page;
  const scale = GLIMPSE_PX / Math.max(canvas.clientWidth, canvas.clientHeight);
  glimpse.width = Math.round(scale * canvas.clientWidth);
  glimpse.height = Math.round(scale * canvas.clientHeight);
  glimpse.getContext('2d')?.drawImage(canvas, 0, 0, glimpse.width, glimpse.height); // in the frame in which it was drawn
}

// ---- versions ---------------------------------------------------------------------------------------------------------

/** @param {number} [version] to edit from; the newest without one */
async function open(version) {
  newest = await getJson(`/v1/assets/${encodeURIComponent(key)}`);
  const loaded = await loadVersion(newest, version ?? newest.version, stage, () => shown && showPreview());
  endComparison();
  shown?.model.dispose();
  preview.clear();
  lassoCut = null;
  shown = loaded;
  root.add(shown.model.object);
  job = await findJob(newest, shown.entry.version).catch((error) => {
    showTrouble(error);
    return null;
  });
  isChanged = false;
  page.label.textContent = newest.label || key;
  showRecipe(shown.edits);
  controls.target.copy(
    frame(camera, shown.bounds.getSize(new THREE.Vector3()).toArray(), shown.bounds.getCenter(new THREE.Vector3())),
  );
  const manages = Boolean(session?.scopes.includes('manage'));
  showVersions(newest, shown.entry.version, manages, {
    onShow: guarded(open),
    onCompare: guarded(compare),
    onRestore: guarded(restore),
  });
  Object.assign(document.body.dataset, {
    state: 'ready',
    version: String(newest.version),
    shown: String(shown.entry.version),
  });
}

/** @param {number} version to the right of the line */
async function compare(version) {
  const other = await loadVersion(newest, version, stage, redraw);
  const { object } = other.model;
  tools.visible = false;
  preview.apply(shown.model.object, []);
  object.applyMatrix4(shown.frame.toAsset.clone().multiply(other.frame.toCapture)); // both in the frame of the capture
  root.add(object);
  comparison.show(
    other.model,
    t('Version {version}', { version: shown.entry.version }),
    t('Version {version}', { version }),
  );
  document.body.dataset.compared = String(version);
  redraw();
}

function endComparison() {
  if (!comparison.isOn) return;
  comparison.show(null);
  tools.visible = true;
  showPreview();
}

/** @param {number} version */
async function restore(version) {
  await restoreVersion(key, version);
  await open();
}

async function save() {
  if (!job) return;
  const { asset } = await runEdited(job, recipe());
  await open(asset?.held ? asset.version : undefined); // else nobody would see what became of the edits
}

/**
 * An action whose failure is said on the page.
 * @param {(version: number) => Promise<void>} action
 */
function guarded(action) {
  return (/** @type {number} */ version, /** @type {HTMLButtonElement} */ pressed) =>
    attempt(page.trouble, () => action(version), pressed);
}

/** @param {unknown} error */
function showTrouble(error) {
  page.trouble.textContent = sentences(error);
  page.trouble.hidden = false;
}

// ---- start ------------------------------------------------------------------------------------------------------------

/** Lets the page's controls set the recipe. */
function startControls() {
  startSides(box, { onSwitch: switchBox, onChange: change });
  startDragging(box, page.canvas, camera, controls, change);
  watchTaps(page.canvas, tap);
  startTabs((tool) => {
    choose('');
    endComparison();
    attempt(page.trouble, () => showPhotos(tool === 'photos'));
  });
  for (const [kind, button] of picks) button.addEventListener('click', () => choose(picking === kind ? '' : kind));
  for (const choice of choices) choice.addEventListener('change', change);
  page.save.addEventListener('click', () => attempt(page.trouble, save, page.save));
  page.reset.addEventListener('click', () => {
    showRecipe({});
    change();
  });
  page.back.href = `/view/${encodeURIComponent(key)}`;
}

/** Draws a frame when something has changed. */
function startDrawing() {
  controls.enableDamping = true;
  controls.listenToKeyEvents(page.canvas);
  for (const kind of REDRAW_EVENTS) page.canvas.addEventListener(kind, redraw, true);
  new ResizeObserver(redraw).observe(page.canvas);
  renderer.setAnimationLoop((now) => {
    if (controls.update()) redraw();
    if (now > drawUntil || !shown) return;
    box.scaleHandles(camera);
    comparison.render(stage, shown.model.object);
    if (document.body.dataset.photos === 'yes') drawGlimpse();
  });
}

async function start() {
  session = await getJson('/v1/session');
  if (!session?.scopes.includes('capture')) {
    throw new Problem({ code: 'SCOPE_MISSING', detail: t('Editing needs an access key that may capture.') });
  }
  /** @type {Presets} */
  const { presets } = await getJson('/v1/presets');
  element('preset', HTMLSelectElement).append(
    ...presets.map(({ name, summary }) => create('option', { value: name, textContent: `${name}: ${summary}` })),
  );
  await open();
}

scene.add(root);
root.add(tools);
tools.add(box.object, planes.object, size.object);
startControls();
startDrawing();
attempt(page.trouble, start).then(() => {
  if (document.body.dataset.state === 'loading') document.body.dataset.state = 'error';
});
