// The turntable: turns what is shown when it is asked to, until somebody touches it. Who wants less motion gets an eighth of a turn at a time.
import { orbit } from './camera-orbit.js';
import { element } from '../shared/dom.js';

/** @import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js' */

const TURN_S = 15; // for a whole turn
const STEP = Math.PI / 4;
const TOUCHES = /** @type {const} */ (['pointerdown', 'wheel', 'keydown']);

/**
 * Lets a button start and stop the turning.
 * @param {OrbitControls} controls
 * @param {HTMLCanvasElement} canvas
 * @param {() => void} onChange is called when the view has changed at once
 */
export function startTurntable(controls, canvas, onChange) {
  const button = element('turn', HTMLButtonElement);
  controls.autoRotateSpeed = 60 / TURN_S; // the control's unit is turns per minute

  /** @param {boolean} turning */
  function set(turning) {
    controls.autoRotate = turning;
    button.setAttribute('aria-pressed', String(turning));
  }

  button.addEventListener('click', () => {
    if (!matchMedia('(prefers-reduced-motion: reduce)').matches) {
      set(!controls.autoRotate);
      return;
    }
    orbit(controls, -STEP, 0);
    onChange();
  });
  for (const kind of TOUCHES) {
    canvas.addEventListener(
      kind,
      (event) => (event instanceof KeyboardEvent && event.key.toLowerCase() === 't' ? undefined : set(false)),
      true,
    );
  }
}
