// The frame of a capture, in which a recipe's places are, and that of the version on the page, in which things are drawn: docs/edits.md.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @import { CropBox, MeasuredLength, Triple } from '../shared/types.d.ts' */

/** @typedef {{ middle: THREE.Vector3, turn: THREE.Quaternion, size: THREE.Vector3 }} Box in the asset frame, metres */

const DIGITS = 9; // of a recipe's numbers: a tenth of a micrometre in a hall

/** Converts between the capture frame and the asset frame of one version. */
export class CaptureFrame {
  /** @param {number[]} rows the manifest's `capture_to_asset`, a (4,4) matrix row by row */
  constructor(rows) {
    this.toAsset = new THREE.Matrix4().fromArray(rows).transpose();
    this.toCapture = this.toAsset.clone().invert();
    this.turn = new THREE.Quaternion();
    const scale = new THREE.Vector3();
    this.toAsset.decompose(new THREE.Vector3(), this.turn, scale);
    this.metres = scale.x; // metres per unit of the capture
  }

  /** @param {Triple} place of the capture */
  placeToAsset(place) {
    return new THREE.Vector3(...place).applyMatrix4(this.toAsset);
  }

  /** @param {THREE.Vector3} place in the asset frame */
  placeToCapture(place) {
    return triple(place.clone().applyMatrix4(this.toCapture));
  }

  /** @param {Triple} direction of the capture */
  directionToAsset(direction) {
    return new THREE.Vector3(...direction).applyQuaternion(this.turn).normalize();
  }

  /** @param {THREE.Vector3} direction in the asset frame */
  directionToCapture(direction) {
    return triple(direction.clone().applyQuaternion(this.turn.clone().invert()));
  }

  /**
   * @param {CropBox} crop
   * @returns {Box}
   */
  boxToAsset({ centre, size, rotation = [0, 0, 0, 1] }) {
    return {
      middle: this.placeToAsset(centre),
      turn: this.turn.clone().multiply(new THREE.Quaternion(...rotation).normalize()),
      size: new THREE.Vector3(...size).multiplyScalar(this.metres),
    };
  }

  /**
   * @param {Box} box
   * @returns {CropBox}
   */
  boxToCapture({ middle, turn, size }) {
    const { x, y, z, w } = this.turn.clone().invert().multiply(turn);
    return {
      centre: this.placeToCapture(middle),
      size: triple(size.clone().divideScalar(this.metres)),
      rotation: [round(x), round(y), round(z), round(w)],
    };
  }

  /**
   * @param {THREE.Vector3[]} ends two, in the asset frame
   * @param {number} metres between them
   * @returns {MeasuredLength}
   */
  lengthToCapture([start, end], metres) {
    return { start: this.placeToCapture(start), end: this.placeToCapture(end), metres };
  }
}

/**
 * @param {THREE.Vector3} vector
 * @returns {Triple}
 */
function triple({ x, y, z }) {
  return [round(x), round(y), round(z)];
}

/** @param {number} value */
const round = (value) => Number(value.toPrecision(DIGITS));
