// The viewer page (/view/{key}, /view?key=a&key=b, /scene/{id}, /wardrobe/{collection}): things on a screen or in a headset, side by side where there are several. Begun by start.js.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { startBackdrop } from './backdrop.js';
import { startCameraKeys } from './camera-orbit.js';
import { startFullScreen } from './full-screen.js';
import { offerAbout, offerDownloads, offerManaging, offerMeasuring, offerNotes } from './panels.js';
import { startOriginMode } from './origin-mode.js';
import { hidePoster } from './poster.js';
import { Room } from './room.js';
import { context } from './stage-context.js';
import { startTurntable } from './turntable.js';
import { loadFile } from '../catalogue/verified-cache.js';
import { pause, prepare } from '../graphics/gpu-warmup.js';
import { createStage, frame, hintsOf } from '../graphics/scene.js';
import { Grabber } from '../headset/grab.js';
import { placeAhead, placeBeside } from '../headset/new-place.js';
import { RoomPlanes } from '../headset/room-planes.js';
import { Walker } from '../headset/walk.js';
import { XrInput } from '../headset/xr-input.js';
import { HELP, XrSession } from '../headset/xr-session.js';
import { DragControls } from '../scenes/drag.js';
import { ItemUpdates, hasFailed, isGone } from '../scenes/item-updates.js';
import { placeSideBySide } from '../scenes/layout-and-lod.js';
import { LiveMoves } from '../scenes/live-moves.js';
import { showCaption, showError, showList, showNotice, showQuickLook } from '../scenes/messages.js';
import { keys, nextEntry, sceneId, wardrobeOf } from '../scenes/page-address.js';
import { startRenderLoop } from '../scenes/render-loop.js';
import { SceneItem, isLoaded } from '../scenes/scene-item.js';
import { Shadows } from '../scenes/shadows.js';
import { snapItem } from '../scenes/snap.js';
import { findStandingPlace } from '../scenes/standing-place.js';
import { showAccount } from '../shared/account.js';
import { element } from '../shared/dom.js';
import { Problem, isConnectionProblem, toProblem } from '../shared/problems.js';
import { registerServiceWorker } from '../shared/register-service-worker.js';
import { t } from '../shared/texts.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { PickerWall } from '../headset/picker-wall.js' */
/** @import { LoadedItem } from '../scenes/scene-item.js' */
/** @import { VersionComparison } from './version-comparison.js' */
/** @import { Wardrobe } from '../wardrobe/wardrobe.js' */
/** @import { AssetEntry, AssetNames, Manifest, Session } from '../shared/types.d.ts' */

const GROUND_M = 100; // of the floor on which one goes from place to place where there is no large scene
const MOVE_HELP = matchMedia('(hover: hover)').matches
  ? t(
      'Drag an object to move it, with Shift to lift it. Scroll on it to scale it, drag with the right button to turn it. Keys: arrows, page up and down, comma, point, plus, minus.',
    )
  : t('Drag an object to move it. Two fingers scale and turn it.');

document.body.dataset.started = 'yes';
const page = {
  canvas: element('stage', HTMLCanvasElement),
  collection: element('collection', HTMLAnchorElement),
  move: element('move', HTMLButtonElement),
  reset: element('reset', HTMLButtonElement),
  retry: element('again', HTMLButtonElement),
  vr: element('enter-vr', HTMLButtonElement),
  ar: element('enter-ar', HTMLButtonElement),
  qr: element('qr', HTMLImageElement),
  address: element('address', HTMLElement),
  view: element('view', HTMLElement),
};

await pause(); // between two long tasks of the main thread: loading the modules, and creating the WebGL context
const stage = startStage();
await pause();
const { renderer, scene, camera } = stage;
const root = new THREE.Group(); // what moves in front of the wearer: all things, and the floor under them
const controls = new OrbitControls(camera, renderer.domElement);

let items = keys.map((key) => new SceneItem(key));
/** @type {SceneItem | null} */
let selected = null;
/** @type {VersionComparison | null} */
let comparison = null; // once somebody wants one
/** @type {PickerWall | null} */
let wall = null; // once somebody who may add things is in a headset
/** @type {Wardrobe | null} */
let wardrobe = null; // where the page's address names one
let showFacts = () => {}; // of a thing that is alone, after each change of it

const drag = new DragControls(camera, renderer.domElement, {
  items: movableItems,
  onDrag: showDrag,
  onDrop: letGo,
  onMove: savePlace,
  onSelect: select,
});
const grabber = new Grabber(letGo);
const live = new LiveMoves({ isHeld, onChange: reportPlaces });
const planes = new RoomPlanes(renderer);
const ground = new THREE.Mesh(new THREE.PlaneGeometry(GROUND_M, GROUND_M).rotateX(-Math.PI / 2)); // of the wearer's room, which nothing draws
const shadows = new Shadows(
  root,
  (shadow) => prepare(stage, shadow),
  () => redraw(),
);
const walker = new Walker(renderer, scene, root, {
  surfaces: walkSurfaces,
  onMove: () => reportPlace(root.position.toArray()),
});
const input = new XrInput(renderer, scene, {
  items: loadedItems,
  isMovable,
  grabber,
  walker,
  panels: () => board()?.panels ?? [],
  onMenu: () => board()?.toggle(renderer.xr.getCamera()),
  onTap: () => wardrobe?.step(1),
  onSteer: (x) => (wardrobe ?? walker).steer(x),
  onReset: resetAll,
  showHands: () => document.body.dataset.mode === 'vr',
});
const headset = new XrSession(
  { renderer, scene, root },
  { vr: page.vr, ar: page.ar },
  {
    height: () => wardrobe?.box.max.y ?? Math.max(0, ...loadedItems().map((item) => item.entry.size_m[1])),
    standingPlace,
    help: () => wardrobe?.help ?? HELP,
    onMode: showMode,
    onPlaced: (metres) => {
      reportPlace(metres);
      offerWall();
    },
    onRefused: (error) =>
      showError(
        new Problem({
          code: 'XR_REFUSED',
          detail: t('The headset did not start: {reason}', { reason: error.message }),
        }),
      ),
  },
);
const { redraw } = startRenderLoop(stage, {
  items: loadedItems,
  controls: { update: (seconds) => [live.update(seconds), controls.update(seconds)].includes(true) },
  onHeadsetFrame: moveInHeadset,
  draw,
  onDrawn: () => headset.update(),
});
const updateOrigins = startOriginMode(loadedItems, () => redraw());
const updates = new ItemUpdates({
  items: () => items,
  isVisible,
  update,
  onError: showItemError,
});
const room = new Room({
  items: () => items,
  setItems,
  createItem: (key, placed) => new SceneItem(key, placed),
  load: (item) => updates.update(item),
  isHeld,
  live,
  isVisible,
  isWorn: () => renderer.xr.isPresenting,
  onChange: showTexts,
});

/** Whether anybody looks at the page. */
function isVisible() {
  return !document.hidden || renderer.xr.isPresenting;
}

/** Creates the stage, or says that this browser has no WebGL. */
function startStage() {
  try {
    return createStage(page.canvas, context);
  } catch (error) {
    showError(
      new Problem({
        code: 'NO_WEBGL',
        detail: t('This browser cannot show 3D.'),
        hints: [t('Open this address in another one.')],
      }),
    );
    throw error;
  }
}

/** The items that are shown. */
function loadedItems() {
  return items.filter(isLoaded);
}

/** The items that are shown and that the person may move. */
function movableItems() {
  return loadedItems().filter(isMovable);
}

/** @param {LoadedItem} item */
function isMovable({ entry }) {
  return !wardrobe && entry.may_place !== false;
}

/**
 * Whether a hand or the mouse has an item, so that it goes where that goes.
 * @param {SceneItem} item
 */
function isHeld(item) {
  return grabber.handCount(item) > 0 || drag.holds(item);
}

/**
 * Moves what the hands hold, and what others are moving.
 * @param {number} seconds since the last frame
 */
function moveInHeadset(seconds) {
  live.update(seconds);
  input.update(seconds);
  wardrobe?.update(seconds);
  for (const item of grabber.items) room.report(item);
}

/** The panel that A and X open in a headset. */
function board() {
  return wardrobe?.board ?? wall;
}

/** What one can stand on: the surfaces of a large scene, which may go down under the room's floor, else that floor too. */
function walkSurfaces() {
  const surfaces = loadedItems().flatMap((item) => item.surface ?? []);
  return loadedItems().some(({ isWalkable }) => isWalkable) ? surfaces : [...surfaces, ground];
}

/** Draws a frame. */
function draw() {
  shadows.update(loadedItems(), hasShadow);
  if (comparison?.isOn) comparison.render();
  else renderer.render(scene, camera);
}

/**
 * Whether a thing throws a shadow on the floor: on the page, and in VR where the scene stands on the floor and nobody holds the thing. In
 * passthrough the room's own floor is where nobody knows.
 * @param {LoadedItem} item
 */
function hasShadow(item) {
  if (!renderer.xr.isPresenting) return true;
  return document.body.dataset.mode === 'vr' && root.position.y === 0 && grabber.handCount(item) === 0;
}

// ---- what is shown ----------------------------------------------------------------------------------------------------

/**
 * Asks for an item's entry. When its version is new, loads it, and shows it in place of the old one.
 * @param {SceneItem} item
 */
async function update(item) {
  const entry = await nextEntry(item.key, item.entry?.version);
  if (!entry) return;
  const before = item.entry;
  if (before) endComparison();
  else showHints(item, entry);
  await item.show(entry, renderer, {
    prepare: (group) => prepare(stage, group),
    onChange: redraw,
    onTileError: (error, file) =>
      showNotice(
        `${t('A part of {name} is shown coarser: {file} could not be loaded.', { name: item.name, file })} ${toProblem(error).message}`,
      ),
  });
  hidePoster();
  if (!items.includes(item)) {
    item.remove(); // the person has removed it meanwhile
    return;
  }
  if (before) showNotice(updateText(before, entry, item.name));
  else if (!wardrobe) placeFirst(item);
  wardrobe?.wear(item);
  showTexts();
}

/**
 * @param {AssetEntry} before
 * @param {AssetEntry} now
 * @param {string} name
 */
function updateText(before, now, name) {
  const refined = before.state === 'preview' && now.state === 'refined';
  const values = { name, version: now.version };
  return refined
    ? t('The refined version of {name} took its place: version {version}.', values)
    : t('A new version of {name} took its place: version {version}.', values);
}

/**
 * Shows the manifest's points until the first level of detail is loaded.
 * @param {SceneItem} item
 * @param {AssetEntry} entry
 */
async function showHints(item, entry) {
  const { anchors } = await loadManifest(entry).catch(() => ({ anchors: undefined }));
  const points = item.entry || !items.includes(item) ? null : hintsOf({ anchors }, entry.size_m);
  if (!points || !anchors) return;
  item.showHints(points);
  redraw();
  document.body.dataset.hints = String(anchors.xyz_m.length / 3);
  if (loadedItems().length === 0) controls.target.copy(frame(camera, entry.size_m));
}

/**
 * @param {AssetEntry} entry
 * @returns {Promise<Manifest>}
 */
async function loadManifest({ manifest: { url, sha256 } }) {
  const bytes = await loadFile({ url, sha256, file: 'manifest.json' });
  return JSON.parse(new TextDecoder().decode(bytes));
}

/**
 * Places an item that has just come, and all others as they were, or side by side.
 * @param {SceneItem} item
 */
function placeFirst(item) {
  if (item.isNew && isLoaded(item)) {
    if (renderer.xr.isPresenting) placeAhead(item, renderer.xr.getCamera());
    else {
      placeBeside(
        item,
        loadedItems().filter((other) => other !== item),
      );
    }
    item.isNew = false;
    item.fix();
    room.touch();
  }
  placeAll();
}

/** Places all items side by side, or where the person put them, and shows all of them. */
function placeAll() {
  const places = placeSideBySide(loadedItems().map(({ entry }) => entry.size_m));
  loadedItems().forEach((item, index) => {
    const [x, z] = places[index];
    item.home.set(x, 0, z);
    if (!isHeld(item) && !live.has(item)) item.place();
  });
  reportPlaces();
  frameAll();
}

/**
 * Where a wearer begins, in the root's frame: inside a large thing. Null where there is none.
 */
function standingPlace() {
  const item = loadedItems().find(({ isWalkable }) => isWalkable);
  const mesh = item?.model.coarsest;
  if (!item || !mesh) return null;
  return root.worldToLocal(findStandingPlace(mesh, item.box.applyMatrix4(item.group.matrixWorld)));
}

/** Moves the camera of the page so that all items are in view. */
function frameAll() {
  if (renderer.xr.isPresenting) return;
  const box = wardrobe?.view ?? new THREE.Box3();
  for (const item of loadedItems()) box.union(item.box.applyMatrix4(item.group.matrixWorld));
  if (box.isEmpty()) return;
  const [size, middle] = [box.getSize(new THREE.Vector3()), box.getCenter(new THREE.Vector3())];
  controls.target.copy(frame(camera, size.toArray(), middle));
}

/** Shows the texts about the items: the caption, the list, and the links. */
function showTexts() {
  redraw();
  const loaded = loadedItems();
  showCaption(loaded, {
    title: room.name,
    wanted: items.length,
    failed: items.filter(hasFailed).length,
    gone: items.filter(isGone).map(({ key }) => key),
  });
  showList(wardrobe ? [] : items, { selected, onSelect: (item) => allowMoving(true, item), onRemove: remove });
  showQuickLook(items.length === 1 ? loaded.at(0)?.entry : null);
  const [first] = loaded;
  if (!first) return;
  updateOrigins();
  showFacts();
  page.move.hidden = movableItems().length === 0;
  const [collection] = first.entry.collections ?? ['default'];
  page.collection.hidden = !collection; // a visitor may read the thing, and none of its collections
  page.collection.href = ofShownTenant(`/browse/${encodeURIComponent(collection ?? '')}`);
}

/**
 * Shows these items: loads those that are new, and removes those that are missing.
 * @param {SceneItem[]} wanted
 */
function setItems(wanted) {
  const [gone, added] = [
    items.filter((item) => !wanted.includes(item)),
    wanted.filter((item) => !items.includes(item)),
  ];
  items = wanted;
  for (const item of gone) {
    grabber.drop(item);
    live.drop(item);
    item.remove();
  }
  for (const item of added) {
    root.add(item.group);
    updates.update(item);
  }
  reportPlaces();
  showTexts();
}

/**
 * Removes an item from the scene and from the page's address.
 * @param {SceneItem} item
 */
function remove(item) {
  setItems(items.filter((each) => each !== item));
  room.touch();
  if (items.length === 0 || room.isSaved) return;
  history.replaceState(null, '', ofShownTenant(`/view?${new URLSearchParams(items.map(({ key }) => ['key', key]))}`));
  placeAll();
  showTexts();
}

// ---- moving -----------------------------------------------------------------------------------------------------------

/**
 * Snaps an item to the floor and the wall that are near, after a hand or the mouse has let go of it, and saves where it stands.
 * @param {SceneItem} item
 */
function letGo(item) {
  const others = loadedItems().filter((other) => other !== item && other.isWalkable);
  const surfaces = [...planes.surfaces, ...others.flatMap(({ surface }) => surface ?? [])];
  if (isLoaded(item) && !item.isWalkable) snapItem(item, { surfaces, floor: root.position.y });
  savePlace(item);
}

/**
 * Draws an item on its way, here and for those who look at the same scene.
 * @param {SceneItem} item
 */
function showDrag(item) {
  redraw();
  room.report(item);
}

/**
 * Saves where an item stands, after the person has moved it.
 * @param {SceneItem} item
 */
function savePlace(item) {
  item.savePlace();
  room.touch();
  room.report(item);
  headset.hideHelp(); // the wearer knows how by now
  reportPlaces();
}

/** Puts all items back to their default places. */
function resetAll() {
  for (const item of loadedItems()) {
    grabber.drop(item);
    live.drop(item);
    item.resetPlace();
  }
  room.touch();
  frameAll();
  reportPlaces();
}

/**
 * Writes the place of the scene in the wearer's room into the page's data attributes, for tests and for scripts.
 * @param {number[]} metres
 */
function reportPlace(metres) {
  document.body.dataset.placed = metres.map((value) => value.toFixed(3)).join(' ');
}

/** Writes the places and scales of the items into the page's data attributes, for tests and for scripts. */
function reportPlaces() {
  /** @param {LoadedItem} item */
  const placeText = ({ group }) =>
    [...group.position.toArray(), group.scale.x].map((value) => value.toFixed(3)).join(' ');
  redraw();
  document.body.dataset.moved = loadedItems().map(placeText).join('; ');
}

/** @param {SceneItem} item */
function select(item) {
  selected = item;
  showTexts();
}

/**
 * Lets gestures and keys move the items, or the camera.
 * @param {boolean} allowed
 * @param {SceneItem} [item] to select
 */
function allowMoving(allowed, item) {
  page.move.setAttribute('aria-pressed', String(allowed));
  drag.enable(allowed);
  if (item) drag.select(item);
  showNotice(allowed ? MOVE_HELP : '', { stays: true });
}

/** Offers a wearer to add things to the scene, where they may. */
async function offerWall() {
  wardrobe?.board.offer(renderer.xr.getCamera());
  if (!room.mayAdd) return;
  const { PickerWall: Wall } = await import('../headset/picker-wall.js');
  wall ??= new Wall(scene, {
    collection: room.collection,
    onChoose: (key) => room.add(key),
    saving: () => room.saving,
    onResetView: () => headset.placeAgain(),
  });
  if (renderer.xr.isPresenting) wall.offer(renderer.xr.getCamera());
}

/** @param {string} mode of the headset: "vr", "ar", or "" when a session has ended */
function showMode(mode) {
  document.body.dataset.xr = mode ? 'on' : 'off';
  document.body.dataset.mode = mode;
  input.releaseAll();
  if (!mode) wall?.hide();
  wardrobe?.showMode(mode);
  endComparison();
  frameAll(); // the camera was left where the headset was
  redraw();
}

/**
 * Offers what can be done with a thing that is alone on the page.
 * @param {Promise<Session | null>} asking who is logged in
 */
async function offerPanels(asking) {
  const [item] = items;
  if (!item || items.length > 1 || room.isSaved) {
    await asking;
    return;
  }
  offerDownloads(item, stage, redraw);
  const fillAbout = offerAbout(item, loadManifest);
  const updateMeasuring = offerMeasuring(item, stage, { loadManifest, redraw, onStart: () => allowMoving(false) });
  const fill = () => {
    fillAbout();
    updateMeasuring();
  };
  showFacts = fill;
  const session = await asking;
  offerManaging(item, session, ({ label, description, labels }) => {
    if (item.entry) item.entry = { ...item.entry, label, description, labels };
    showTexts();
  });
  const loadNotes = await offerNotes(item, stage, { controls, redraw, onStart: () => allowMoving(false) }, session);
  const mayCompare = session?.scopes.includes('read') && ofShownTenant('') === '';
  showFacts = () => {
    fill();
    loadNotes();
    if (mayCompare) offerComparison(item);
  };
  showFacts();
}

/**
 * Offers to compare a refined thing with its preview, to somebody who may read its versions.
 * @param {SceneItem} item
 */
async function offerComparison(item) {
  if (item.entry?.state !== 'refined' || (item.entry.versions?.length ?? 0) < 2) return;
  const { VersionComparison: Shown } = await import('./version-comparison.js');
  comparison ??= new Shown(stage, { onChange: redraw, onError: (error) => showNotice(toProblem(error).message) });
  if (isLoaded(item)) comparison.offer(item);
}

/** Shows one version alone again. */
function endComparison() {
  if (comparison?.isOn) comparison.end();
}

/**
 * Says from where the camera looks now.
 * @param {string} text
 */
function sayView(text) {
  page.view.textContent = text;
}

// ---- errors -----------------------------------------------------------------------------------------------------------

/**
 * Shows why an item could not be updated. It stays in the scene when the connection was lost, but not when its publisher removed it.
 * @param {SceneItem} item
 * @param {unknown} error
 */
function showItemError(item, error) {
  if (wardrobe) {
    wardrobe.fail(item, error);
    return;
  }
  const { code, message } = toProblem(error);
  const isNew = message !== item.problem;
  item.problem = message;
  item.code = code;
  if (code === 'ASSET_REMOVED' && item.entry) {
    if (item.placed) {
      item.unload();
    } // its place in the scene stays, for when it is restored
    else remove(item);
    showNotice(t('{name} was taken back by whoever published it.', { name: item.name }), { stays: true });
  } else if (isNew && !isConnectionProblem(error) && !isGone(item) && items.length > 1) {
    showNotice(`${item.name}: ${message}`);
  }
  if (loadedItems().length === 0) showError(error, { canRetry: true });
  else if (!item.entry) showTexts();
}

/** Tries again to load the items that could not be loaded. */
function retry() {
  if (loadedItems().length === 0) {
    location.reload(); // whatever hangs in this page is gone with it
    return;
  }
  page.retry.hidden = true;
  for (const item of items.filter(hasFailed)) {
    item.code = '';
    updates.update(item);
  }
  showTexts();
}

/** Opens the wardrobe that the page's address names. */
async function openWardrobe() {
  const { Wardrobe: Shown } = await import('../wardrobe/wardrobe.js');
  page.collection.href = ofShownTenant(`/browse/${encodeURIComponent(wardrobeOf)}`);
  page.move.hidden = true; // true size, on the dummy
  wardrobe = new Shown(wardrobeOf, {
    scene,
    root,
    setItems,
    onChange: redraw,
    frameAll,
    isVisible,
    onResetView: () => headset.placeAgain(),
  });
  await wardrobe.open();
}

/**
 * Loads what the page's address names, and offers what can be done with it.
 * @param {Promise<Session | null>} asking who is logged in
 */
async function start(asking) {
  try {
    if (sceneId) await room.open(sceneId);
    if (wardrobeOf) await openWardrobe();
    updates.poll();
  } catch (error) {
    showError(error, { canRetry: true });
    return;
  }
  if (wardrobe) return; // it shows what the collection has, one after the other
  await offerPanels(asking);
  room.offer(await asking);
}

// ---- start ------------------------------------------------------------------------------------------------------------

scene.add(root);
for (const { group } of items) root.add(group);
controls.enableDamping = true;
startCameraKeys(
  controls,
  page.canvas,
  new Map([
    ['Home', frameAll],
    ['t', () => element('turn', HTMLButtonElement).click()],
    ['f', () => element('full-screen', HTMLButtonElement).click()],
  ]),
  sayView,
);
startTurntable(controls, page.canvas, redraw);
startBackdrop(showNotice);
startFullScreen();
page.move.addEventListener('click', () => allowMoving(page.move.getAttribute('aria-pressed') !== 'true'));
page.reset.addEventListener('click', resetAll);
page.retry.addEventListener('click', retry);
page.address.textContent = location.href;
page.qr.src = ofShownTenant(`/v1/assets/${encodeURIComponent(items[0]?.key ?? '')}/qr.svg`);
page.qr.hidden = items.length !== 1; // the code of several would be that of the first
registerServiceWorker();
start(showAccount());
