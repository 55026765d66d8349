// One thing in a scene: where it stands, what is shown there, and how far away it is. Versions come and go; the place stays.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { forget, remember, remembered } from './saved-placement.js';
import { Model } from '../graphics/model.js';
import { dispose } from '../graphics/scene.js';

const HALF_VIEW = Math.tan(Math.PI / 8); // half the height of a view of 45 degrees, one metre ahead
const NEAR_M = 0.01; // whoever stands inside a thing sees all of it

export class Piece {
  entry = null;
  model = null;
  loaded = [];
  problem = ''; // what was last said of it
  code = ''; // of the problem
  #hints = null;

  constructor(key) {
    this.key = key;
    this.group = new THREE.Group(); // in the frame of the scene's root: its floor, in metres
    this.home = new THREE.Vector3(); // where it stands by itself
  }

  get name() {
    return this.entry?.label || this.key;
  }

  /**
   * Load a version and show it in place of the one before, which stays until then; renderer, prepare: of model.js; `onChange()`
   * hears of each level. Throws what loading throws.
   */
  async show(entry, renderer, { prepare, onChange }) {
    const loaded = [];
    const model = new Model(entry, renderer, { prepare, onLevel: (level) => onChange(loaded.push(level)) });
    try {
      await model.start();
    } catch (problem) {
      model.dispose();
      throw problem;
    }
    this.showHints(null);
    this.model?.dispose();
    Object.assign(this, { entry, model, loaded });
    this.group.add(model.object);
  }

  /** Points that stand for the thing while nothing else does; null takes them away. */
  showHints(points) {
    if (this.#hints) {
      this.#hints.removeFromParent();
      dispose(this.#hints);
    }
    this.#hints = points;
    if (points) this.group.add(points);
  }

  /** Take it out of the scene, with all its memory. */
  remove() {
    this.showHints(null);
    this.model?.dispose();
    this.model = null;
    this.group.removeFromParent();
  }

  /** Its box in the frame of its group, as (3,) metres from and to. */
  get box() {
    const [width, height, depth] = this.entry.size_m;
    return new THREE.Box3(new THREE.Vector3(-width / 2, 0, -depth / 2), new THREE.Vector3(width / 2, height, depth / 2));
  }

  /** Share of the view's height that its diameter takes, seen from `eye` in the world. */
  share(eye) {
    const [width, height, depth] = this.entry.size_m;
    const middle = new THREE.Vector3(0, height / 2, 0).applyMatrix4(this.group.matrixWorld);
    const diameter = Math.hypot(width, height, depth) * this.group.matrixWorld.getMaxScaleOnAxis();
    return diameter / (2 * HALF_VIEW * Math.max(NEAR_M, eye.distanceTo(middle)));
  }

  /** Put it where it was left, or where it stands by itself. */
  place() {
    const { offset_m: offset, turn, scale } = remembered(this.key) || { offset_m: [0, 0, 0], turn: [0, 0, 0, 1], scale: 1 };
    this.group.position.fromArray(offset).add(this.home);
    this.group.quaternion.fromArray(turn);
    this.group.scale.setScalar(scale);
    this.group.updateMatrixWorld();
  }

  /** Remember where it stands now. */
  leave() {
    const offset = this.group.position.clone().sub(this.home);
    remember(this.key, { offset_m: offset.toArray(), turn: this.group.quaternion.toArray(), scale: this.group.scale.x });
  }

  reset() {
    forget([this.key]);
    this.place();
  }
}
