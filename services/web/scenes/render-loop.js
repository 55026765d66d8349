// The render loop: in each frame, which levels of detail to show, and whether there is anything new to draw.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { MOST_TRIANGLES, chooseLevels } from './layout-and-lod.js';

/** @import { Stage } from '../graphics/scene.js' */
/** @import { LoadedItem } from './scene-item.js' */

const REDRAW_MS = 100; // after the last change: what was sent to the graphics card comes with the next frame
const LONGEST_FRAME_S = 0.1; // a page that was in the background must not push things through the wall
const REDRAW_EVENTS = ['pointermove', 'wheel', 'keydown', 'webglcontextrestored'];

/**
 * What the render loop asks and calls.
 * @typedef {object} FrameCallbacks
 * @property {() => LoadedItem[]} items
 * @property {{ update: (seconds: number) => boolean }} controls of the camera on the page
 * @property {(seconds: number) => void} onHeadsetFrame before each frame in a headset
 * @property {() => void} draw draws a frame
 * @property {() => void} onDrawn after each frame that was drawn
 */

/**
 * Starts the render loop. On the page a frame is drawn only when something has changed: a phone's battery lasts longer, and
 * the graphics card is free for what is being loaded.
 * @param {Stage} stage
 * @param {FrameCallbacks} callbacks
 * @returns {{ redraw: () => void }} redraw: to be called after a change
 */
export function startRenderLoop({ renderer, camera }, { items, controls, onHeadsetFrame, draw, onDrawn }) {
  let last = performance.now();
  let drawUntil = 0;
  let isStale = true; // a page that was busy draws what has changed, however late

  function redraw() {
    drawUntil = performance.now() + REDRAW_MS;
    isStale = true;
  }

  for (const kind of REDRAW_EVENTS) renderer.domElement.addEventListener(kind, redraw, true);
  new ResizeObserver(redraw).observe(renderer.domElement);

  renderer.setAnimationLoop((now) => {
    const seconds = Math.min(LONGEST_FRAME_S, Math.max(0, now - last) / 1000);
    last = now;
    const inHeadset = renderer.xr.isPresenting;
    if (inHeadset) onHeadsetFrame(seconds);
    else if (controls.update(seconds)) redraw();
    const eyes = inHeadset ? renderer.xr.getCamera() : camera;
    showLevels(items(), eyes);
    showTiles(items(), eyes);
    reportState(items(), renderer.info.memory);
    if (!inHeadset && now > drawUntil && !isStale) return;
    isStale = false;
    draw();
    onDrawn();
  });

  return { redraw };
}

/**
 * Shows the level of detail of each item that fits its size in view.
 * @param {LoadedItem[]} items
 * @param {THREE.Camera} camera
 */
function showLevels(items, camera) {
  const eye = new THREE.Vector3().setFromMatrixPosition(camera.matrixWorld);
  const whole = items.filter(({ isTiled }) => !isTiled);
  const things = whole.map((item) => ({ share: item.viewShare(eye), lods: item.model.lods, now: item.model.shown }));
  chooseLevels(things, MOST_TRIANGLES).forEach((level, place) => whole[place].model.want(level));
}

/**
 * Shows the tiles of large scenes. Until there are any, and for hit tests, there is the coarsest level of the whole.
 * @param {LoadedItem[]} items
 * @param {THREE.Camera} camera
 */
function showTiles(items, camera) {
  for (const { tileset, model, isTiled } of items) {
    if (isTiled) model.want(model.lods.length - 1);
    if (!tileset) continue;
    tileset.update(camera);
    model.object.visible = !tileset.isShown;
    setData('tiles', String(tileset.tileCount));
    setData('triangles', String(tileset.triangles));
    setData('bytes', String(tileset.bytes));
  }
}

/**
 * Writes into the page's data attributes, for tests and for scripts: the levels that were loaded, the levels that are shown,
 * and what the graphics card holds.
 * @param {LoadedItem[]} items
 * @param {{ geometries: number, textures: number }} memory
 */
function reportState(items, { geometries, textures }) {
  if (items.length === 0) return;
  setData('loaded', items.map((item) => item.loadedLevels.join(' ')).join('; '));
  setData('lod', items.map(({ model }) => model.lods[model.shown].level).join('; '));
  setData('geometries', String(geometries));
  setData('textures', String(textures));
}

/**
 * @param {string} name
 * @param {string} value
 */
function setData(name, value) {
  const { dataset } = document.body;
  if (dataset[name] !== value && value) dataset[name] = value; // not in every frame: writing makes the browser compute styles
}
