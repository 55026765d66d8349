// Which way is up: a plane of the thing that lies level, or quarter turns as one sees it. Which way is its front: turns about the vertical.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { element } from '../shared/dom.js';

/** @import { CaptureFrame } from '../graphics/capture-frame.js' */
/** @import { Picked } from '../graphics/picking.js' */
/** @import { Edits } from '../shared/types.d.ts' */

const UP = new THREE.Vector3(0, 1, 0);
const TOWARD = new THREE.Vector3(0, 0, 1); // whoever stands before the thing
const QUARTER = Math.PI / 2;
const SPIN = Math.PI / 12; // about the vertical, by one press
const UPWARDS = 0.1; // from here on a plane's normal looks up: a ceiling's looks down

/** Up and front in the asset frame, and how the thing is turned so that one sees them. */
export class Upright {
  /** @type {THREE.Vector3 | null} */
  up = null; // null: as it was found
  /** @type {THREE.Vector3 | null} */
  front = null; // the same
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
      element(id, HTMLButtonElement).addEventListener('click', () =>
        this.#tip(snapped(axis().transformDirection(this.#camera.matrixWorld)), sign),
      );
    }
    for (const [id, sign] of /** @type {[string, number][]} */ ([
      ['turn-left', -1],
      ['turn-right', 1],
    ])) {
      element(id, HTMLButtonElement).addEventListener('click', () => this.#spin(sign));
    }
    element('upright-reset', HTMLButtonElement).addEventListener('click', () => this.#set(null, null));
  }

  /** Turns the thing so that its up is the page's, and its front looks ahead, as the worker does (asset_frame in asset/manifest.py). */
  get turn() {
    const upright = new THREE.Quaternion().setFromUnitVectors(this.up ?? UP, UP);
    if (!this.front) return upright;
    const { x, z } = this.front.clone().applyQuaternion(upright);
    return new THREE.Quaternion().setFromAxisAngle(UP, -Math.atan2(x, z)).multiply(upright);
  }

  /**
   * @param {Edits} edits
   * @param {CaptureFrame} frame
   */
  show({ up, front }, frame) {
    this.up = up ? frame.directionToAsset(up) : null;
    this.front = front ? frame.directionToAsset(front) : null;
  }

  /**
   * Takes the normal of a plane that lies level. One that is seen from below is a ceiling, or the thing stands on its head.
   * @param {Picked} picked
   */
  choose({ normal }) {
    const seen = normal.clone().applyQuaternion(this.turn);
    this.#set(seen.y < -UPWARDS ? normal.clone().negate() : normal.clone(), this.front);
  }

  /**
   * Tips the thing over. What looks ahead then is its front, where somebody has said which that is.
   * @param {THREE.Vector3} axis in the world
   * @param {number} sign
   */
  #tip(axis, sign) {
    const back = new THREE.Quaternion()
      .setFromAxisAngle(axis, sign * QUARTER)
      .multiply(this.turn)
      .invert();
    this.#set(UP.clone().applyQuaternion(back), this.front && TOWARD.clone().applyQuaternion(back));
  }

  /**
   * Turns the thing about the vertical: what looks ahead then is its front.
   * @param {number} sign counterclockwise from above
   */
  #spin(sign) {
    const back = new THREE.Quaternion()
      .setFromAxisAngle(UP, sign * SPIN)
      .multiply(this.turn)
      .invert();
    this.#set(this.up, TOWARD.clone().applyQuaternion(back));
  }

  /**
   * @param {THREE.Vector3 | null} up
   * @param {THREE.Vector3 | null} front
   */
  #set(up, front) {
    this.up = up?.normalize() ?? null;
    this.front = front?.normalize() ?? null;
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
