// Snapping: what is let go of just above a floor or beside a wall comes to stand on the floor and against the wall.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @import { LoadedItem } from './scene-item.js' */

const FLOOR_M = 0.06; // between a thing's underside and a floor; whoever holds it higher means it
const WALL_M = 0.12; // between a thing's side and a wall
const TILT = Math.cos(Math.PI / 15); // of a thing's own up against the room's: less than 12 degrees is an unsteady hand
const TURN = Math.PI / 9; // between a thing's side and a wall that it turns to
const LEVEL = 0.9; // of a normal's y, from which on a surface is a floor; below the rest of it, a wall
const UP = new THREE.Vector3(0, 1, 0);
const SIDES = [0, 1, 2, 3].map((quarter) => new THREE.Vector3(0, 0, 1).applyAxisAngle(UP, (quarter * Math.PI) / 2));

/**
 * Sets a thing upright that is nearly so, then on the floor and against the wall that are near.
 * @param {LoadedItem} item
 * @param {{ surfaces: THREE.Object3D[], floor: number }} room surfaces: floors and walls; floor: height in the world of the
 *   scene's own, which has no surface
 */
export function snapItem(item, { surfaces, floor }) {
  const raycaster = new THREE.Raycaster();
  const pose = poseOf(item);
  if (UP.clone().applyQuaternion(pose.turn).y < TILT) return; // it is meant to lie
  pose.turn.premultiply(new THREE.Quaternion().setFromUnitVectors(UP.clone().applyQuaternion(pose.turn), UP));
  const [width, height, depth] = item.entry.size_m.map((side) => side * pose.scale.x);
  pose.place.y += stepToFloor(raycaster, surfaces, floor, pose.place);
  const wall = nearestWall(raycaster, surfaces, pose, [width, height, depth]);
  if (wall) {
    pose.turn.premultiply(new THREE.Quaternion().setFromAxisAngle(UP, wall.turn));
    pose.place.addScaledVector(wall.normal, -wall.gap);
  }
  const world = new THREE.Matrix4().compose(pose.place, pose.turn, pose.scale);
  const parent = item.group.parent?.matrixWorld ?? new THREE.Matrix4();
  parent.clone().invert().multiply(world).decompose(item.group.position, item.group.quaternion, item.group.scale);
  item.group.updateMatrixWorld();
}

/** @param {LoadedItem} item */
function poseOf({ group }) {
  const [place, turn, scale] = [new THREE.Vector3(), new THREE.Quaternion(), new THREE.Vector3()];
  group.updateWorldMatrix(true, false);
  group.matrixWorld.decompose(place, turn, scale);
  return { place, turn, scale };
}

/**
 * Metres from a thing's underside up to the nearest floor; 0 where none is near.
 * @param {THREE.Raycaster} raycaster
 * @param {THREE.Object3D[]} surfaces
 * @param {number} floor
 * @param {THREE.Vector3} place of the middle of its underside
 */
function stepToFloor(raycaster, surfaces, floor, place) {
  raycaster.set(place.clone().addScaledVector(UP, FLOOR_M), UP.clone().negate());
  raycaster.far = 2 * FLOOR_M;
  const hits = raycaster.intersectObjects(surfaces, true).filter((hit) => Math.abs(normalOf(hit).y) > LEVEL);
  const steps = hits.map(({ point }) => point.y - place.y);
  if (Math.abs(floor - place.y) < FLOOR_M) steps.push(floor - place.y);
  return steps.sort((one, other) => Math.abs(one) - Math.abs(other)).at(0) ?? 0;
}

/**
 * The wall that is nearest to one of a thing's four sides: its normal, the metres from the side to it, and how far the side must turn to lie on it.
 * @param {THREE.Raycaster} raycaster
 * @param {THREE.Object3D[]} surfaces
 * @param {{ place: THREE.Vector3, turn: THREE.Quaternion }} pose of an upright thing
 * @param {number[]} size width, height and depth in the world
 */
function nearestWall(raycaster, surfaces, { place, turn }, [width, height, depth]) {
  const middle = place.clone().addScaledVector(UP, height / 2);
  const walls = SIDES.flatMap((side, quarter) => {
    const half = (quarter % 2 === 0 ? depth : width) / 2;
    const direction = side.clone().applyQuaternion(turn);
    raycaster.set(middle, direction);
    raycaster.far = half + 2 * WALL_M;
    const hit = raycaster.intersectObjects(surfaces, true).find((each) => Math.abs(normalOf(each).y) < 1 - LEVEL);
    if (!hit) return [];
    const normal = normalOf(hit).setY(0).normalize();
    if (normal.dot(direction) > 0) normal.negate(); // a scan's triangles may face either way
    const against = normal.clone().negate();
    const angle = Math.atan2(direction.clone().cross(against).y, direction.dot(against));
    const gap = middle.clone().sub(hit.point).dot(normal) - half; // once the side lies on the wall
    return Math.abs(gap) < WALL_M && Math.abs(angle) < TURN ? [{ normal, gap, turn: angle }] : [];
  });
  return walls.sort((one, other) => Math.abs(one.gap) - Math.abs(other.gap)).at(0);
}

/**
 * The normal of what was hit, in the world.
 * @param {THREE.Intersection} hit
 */
function normalOf({ face, object }) {
  return (face?.normal.clone() ?? UP.clone()).transformDirection(object.matrixWorld);
}
