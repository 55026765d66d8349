// Walking in the headset: by thumbstick, by turns of 30 degrees, and by going to a place on a surface that the wearer points at (teleport).
// It is the scene that moves: the wearer stays in the middle of their own room.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { StickPush } from './stick-push.js';
import { headingOf, middleOf } from './xr-session.js';
import { aimRay } from '../scenes/hit-test.js';

const WALK_M_PER_S = 1.4; // a walk; faster makes people sick
const TURN = Math.PI / 6; // at once: turning smoothly makes people sick too
const REACH_M = 12; // of the ray
const LEAST_UP = 0.7; // of a surface's normal: one can stand on what is less steep than 45 degrees
const MARK_M = 0.25;
const LIFT_M = 0.02; // of the mark, above the surface
const AIM_MS = 50; // between two looks for the surface: a tile has thousands of triangles

/** Moves the scene around a wearer. */
export class Walker {
  #renderer;
  #root;
  #callbacks;
  #mark = createMark();
  #raycaster = new THREE.Raycaster();
  #push = new StickPush();
  #lookedAt = 0;

  /**
   * @param {THREE.WebGLRenderer} renderer
   * @param {THREE.Scene} scene
   * @param {THREE.Object3D} root what moves
   * @param {{ surfaces: () => THREE.Object3D[], onMove: () => void }} callbacks surfaces: what one can stand on
   */
  constructor(renderer, scene, root, callbacks) {
    this.#renderer = renderer;
    this.#root = root;
    this.#callbacks = callbacks;
    this.#raycaster.far = REACH_M;
    scene.add(this.#mark);
  }

  /**
   * Walks where the wearer looks, or to the side.
   * @param {number} x of the thumbstick: -1 left, 1 right
   * @param {number} y of the thumbstick: -1 forward, 1 back
   * @param {number} seconds since the last frame
   */
  walk(x, y, seconds) {
    const ahead = headingOf(this.#renderer.xr.getCamera());
    if (!ahead) return;
    const right = new THREE.Vector3(-ahead.z, 0, ahead.x);
    const step = ahead
      .multiplyScalar(-y)
      .addScaledVector(right, x)
      .multiplyScalar(WALK_M_PER_S * seconds);
    this.#root.position.sub(step);
    this.#moved();
  }

  /**
   * Turns by 30 degrees, once for each push of the stick.
   * @param {number} x of the thumbstick: -1 left, 1 right
   */
  steer(x) {
    const push = this.#push.read(x);
    if (push === 0) return;
    const eye = this.#eye();
    const angle = push * TURN; // the wearer to the right is the scene to the left
    this.#root.position
      .sub(eye)
      .applyAxisAngle(new THREE.Vector3(0, 1, 0), angle)
      .add(eye);
    this.#root.rotation.y += angle;
    this.#moved();
  }

  /**
   * Marks the place that a hand points at, where one can stand there.
   * @param {THREE.Object3D} pointer
   */
  aim(pointer) {
    if (performance.now() - this.#lookedAt < AIM_MS) return;
    this.#lookedAt = performance.now();
    aimRay(this.#raycaster, pointer);
    const [hit] = this.#raycaster.intersectObjects(this.#callbacks.surfaces(), true);
    const up = hit?.face?.normal.clone().transformDirection(hit.object.matrixWorld).y ?? 0;
    this.#mark.visible = Math.abs(up) > LEAST_UP; // a scan's triangles may face either way
    if (hit) this.#mark.position.copy(hit.point).y += LIFT_M;
  }

  /** Goes to the mark, if there is one, and removes it. */
  go() {
    if (this.#mark.visible) {
      const { x, y, z } = this.#mark.position;
      const eye = this.#eye();
      this.#root.position.add(new THREE.Vector3(eye.x - x, LIFT_M - y, eye.z - z));
      this.#moved();
    }
    this.#mark.visible = false;
    this.#lookedAt = 0;
  }

  #moved() {
    this.#root.updateMatrixWorld(true);
    this.#callbacks.onMove();
  }

  #eye() {
    return middleOf(this.#renderer.xr.getCamera().cameras);
  }
}

/** A ring that lies on the floor. */
function createMark() {
  const geometry = new THREE.RingGeometry(0.7 * MARK_M, MARK_M, 32).rotateX(-Math.PI / 2);
  const mark = new THREE.Mesh(
    geometry,
    new THREE.MeshBasicMaterial({ color: 0x4f8cff, depthTest: false, transparent: true, side: THREE.DoubleSide }),
  );
  mark.visible = false;
  mark.renderOrder = 1; // over the surface that it lies on, which is not quite flat
  return mark;
}
