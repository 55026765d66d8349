// Each frame: which level of detail each thing gets, and whether there is anything new to draw.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { planned } from './layout-and-lod.js';

const SCENE_TRIANGLES = 1_000_000; // what a Quest 3 draws in time with room to spare; every thing is one draw call
const STILL_MS = 300; // after the last change: what was handed to the card comes with the next frame
const LONGEST_S = 0.1; // of a step: a page that slept does not push things through the wall
const CHANGING = ['pointermove', 'wheel', 'keydown', 'webglcontextrestored'];

/**
 * Begin to draw. On the page a picture is drawn when something has changed: a still thing costs a phone's battery nothing,
 * and the graphics card is free to take in what is being loaded. Returns {redraw()}, to be told of changes.
 * present(): the pieces; in a headset `onHeadset(seconds)` is called before each frame and `onDrawn()` behind it.
 */
export function drawing({ renderer, scene, camera }, { present, controls, onHeadset, onDrawn }) {
  const page = document.body;
  let changing = Infinity; // until the first thing is there
  let last = performance.now();

  function redraw() {
    if (present().length > 0) changing = performance.now() + STILL_MS;
  }

  for (const kind of CHANGING) renderer.domElement.addEventListener(kind, redraw, true);
  new ResizeObserver(redraw).observe(renderer.domElement);

  renderer.setAnimationLoop((now) => {
    const seconds = Math.min(LONGEST_S, Math.max(0, now - last) / 1000);
    last = now;
    const worn = renderer.xr.isPresenting;
    if (worn) onHeadset(seconds);
    else if (controls.update()) redraw();
    chooseLevels(worn ? renderer.xr.getCamera() : camera);
    report();
    if (!worn && now > changing) return;
    renderer.render(scene, camera);
    onDrawn();
  });

  function chooseLevels(seen) {
    const there = present();
    const eye = new THREE.Vector3().setFromMatrixPosition(seen.matrixWorld);
    const things = there.map((piece) => ({ share: piece.share(eye), lods: piece.model.lods, now: piece.model.shown }));
    planned(things, SCENE_TRIANGLES).forEach((level, place) => there[place].model.want(level));
  }

  /** What can be asked of the page: levels that came, the level shown, what the graphics card holds. */
  function report() {
    const there = present();
    if (there.length === 0) return;
    const all = (what) => there.map(what).join('; ');
    mark('loaded', all((piece) => piece.loaded.join(' ')));
    mark('lod', all(({ model }) => model.lods[model.shown].level));
    mark('geometries', String(renderer.info.memory.geometries));
    mark('textures', String(renderer.info.memory.textures));
  }

  function mark(name, value) {
    if (page.dataset[name] !== value && value) page.dataset[name] = value; // each writing would cost a restyling
  }

  return { redraw };
}
