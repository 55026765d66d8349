// Small preview of an asset that turns by itself and by hand.
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { Model } from '../graphics/model.js';
import { createStage, frame } from '../graphics/scene.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const TURN_S = 15; // for a whole turn
/** @type {ReturnType<typeof createStage> | null} */
let stage = null; // one for the page: browsers limit the number of WebGL contexts
let removeModel = () => {}; // what is shown now

/**
 * Shows an asset on a canvas. The one before is shown until this one is loaded. Throws what loading throws.
 * @param {HTMLCanvasElement} canvas
 * @param {AssetEntry} entry
 */
export async function showPreview(canvas, entry) {
  stage ??= createStage(canvas);
  const { renderer, scene, camera } = stage;
  const model = new Model(entry, renderer);
  await model.start();
  model.want(0);
  removeModel();
  scene.add(model.object);
  const controls = new OrbitControls(camera, canvas);
  controls.target.copy(frame(camera, entry.size_m));
  controls.autoRotate = !matchMedia('(prefers-reduced-motion: reduce)').matches;
  controls.enablePan = false;
  controls.autoRotateSpeed = 60 / TURN_S; // the control's unit is turns per minute
  let last = performance.now();
  renderer.setAnimationLoop((now) => {
    controls.update(Math.max(0, now - last) / 1000); // by the clock: a slow phone turns it as fast
    last = now;
    renderer.render(scene, camera);
  });
  removeModel = () => {
    controls.dispose();
    model.dispose();
  };
}
