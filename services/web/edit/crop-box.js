// The crop box: its edges and six handles, one for each face, dragged by a finger or set by sliders.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @import { Box } from '../graphics/capture-frame.js' */

const HANDLE_SHARE = 0.016; // radius of a handle, of the distance to the camera
const TOUCH = 2.6; // a finger is larger than a handle: how much larger the part is that it hits
const LEAST_SHARE = 0.01; // shortest edge, of the longest edge that the sliders allow
const ROOM = 0.1; // that the sliders give beyond the thing, of its size
const COLOURS = [0xd6453d, 0x2f9e44, 0x2457d6]; // of the axes x, y, z

/** A box along its own axes, from `low` to `high`, in metres from an origin that does not move. */
export class CropBoxTool {
  object = new THREE.Group();
  #origin = new THREE.Vector3();
  #turn = new THREE.Quaternion();
  #low = new THREE.Vector3();
  #high = new THREE.Vector3();
  #least = new THREE.Vector3(); // of the sliders
  #most = new THREE.Vector3();
  #edges;
  /** @type {THREE.Mesh[]} */
  #handles;

  constructor() {
    const cube = new THREE.BoxGeometry();
    this.#edges = new THREE.LineSegments(
      new THREE.EdgesGeometry(cube),
      new THREE.LineBasicMaterial({ color: 0x2457d6 }),
    );
    this.#handles = [0, 1, 2, 3, 4, 5].map(createHandle);
    this.object.add(this.#edges, ...this.#handles);
    this.object.visible = false;
  }

  /** The box in the asset frame; null where there is none. */
  get box() {
    if (!this.object.visible) return null;
    const middle = this.#low.clone().add(this.#high).multiplyScalar(0.5);
    return {
      middle: middle.applyQuaternion(this.#turn).add(this.#origin),
      turn: this.#turn.clone(),
      size: this.#high.clone().sub(this.#low),
    };
  }

  /**
   * Shows a box, or hides it.
   * @param {Box | null} box
   * @param {THREE.Box3} bounds of the thing, asset frame: the sliders reach a little beyond it
   */
  show(box, bounds) {
    this.object.visible = box !== null;
    if (!box) return;
    this.#origin.copy(box.middle);
    this.#turn.copy(box.turn);
    this.#high.copy(box.size).multiplyScalar(0.5);
    this.#low.copy(this.#high).negate();
    const back = this.#turn.clone().invert();
    const around = new THREE.Box3(this.#low.clone(), this.#high.clone());
    for (const corner of cornersOf(bounds)) around.expandByPoint(corner.sub(this.#origin).applyQuaternion(back));
    const room = around.getSize(new THREE.Vector3()).multiplyScalar(ROOM);
    this.#least.copy(around.min).sub(room);
    this.#most.copy(around.max).add(room);
    this.#place();
  }

  /**
   * The place of a side between the ends of its slider, in [0,1].
   * @param {number} side 0 to 5: left, right, bottom, top, back, front
   */
  share(side) {
    const axis = side >> 1;
    const [least, most] = [this.#least.getComponent(axis), this.#most.getComponent(axis)];
    return ((side % 2 ? this.#high : this.#low).getComponent(axis) - least) / (most - least);
  }

  /**
   * Moves a side; the others stay, and it does not pass the one across.
   * @param {number} side
   * @param {number} share
   */
  moveTo(side, share) {
    const axis = side >> 1;
    const [least, most] = [this.#least.getComponent(axis), this.#most.getComponent(axis)];
    this.#set(side, least + share * (most - least));
  }

  /**
   * The side whose handle a ray hits; -1 without one.
   * @param {THREE.Ray} ray in the world
   */
  hit({ origin, direction }) {
    if (!this.object.visible) return -1;
    const distances = this.#handles.map((handle) => {
      const sphere = new THREE.Sphere(
        handle.getWorldPosition(new THREE.Vector3()),
        TOUCH * handle.getWorldScale(new THREE.Vector3()).x,
      );
      return (
        new THREE.Ray(origin, direction).intersectSphere(sphere, new THREE.Vector3())?.distanceTo(origin) ?? Infinity
      );
    });
    const nearest = Math.min(...distances);
    return Number.isFinite(nearest) ? distances.indexOf(nearest) : -1;
  }

  /**
   * Moves a side to where a ray passes closest to its handle's axis.
   * @param {number} side
   * @param {THREE.Ray} ray in the world
   */
  drag(side, ray) {
    const inverse = this.object.matrixWorld.clone().invert();
    const { origin, direction } = ray.clone().applyMatrix4(inverse);
    const axis = new THREE.Vector3().setComponent(side >> 1, 1);
    const start = this.#handles[side].position;
    const slope = axis.dot(direction);
    const steep = 1 - slope * slope;
    if (steep < 0.01) return; // the axis points at the eye: a pixel would be a metre
    const away = start.clone().sub(origin);
    const along = (slope * away.dot(direction) - away.dot(axis)) / steep;
    this.#set(side, (side % 2 ? this.#high : this.#low).getComponent(side >> 1) + along);
  }

  /**
   * Keeps the handles as large as a finger, however far the camera is.
   * @param {THREE.Camera} camera
   */
  scaleHandles(camera) {
    const eye = new THREE.Vector3().setFromMatrixPosition(camera.matrixWorld);
    for (const handle of this.#handles) {
      handle.scale.setScalar(HANDLE_SHARE * handle.getWorldPosition(new THREE.Vector3()).distanceTo(eye));
    }
  }

  /**
   * @param {number} side
   * @param {number} value metres from the origin along the side's axis
   */
  #set(side, value) {
    const axis = side >> 1;
    const [least, most] = [this.#least.getComponent(axis), this.#most.getComponent(axis)];
    const gap = LEAST_SHARE * (most - least);
    if (side % 2) this.#high.setComponent(axis, Math.min(most, Math.max(value, this.#low.getComponent(axis) + gap)));
    else this.#low.setComponent(axis, Math.max(least, Math.min(value, this.#high.getComponent(axis) - gap)));
    this.#place();
  }

  /** Puts edges and handles where the box is. */
  #place() {
    this.object.position.copy(this.#origin);
    this.object.quaternion.copy(this.#turn);
    const middle = this.#low.clone().add(this.#high).multiplyScalar(0.5);
    this.#edges.position.copy(middle);
    this.#edges.scale.copy(this.#high).sub(this.#low);
    this.#handles.forEach((handle, side) => {
      const axis = side >> 1;
      handle.position.copy(middle).setComponent(axis, (side % 2 ? this.#high : this.#low).getComponent(axis));
    });
  }
}

/** @param {number} side */
function createHandle(side) {
  const material = new THREE.MeshBasicMaterial({ color: COLOURS[side >> 1], depthTest: false, transparent: true });
  const handle = new THREE.Mesh(new THREE.SphereGeometry(1, 20, 14), material);
  handle.renderOrder = 3;
  return handle;
}

/** @param {THREE.Box3} box */
export function cornersOf({ min, max }) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map(
    (each) => new THREE.Vector3(each & 1 ? max.x : min.x, each & 2 ? max.y : min.y, each & 4 ? max.z : min.z),
  );
}
