// Where somebody begins who enters a large scene: in the open, on its floor, near its middle.
import * as THREE from '../vendor/three-0.187.0.module.js';

const CANDIDATES = 7; // along each side of the inner half of the floor
const EYE_M = 1.5; // above the floor
const ROOM_M = 1; // around the eyes; more of it makes no place better
const DIRECTIONS = [0, 1, 2, 3, 4, 5, 6, 7].map(
  (turn) => new THREE.Vector3(Math.cos((turn * Math.PI) / 4), 0, Math.sin((turn * Math.PI) / 4)),
);
const DOWN = new THREE.Vector3(0, -1, 0);

/**
 * Finds the place on the floor with the most room around it, among equals the one nearest to the middle.
 * @param {THREE.Object3D} mesh of the whole: a coarse one, for 400 rays are cast at most
 * @param {THREE.Box3} box of it, in the world
 * @returns {THREE.Vector3} in the world; the middle of the floor where there is none
 */
export function findStandingPlace(mesh, box) {
  const middle = box.getCenter(new THREE.Vector3()).setY(box.min.y);
  const size = box.getSize(new THREE.Vector3());
  const raycaster = new THREE.Raycaster();
  let best = { place: middle, room: 0, away: Infinity };
  for (let row = 0; row < CANDIDATES; row++) {
    for (let column = 0; column < CANDIDATES; column++) {
      const [x, z] = [row, column].map((number) => (number + 0.5) / CANDIDATES - 0.5);
      const eye = middle.clone().add(new THREE.Vector3((x * size.x) / 2, EYE_M, (z * size.z) / 2));
      const floor = firstHit(raycaster, mesh, eye, DOWN);
      if (!floor) continue;
      const room = Math.min(
        ROOM_M,
        ...DIRECTIONS.map((direction) => firstHit(raycaster, mesh, eye, direction)?.distance ?? Infinity),
      );
      const away = Math.hypot(eye.x - middle.x, eye.z - middle.z);
      if (room > best.room || (room === best.room && away < best.away)) best = { place: floor.point, room, away };
    }
  }
  return best.place;
}

/**
 * @param {THREE.Raycaster} raycaster
 * @param {THREE.Object3D} mesh
 * @param {THREE.Vector3} from
 * @param {THREE.Vector3} direction
 */
function firstHit(raycaster, mesh, from, direction) {
  raycaster.set(from, direction);
  return raycaster.intersectObject(mesh, true).at(0);
}
