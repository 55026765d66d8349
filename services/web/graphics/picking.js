// Picks a place on a thing, and the plane around it, where somebody taps, or at a cross by the Enter key.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @typedef {{ point: THREE.Vector3, normal: THREE.Vector3 }} Picked in the frame of the thing; the normal is towards the eye */

const STILL_PX = 8; // a finger that moves farther has turned the view
const AROUND = 0.04; // radius in which faces make the plane, of the thing's size
const ALIKE = 0.7; // least cosine between a face of the plane and the one that was hit

/**
 * Calls back for every tap on a canvas that turns nothing, and for Enter, with the place in the view: x and y from -1 to 1.
 * @param {HTMLCanvasElement} canvas
 * @param {(place: THREE.Vector2) => void} onTap
 * @param {() => THREE.Vector2} [cross] where Enter picks; without it in the middle
 */
export function watchTaps(canvas, onTap, cross = () => new THREE.Vector2()) {
  /** @type {PointerEvent | null} */
  let down = null;
  canvas.addEventListener('pointerdown', (event) => (down = event.isPrimary ? event : null));
  canvas.addEventListener('pointerup', (event) => {
    if (!down || Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) > STILL_PX) return;
    onTap(placeOf(event, canvas));
  });
  canvas.addEventListener('keydown', (event) => {
    if (event.key === 'Enter') onTap(cross());
  });
}

/**
 * The place of a pointer in the view.
 * @param {{ clientX: number, clientY: number }} pointer
 * @param {HTMLElement} canvas
 */
export function placeOf({ clientX, clientY }, canvas) {
  const { left, top, width, height } = canvas.getBoundingClientRect();
  return new THREE.Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
}

/**
 * The first place on what is not cut away that is seen at a place of the view, and the normal of the plane around it.
 * @param {THREE.Object3D} thing
 * @param {THREE.Vector2} place in the view, from -1 to 1
 * @param {THREE.Camera} camera
 * @param {THREE.Plane[]} [clipping] planes in the world; what is behind one is cut away
 * @returns {Picked | null}
 */
export function pick(thing, place, camera, clipping = []) {
  const raycaster = new THREE.Raycaster();
  raycaster.setFromCamera(place, camera);
  const hits = raycaster.intersectObject(thing, true).filter(({ object }) => isShown(object));
  const hit = hits.find(({ point }) => clipping.every((plane) => plane.distanceToPoint(point) >= 0));
  if (!hit || !(hit.object instanceof THREE.Mesh) || !hit.face) return null;
  const size = new THREE.Box3().setFromObject(hit.object).getSize(new THREE.Vector3()).length();
  const normal = planeNormal(hit.object, hit.point, hit.face, AROUND * size);
  if (normal.dot(raycaster.ray.direction) > 0) normal.negate(); // scans have faces on both sides
  const inverse = thing.matrixWorld.clone().invert();
  return { point: hit.point.clone().applyMatrix4(inverse), normal: normal.transformDirection(inverse) };
}

/**
 * Whether an object and all that it is part of are visible.
 * @param {THREE.Object3D} object
 */
export function isShown(object) {
  for (let each = /** @type {THREE.Object3D | null} */ (object); each; each = each.parent) {
    if (!each.visible) return false;
  }
  return true;
}

/**
 * The mean normal of the faces around a place that look the same way, weighted by their area, in the world.
 * @param {THREE.Mesh} mesh
 * @param {THREE.Vector3} point in the world
 * @param {{ normal: THREE.Vector3 }} face that was hit
 * @param {number} radius metres
 */
function planeNormal(mesh, point, face, radius) {
  const toWorld = new THREE.Matrix3().getNormalMatrix(mesh.matrixWorld);
  const first = face.normal.clone().applyMatrix3(toWorld).normalize();
  const [a, b, c] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  const sum = new THREE.Vector3();
  const { index } = mesh.geometry;
  const count = index ? index.count : mesh.geometry.getAttribute('position').count;
  for (let corner = 0; corner + 2 < count; corner += 3) {
    [a, b, c].forEach((vertex, place) =>
      mesh
        .getVertexPosition(index ? index.getX(corner + place) : corner + place, vertex)
        .applyMatrix4(mesh.matrixWorld),
    );
    if (a.distanceTo(point) > radius) continue;
    const area = b.sub(a).cross(c.sub(a)); // twice the area, along the normal
    const cosine = area.dot(first) / (area.length() || 1);
    if (Math.abs(cosine) > ALIKE) sum.addScaledVector(area, Math.sign(cosine));
  }
  return sum.lengthSq() > 0 ? sum.normalize() : first;
}
