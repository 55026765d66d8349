// Moves the camera around what it looks at by steps, for keys and for the turntable, and says in words from where it looks.
import { t } from '../shared/texts.js';
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js' */

const STEP = Math.PI / 12; // by one key press
const CLOSER = 0.85; // of the distance, by one key press
const SIDES = [
  t('the front'),
  t('the front right'),
  t('the right'),
  t('the back right'),
  t('the back'),
  t('the back left'),
  t('the left'),
  t('the front left'),
];
const [ABOVE, BELOW] = [0.5, -0.1]; // sine of the angle over the floor from which on the view counts as from above, or below which as from below

/** @type {Map<string, (controls: OrbitControls) => void>} */
const MOVES = new Map([
  ['ArrowLeft', (controls) => orbit(controls, STEP, 0)],
  ['ArrowRight', (controls) => orbit(controls, -STEP, 0)],
  ['ArrowUp', (controls) => orbit(controls, 0, -STEP)],
  ['ArrowDown', (controls) => orbit(controls, 0, STEP)],
  ['+', (controls) => zoom(controls, CLOSER)],
  ['=', (controls) => zoom(controls, CLOSER)], // the plus of an English keyboard without Shift
  ['-', (controls) => zoom(controls, 1 / CLOSER)],
]);

/**
 * Lets keys turn the camera and bring it closer, while the canvas has the focus.
 * @param {OrbitControls} controls
 * @param {HTMLCanvasElement} canvas
 * @param {Map<string, () => void>} others what further keys do
 * @param {(text: string) => void} say is called with from where the camera looks now, in words
 */
export function startCameraKeys(controls, canvas, others, say) {
  canvas.addEventListener('keydown', (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const [move, other] = [MOVES.get(key), others.get(key)];
    if (!move && !other) return;
    event.preventDefault();
    move?.(controls);
    other?.();
    if (move) say(viewText(controls));
  });
}

/**
 * Turns the camera around what it looks at.
 * @param {OrbitControls} controls
 * @param {number} around radians about the vertical, counterclockwise from above
 * @param {number} down radians towards the floor
 */
export function orbit({ object: camera, target }, around, down) {
  const place = new THREE.Spherical().setFromVector3(camera.position.clone().sub(target));
  place.theta -= around;
  place.phi += down;
  camera.position.setFromSpherical(place.makeSafe()).add(target);
  camera.lookAt(target);
}

/**
 * Turns the camera to the side of what it looks at that a direction is towards.
 * @param {OrbitControls} controls
 * @param {THREE.Vector3} direction from the thing to the camera, in the world
 */
export function orbitTo({ object: camera, target }, direction) {
  const distance = camera.position.distanceTo(target);
  const place = new THREE.Spherical().setFromVector3(direction);
  place.phi = THREE.MathUtils.clamp(place.phi, STEP, Math.PI - STEP); // straight from above nobody knows what is in front
  camera.position.setFromSpherical(place.makeSafe()).setLength(distance).add(target);
  camera.lookAt(target);
}

/**
 * @param {OrbitControls} controls
 * @param {number} factor of the distance
 */
function zoom({ object: camera, target }, factor) {
  camera.position.sub(target).multiplyScalar(factor).add(target);
}

/** @param {OrbitControls} controls */
function viewText({ object: camera, target }) {
  const { x, y, z } = camera.position.clone().sub(target).normalize();
  const side = SIDES[(Math.round(Math.atan2(x, z) / (Math.PI / 4)) + SIDES.length) % SIDES.length];
  const height = y > ABOVE ? t(', from above') : y < BELOW ? t(', from below') : '';
  return `${t('Seen from {side}', { side })}${height}.`;
}
