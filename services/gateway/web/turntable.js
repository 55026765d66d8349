// A small preview that turns by itself and by hand.
import { OrbitControls } from './three-0.187.0.orbit-controls.js';
import { dispose, frame, loadAsset, makeStage } from './stage.js';

const TURN_S = 15;
let stage = null; // a page has one preview, and browsers ration WebGL contexts

/** Show a catalogue entry on `canvas`; resolves when the first level is drawn. Returns a function that stops. */
export async function turn(canvas, entry) {
  const object = await loadAsset(entry);
  stage ??= makeStage(canvas);
  const { renderer, scene, camera } = stage;
  scene.add(object);
  const controls = new OrbitControls(camera, canvas);
  controls.target.copy(frame(camera, entry.size_m));
  controls.autoRotate = true;
  controls.enablePan = false;
  controls.autoRotateSpeed = 60 / TURN_S; // the control's unit is turns a minute
  let last = performance.now();
  renderer.setAnimationLoop((now) => {
    controls.update(Math.max(0, now - last) / 1000); // by the clock, so a slow phone turns it no slower
    last = now;
    renderer.render(scene, camera);
  });
  return () => {
    renderer.setAnimationLoop(null);
    controls.dispose();
    scene.remove(object);
    dispose(object);
  };
}
