// Hit tests: which item of the scene a hand touches, or a ray points at.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @import { LoadedItem } from './scene-item.js' */
/** @typedef {{ item: LoadedItem, point: THREE.Vector3, distance: number }} Hit with a point in the world, in metres */

const REACH_M = 0.06; // a hand this near to an item's box takes it without pointing

/**
 * Makes a raycaster's ray that of a hand, which points along its -z.
 * @param {THREE.Raycaster} raycaster
 * @param {THREE.Object3D} hand
 */
export function aimRay({ ray }, { matrixWorld }) {
  ray.origin.setFromMatrixPosition(matrixWorld);
  ray.direction.set(0, 0, -1).transformDirection(matrixWorld);
}

/**
 * Finds the item whose box a point in the world is in, or next to.
 * @param {LoadedItem[]} items
 * @param {THREE.Vector3} point
 * @returns {LoadedItem | null}
 */
export function findTouchedItem(items, point) {
  /** @param {LoadedItem} item */
  const distanceTo = (item) => {
    const local = item.group.worldToLocal(point.clone());
    return item.box.distanceToPoint(local) * item.group.matrixWorld.getMaxScaleOnAxis();
  };
  const distances = withMesh(items).map((item) => ({ item, distance: distanceTo(item) }));
  const [nearest] = distances.sort((one, other) => one.distance - other.distance);
  return nearest && nearest.distance < REACH_M ? nearest.item : null;
}

/**
 * Finds the first item that a ray hits: by its mesh, or else by its box, because scans have holes.
 * @param {LoadedItem[]} items
 * @param {THREE.Raycaster} raycaster
 * @returns {Hit | null}
 */
export function pickItem(items, raycaster) {
  /** @param {(item: LoadedItem, raycaster: THREE.Raycaster) => Hit | null} test */
  const firstHit = (test) => {
    const hits = withMesh(items).flatMap((item) => test(item, raycaster) ?? []);
    return hits.sort((one, other) => one.distance - other.distance).at(0);
  };
  return firstHit(hitMesh) ?? firstHit(hitBox) ?? null;
}

/**
 * Distance in metres to the first box that a ray hits: fast enough for every frame.
 * @param {LoadedItem[]} items
 * @param {THREE.Raycaster} raycaster
 * @returns {number | null}
 */
export function distanceToFirstBox(items, raycaster) {
  const hits = withMesh(items).flatMap((item) => hitBox(item, raycaster) ?? []);
  return hits.length ? Math.min(...hits.map((hit) => hit.distance)) : null;
}

/** @param {LoadedItem[]} items */
const withMesh = (items) => items.filter((item) => item.model?.coarsest);

/**
 * @param {LoadedItem} item
 * @param {THREE.Raycaster} raycaster
 * @returns {Hit | null}
 */
function hitMesh(item, raycaster) {
  const mesh = item.model.coarsest;
  const [hit] = mesh ? raycaster.intersectObject(mesh, true) : [];
  return hit ? { item, point: hit.point, distance: hit.distance } : null;
}

/**
 * @param {LoadedItem} item
 * @param {THREE.Raycaster} raycaster
 * @returns {Hit | null}
 */
function hitBox(item, raycaster) {
  const ray = raycaster.ray.clone().applyMatrix4(item.group.matrixWorld.clone().invert());
  const point = ray.intersectBox(item.box, new THREE.Vector3());
  if (!point) return null;
  point.applyMatrix4(item.group.matrixWorld);
  return { item, point, distance: point.distanceTo(raycaster.ray.origin) };
}
