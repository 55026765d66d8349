// Where a thing that somebody adds to a scene stands at first: beside all others on the page, before the wearer in a headset.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { headingOf, middleOf } from './xr-session.js';

/** @import { LoadedItem } from '../scenes/scene-item.js' */

const GAP_M = 0.1; // between it and its neighbour: a hand fits in between
const AHEAD_M = 0.7; // between the wearer and the thing's near side: an arm's length

/**
 * Places a thing to the right of all others, in line with their middle.
 * @param {LoadedItem} item
 * @param {LoadedItem[]} others of the same scene
 */
export function placeBeside(item, others) {
  const box = new THREE.Box3();
  for (const { box: own, group } of others) {
    box.union(own.applyMatrix4(group.matrix.compose(group.position, group.quaternion, group.scale)));
  }
  if (box.isEmpty()) return;
  const [width] = item.entry.size_m;
  item.group.position.set(box.max.x + GAP_M + width / 2, 0, (box.min.z + box.max.z) / 2);
  item.group.updateMatrixWorld();
}

/**
 * Places a thing on the scene's floor before a wearer, with its front to them.
 * @param {LoadedItem} item
 * @param {THREE.ArrayCamera} camera of the headset
 */
export function placeAhead({ entry, group }, camera) {
  const heading = headingOf(camera);
  const root = group.parent;
  if (!heading || !root) return;
  const [, , depth] = entry.size_m;
  const place = middleOf(camera.cameras).addScaledVector(heading, AHEAD_M + depth / 2);
  const { x, z } = root.worldToLocal(place);
  group.position.set(x, 0, z);
  group.quaternion.setFromAxisAngle(new THREE.Vector3(0, 1, 0), Math.atan2(-heading.x, -heading.z) - root.rotation.y);
  group.updateMatrixWorld();
}
