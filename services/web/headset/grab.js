// Grabbing: one hand carries and turns an item, two hands also scale it. A controller's pointer is a hand too.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { SCALES } from '../scenes/saved-placement.js';

/** @import { SceneItem } from '../scenes/scene-item.js' */

/**
 * How an item is held. `from`: the hands' matrices, and `start` the item's, when the hands took hold.
 * @typedef {{ hands: THREE.Object3D[], from: THREE.Matrix4[], start: THREE.Matrix4 }} Grip
 */

const LEAST_DISTANCE_M = 0.02; // between two hands: nearer ones would scale by the noise of tracking

/** Which hands hold which items. */
export class Grabber {
  /** @type {Map<SceneItem, Grip>} */
  #grips = new Map();
  #onRelease;

  /** @param {(item: SceneItem) => void} onRelease is called when the last hand has let go of an item */
  constructor(onRelease) {
    this.#onRelease = onRelease;
  }

  /**
   * A hand takes hold of an item, and lets go of the one that it had.
   * @param {THREE.Object3D} hand
   * @param {SceneItem} item
   */
  grab(hand, item) {
    this.release(hand);
    this.#grip(item, [...(this.#grips.get(item)?.hands ?? []), hand].slice(-2));
  }

  /**
   * A hand lets go of what it holds.
   * @param {THREE.Object3D} hand
   */
  release(hand) {
    const item = this.itemIn(hand);
    if (!item) return;
    this.#grip(
      item,
      this.#handsOn(item).filter((each) => each !== hand),
    );
    if (!this.#grips.has(item)) this.#onRelease(item);
  }

  /**
   * All hands let go of an item. `onRelease` is not called.
   * @param {SceneItem} item
   */
  drop(item) {
    this.#grips.delete(item);
  }

  /**
   * The item that a hand holds.
   * @param {THREE.Object3D} hand
   */
  itemIn(hand) {
    return [...this.#grips.keys()].find((item) => this.#handsOn(item).includes(hand));
  }

  /**
   * How many hands hold an item.
   * @param {SceneItem} item
   */
  handCount(item) {
    return this.#handsOn(item).length;
  }

  /** The items that are held. */
  get items() {
    return [...this.#grips.keys()];
  }

  /** Moves the items after the hands have moved. */
  moveItems() {
    for (const [item, { hands, from, start }] of this.#grips) {
      if (hands.some((hand) => !hand.visible)) continue; // the headset does not see it, and its last place is old
      const now = hands.map((hand) => hand.matrixWorld);
      const move =
        hands.length === 2 ? twoHandMove(from, now, start) : now[0].clone().multiply(from[0].clone().invert());
      setWorldMatrix(item, move.multiply(start));
    }
  }

  /**
   * Turns what a hand holds about the vertical, and pushes it away along the hand's ray, or pulls it near.
   * @param {THREE.Object3D} hand
   * @param {{ turn: number, push_m: number }} by radians and metres
   */
  turnAndPush(hand, { turn, push_m: push }) {
    const item = this.itemIn(hand);
    if (!item || this.handCount(item) !== 1) return;
    const middle = new THREE.Vector3().setFromMatrixPosition(item.group.matrixWorld);
    const ahead = new THREE.Vector3(0, 0, -push).transformDirection(hand.matrixWorld).multiplyScalar(Math.abs(push));
    const rotation = new THREE.Matrix4()
      .makeTranslation(middle.clone().add(ahead))
      .multiply(new THREE.Matrix4().makeRotationY(turn));
    const toOrigin = new THREE.Matrix4().makeTranslation(middle.negate());
    setWorldMatrix(item, rotation.multiply(toOrigin).multiply(item.group.matrixWorld));
    this.#grip(item, [hand]);
  }

  /** @param {SceneItem} item */
  #handsOn(item) {
    return this.#grips.get(item)?.hands ?? [];
  }

  /**
   * Begins to hold an item with these hands, from where all of them are now.
   * @param {SceneItem} item
   * @param {THREE.Object3D[]} hands none lets go of it
   */
  #grip(item, hands) {
    if (hands.length === 0) {
      this.#grips.delete(item);
      return;
    }
    item.group.updateWorldMatrix(true, false);
    const from = hands.map((hand) => hand.matrixWorld.clone());
    this.#grips.set(item, { hands, from, start: item.group.matrixWorld.clone() });
  }
}

/**
 * The similarity that takes the line between two hands from where it was to where it is, within the scales that are allowed.
 * @param {THREE.Matrix4[]} from of both hands
 * @param {THREE.Matrix4[]} now of both hands
 * @param {THREE.Matrix4} start of the item
 */
function twoHandMove(from, now, start) {
  const [a, b, c, d] = [...from, ...now].map((matrix) => new THREE.Vector3().setFromMatrixPosition(matrix));
  const [before, after] = [b.clone().sub(a), d.clone().sub(c)];
  const size = start.getMaxScaleOnAxis();
  const wanted = Math.max(LEAST_DISTANCE_M, after.length()) / Math.max(LEAST_DISTANCE_M, before.length());
  const scale = THREE.MathUtils.clamp(wanted, SCALES[0] / size, SCALES[1] / size);
  const turn = new THREE.Quaternion().setFromUnitVectors(before.normalize(), after.normalize());
  const back = new THREE.Matrix4().makeTranslation(a.add(b).multiplyScalar(-0.5));
  return new THREE.Matrix4()
    .compose(c.add(d).multiplyScalar(0.5), turn, new THREE.Vector3().setScalar(scale))
    .multiply(back);
}

/**
 * Places an item in the world.
 * @param {SceneItem} item
 * @param {THREE.Matrix4} world
 */
function setWorldMatrix({ group }, world) {
  const parent = group.parent?.matrixWorld ?? new THREE.Matrix4();
  parent.clone().invert().multiply(world).decompose(group.position, group.quaternion, group.scale);
  group.scale.setScalar(THREE.MathUtils.clamp(group.scale.x, ...SCALES)); // the axes must not drift apart
  group.updateMatrixWorld();
}
