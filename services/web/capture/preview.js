// A small preview that turns by itself and by hand.
import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js';
import { Model } from '../graphics/model.js';
import { frame, makeStage } from '../graphics/scene.js';

const TURN_S = 15;
let stage = null; // a page has one preview, and browsers ration WebGL contexts
let leave = () => {}; // takes away what turns now

/** Show a catalogue entry on `canvas` in place of the one before, which turns until then. */
export async function turn(canvas, entry) {
  stage ??= makeStage(canvas);
  const { renderer, scene, camera } = stage;
  const model = new Model(entry, renderer);
  await model.start();
  model.want(0);
  leave();
  scene.add(model.object);
  const controls = new OrbitControls(camera, canvas);
  controls.target.copy(frame(camera, entry.size_m));
  controls.autoRotate = !matchMedia('(prefers-reduced-motion: reduce)').matches;
  controls.enablePan = false;
  controls.autoRotateSpeed = 60 / TURN_S; // the control's unit is turns a minute
  let last = performance.now();
  renderer.setAnimationLoop((now) => {
    controls.update(Math.max(0, now - last) / 1000); // by the clock, so a slow phone turns it no slower
    last = now;
    renderer.render(scene, camera);
  });
  leave = () => {
    controls.dispose();
    model.dispose();
  };
}
