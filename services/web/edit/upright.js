// Which way is up: a plane of the thing that lies level, or quarter turns as one sees it.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { element } from '../shared/dom.js';

/** @import { CaptureFrame } from '../graphics/capture-frame.js' */
/** @import { Picked } from '../graphics/picking.js' */
/** @import { Triple } from '../shared/types.d.ts' */

const UP = new THREE.Vector3(0, 1, 0);
const QUARTER = Math.PI / 2;
const UPWARDS = 0.1; // from here on a plane's normal looks up: a ceiling's looks down

/** Up in the asset frame, and how the thing is turned so that one sees it. */
export class Upright {
  /** @type {THREE.Vector3 | null} */
  up = null; // null: as it was found
  #onChange;
  #camera;

  /**
   * @param {THREE.Camera} camera
   * @param {() => void} onChange
   */
  constructor(camera, onChange) {
    this.#camera = camera;
    this.#onChange = onChange;
    const { right, toward } = AXES;
    for (const [id, axis, sign] of /** @type {[string, () => THREE.Vector3, number][]} */ ([
      ['tip-left', toward, 1],
      ['tip-right', toward, -1],
      ['tip-away', right, -1],
      ['tip-near', right, 1],
    ])) {
      element(id, HTMLButtonElement).addEventListener('click', () => this.#tip(snapped(axis().transformDirection(this.#camera.matrixWorld)), sign));
    }
    element('upright-reset', HTMLButtonElement).addEventListener('click', () => this.#set(null));
  }

  /** Turns the thing so that its up is the page's. */
  get turn() {
    return new THREE.Quaternion().setFromUnitVectors(this.up ?? UP, UP);
  }

  /**
   * @param {Triple | null} up of a recipe
   * @param {CaptureFrame} frame
   */
  show(up, frame) {
    this.up = up ? frame.directionToAsset(up) : null;
  }

  /**
   * Takes the normal of a plane that lies level. One that is seen from below is a ceiling, or the thing stands on its head.
   * @param {Picked} picked
   */
  choose({ normal }) {
    const seen = normal.clone().applyQuaternion(this.turn);
    this.#set(seen.y < -UPWARDS ? normal.clone().negate() : normal.clone());
  }

  /**
   * @param {THREE.Vector3} axis in the world
   * @param {number} sign
   */
  #tip(axis, sign) {
    const back = this.turn.invert();
    this.#set(UP.clone().applyAxisAngle(axis, -sign * QUARTER).applyQuaternion(back));
  }

  /** @param {THREE.Vector3 | null} up */
  #set(up) {
    this.up = up?.normalize() ?? null;
    this.#onChange();
  }
}

const AXES = { right: () => new THREE.Vector3(1, 0, 0), toward: () => new THREE.Vector3(0, 0, 1) }; // of the camera

/**
 * The level axis of the world that is nearest to a direction.
 * @param {THREE.Vector3} direction
 */
function snapped({ x, z }) {
  return Math.abs(x) > Math.abs(z) ? new THREE.Vector3(Math.sign(x), 0, 0) : new THREE.Vector3(0, 0, Math.sign(z) || 1);
}
