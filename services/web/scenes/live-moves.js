// Things that somebody else is moving just now: shown on their way, and at their saved place once it has come or nobody moves them any more.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @import { SceneItem } from './scene-item.js' */
/** @import { Pose } from '../shared/types.d.ts' */
/** @typedef {{ position: THREE.Vector3, rotation: THREE.Quaternion, scale: number, until: number, isLast: boolean }} Goal `until`: when to give up, of performance.now */

const EASE_S = 0.1; // in which a thing comes nearer to its goal by the factor e: as long as from one report to the next
const SILENCE_MS = 3000; // without a report; who holds a thing still reports it every second
const ARRIVAL_MS = 500; // for the rest of the way to the saved place: five times EASE_S

/**
 * @typedef {object} LiveCallbacks
 * @property {(item: SceneItem) => boolean} isHeld whether it is in a hand here: then it goes where that goes
 * @property {() => void} onChange is called with each report, and when a thing has come to its saved place
 */

/** What others are moving. */
export class LiveMoves {
  /** @type {Map<SceneItem, Goal>} */
  #goals = new Map();
  #callbacks;

  /** @param {LiveCallbacks} callbacks */
  constructor(callbacks) {
    this.#callbacks = callbacks;
  }

  /**
   * Whether somebody else is moving an item.
   * @param {SceneItem} item
   */
  has(item) {
    return this.#goals.has(item);
  }

  /**
   * Somebody has moved an item on.
   * @param {SceneItem} item
   * @param {Pose} pose
   */
  hear(item, pose) {
    this.#goals.set(item, goalOf(pose, SILENCE_MS, false));
    this.#callbacks.onChange();
  }

  /**
   * Takes an item to its saved place: that has come, or nobody moves it any more.
   * @param {SceneItem} item
   */
  settle(item) {
    if (item.placed) this.#goals.set(item, goalOf(item.placed, ARRIVAL_MS, true));
    else this.drop(item);
  }

  /**
   * Leaves an item where it is.
   * @param {SceneItem} item
   */
  drop(item) {
    this.#goals.delete(item);
  }

  /**
   * Moves the items on, and returns whether there were any. To be called before each frame.
   * @param {number} seconds since the last frame
   */
  update(seconds) {
    const share = 1 - Math.exp(-seconds / EASE_S);
    for (const [item, goal] of this.#goals) this.#move(item, goal, share);
    return this.#goals.size > 0;
  }

  /**
   * @param {SceneItem} item
   * @param {Goal} goal
   * @param {number} share of the way that is left
   */
  #move(item, { position, rotation, scale, until, isLast }, share) {
    if (this.#callbacks.isHeld(item)) {
      this.drop(item);
      return;
    }
    const { group } = item;
    group.position.lerp(position, share);
    group.quaternion.slerp(rotation, share);
    group.scale.setScalar(THREE.MathUtils.lerp(group.scale.x, scale, share));
    group.updateMatrixWorld();
    if (performance.now() < until) return;
    if (!isLast) this.settle(item);
    else {
      this.drop(item);
      item.place();
      this.#callbacks.onChange();
    }
  }
}

/**
 * @param {Pose} pose
 * @param {number} milliseconds for which it holds
 * @param {boolean} isLast
 * @returns {Goal}
 */
function goalOf({ position_m: position, rotation, scale }, milliseconds, isLast) {
  const turn = new THREE.Quaternion().fromArray(rotation).normalize();
  return {
    position: new THREE.Vector3().fromArray(position),
    rotation: turn,
    scale,
    until: performance.now() + milliseconds,
    isLast,
  };
}
