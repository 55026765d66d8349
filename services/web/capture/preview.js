// Small preview of an asset, or of its points before there is a mesh, that turns by itself and by hand.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { Model } from '../graphics/model.js';
import { createStage, dispose, frame, hintsOf } from '../graphics/scene.js';

/** @import { AnchorPoints, AssetEntry, SizeM } from '../shared/types.d.ts' */
/** @import { Stage } from '../graphics/scene.js' */

const TURN_S = 15; // for a whole turn
/** @type {Stage | null} */
let stage = null; // one for the page: browsers limit the number of WebGL contexts
let removeShown = () => {}; // what is on the canvas now

/**
 * Shows an asset on a canvas. What was there before is shown until this one is loaded. Throws what loading throws.
 * @param {HTMLCanvasElement} canvas
 * @param {AssetEntry} entry
 */
export async function showPreview(canvas, entry) {
  stage ??= createStage(canvas);
  const model = new Model(entry, stage.renderer);
  await model.start();
  model.want(0);
  turn(canvas, stage, model.object, entry.size_m, () => model.dispose());
}

/**
 * Shows a few points of a thing on a canvas, until there is a mesh. Throws where the browser has no WebGL.
 * @param {HTMLCanvasElement} canvas
 * @param {AnchorPoints} anchors
 */
export function showPoints(canvas, anchors) {
  stage ??= createStage(canvas);
  const size = sizeOf(anchors);
  const points = hintsOf({ anchors }, size);
  if (points) turn(canvas, stage, points, size, () => dispose(points));
}

/**
 * Size of the box around points that stand on the floor, around the origin.
 * @param {AnchorPoints} anchors
 * @returns {SizeM}
 */
function sizeOf({ xyz_m: values }) {
  const box = new THREE.Box3().setFromArray(values);
  const { x, y, z } = box.getSize(new THREE.Vector3());
  return [x, y, z];
}

/**
 * Puts an object in the place of what is shown, and turns it.
 * @param {HTMLCanvasElement} canvas
 * @param {Stage} stage
 * @param {THREE.Object3D} object
 * @param {SizeM} size
 * @param {() => void} disposeObject
 */
function turn(canvas, { renderer, scene, camera }, object, size, disposeObject) {
  removeShown();
  scene.add(object);
  const controls = new OrbitControls(camera, canvas);
  controls.target.copy(frame(camera, size));
  controls.autoRotate = !matchMedia('(prefers-reduced-motion: reduce)').matches;
  controls.enablePan = false;
  controls.autoRotateSpeed = 60 / TURN_S; // the control's unit is turns per minute
  let last = performance.now();
  renderer.setAnimationLoop((now) => {
    controls.update(Math.max(0, now - last) / 1000); // by the clock: a slow phone turns it as fast
    last = now;
    renderer.render(scene, camera);
  });
  removeShown = () => {
    controls.dispose();
    object.removeFromParent();
    disposeObject();
  };
}
