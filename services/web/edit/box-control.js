// How the crop box is set: by dragging its handles on the picture, and by a slider for each side.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { placeOf } from '../graphics/picking.js';
import { element } from '../shared/dom.js';

/** @import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js' */
/** @import { CropBoxTool } from './crop-box.js' */

const page = {
  on: element('box-on', HTMLInputElement),
  sides: element('box-sides', HTMLElement),
};
const sliders = [...page.sides.querySelectorAll('input')];

/** Shows on the sliders where the sides are. @param {CropBoxTool} tool */
export function showSides(tool) {
  const isOn = tool.box !== null;
  page.on.checked = isOn;
  page.sides.hidden = !isOn;
  if (isOn) sliders.forEach((slider, side) => (slider.value = String(tool.share(side))));
}

/**
 * Lets the sliders and the switch set the box.
 * @param {CropBoxTool} tool
 * @param {object} callbacks
 * @param {(on: boolean) => void} callbacks.onSwitch
 * @param {() => void} callbacks.onChange
 */
export function startSides(tool, { onSwitch, onChange }) {
  page.on.addEventListener('change', () => onSwitch(page.on.checked));
  sliders.forEach((slider, side) =>
    slider.addEventListener('input', () => {
      tool.moveTo(side, Number(slider.value));
      slider.value = String(tool.share(side)); // it does not pass the one across
      onChange();
    }),
  );
}

/**
 * Lets a pointer drag the handles. Meanwhile the camera stays.
 * @param {CropBoxTool} tool
 * @param {HTMLCanvasElement} canvas
 * @param {THREE.Camera} camera
 * @param {OrbitControls} controls
 * @param {() => void} onChange
 */
export function startDragging(tool, canvas, camera, controls, onChange) {
  const raycaster = new THREE.Raycaster();
  let dragged = -1;

  /** @param {PointerEvent} event */
  function aim(event) {
    raycaster.setFromCamera(placeOf(event, canvas), camera);
    return raycaster.ray;
  }

  canvas.addEventListener(
    'pointerdown',
    (event) => {
      if (!event.isPrimary) return;
      dragged = tool.hit(aim(event));
      controls.enabled = dragged < 0;
      if (dragged >= 0) canvas.setPointerCapture(event.pointerId);
    },
    true,
  ); // before the camera's controls
  canvas.addEventListener('pointermove', (event) => {
    if (dragged < 0 || !event.isPrimary) return;
    tool.drag(dragged, aim(event));
    showSides(tool);
    onChange();
  });
  for (const kind of /** @type {const} */ (['pointerup', 'pointercancel'])) {
    canvas.addEventListener(kind, () => {
      dragged = -1;
      controls.enabled = true;
    });
  }
}
