// Controllers and hands in the headset: how they look, what they grab, and what their buttons do.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { aimRay, distanceToFirstBox, findTouchedItem, pickItem } from '../scenes/hit-test.js';

/** @import { Grabber } from './grab.js' */
/** @import { PressPanel } from './press-panel.js' */
/** @import { Walker } from './walk.js' */
/** @import { LoadedItem } from '../scenes/scene-item.js' */
/** @typedef {'select' | 'squeeze'} Press the trigger or a pinch, and the grip */

/**
 * One of the two inputs.
 * @typedef {object} Input
 * @property {THREE.XRTargetRaySpace} pointer
 * @property {THREE.Line} ray
 * @property {Map<Press, number>} presses since when each is pressed, in milliseconds
 * @property {XRInputSource | null} source null while it is not connected
 * @property {boolean} resetPressed
 * @property {boolean} menuPressed
 * @property {'' | 'press' | 'stick'} aiming at a place to go to, while this is held
 * @property {(visible: boolean) => void} drawHand
 */

/**
 * @typedef {object} XrInputCallbacks
 * @property {() => LoadedItem[]} items what can be pointed at
 * @property {(item: LoadedItem) => boolean} isMovable whether an item may be grabbed
 * @property {Grabber} grabber
 * @property {Walker} walker
 * @property {() => PressPanel[]} panels that a ray can press, in front of all items
 * @property {() => void} onMenu is called for A and X
 * @property {() => void} onTap is called for a trigger or pinch on an item that nobody may move
 * @property {(x: number) => void} onSteer is called in each frame with the right stick's way to the side
 * @property {() => void} onReset is called for B, Y, or a long pinch on nothing
 * @property {() => boolean} showHands whether the wearer's hands must be drawn, because passthrough does not show them
 */

const RAY_M = 2; // of a ray that hits nothing
const RESET_MS = 1500; // a pinch or trigger held on nothing: longer than anyone searches for a thing
const [A_OR_X, B_OR_Y, STICK_X, STICK_Y] = [4, 5, 2, 3]; // places in the gamepad of the WebXR mapping "xr-standard"
const DEAD_ZONE = 0.2; // a thumbstick at rest is not quite at 0
const TURN_PER_S = 1.5; // radians, with the stick pushed to its end
const PUSH_M_PER_S = 0.8;
const AIM_FROM = 0.7; // of the right stick's way forward
const JOINTS = 25; // of a hand in WebXR
const JOINT_M = 0.008; // radius, where the device gives none
const JOINT_SHARE = 0.7; // of the radius: full-size hands would hide what they hold
const COLOUR = 0xdfe5f0; // of rays and hands: visible in front of the floor and of a room
/** @type {Press[]} */
const PRESSES = ['select', 'squeeze'];

/** The two inputs of a headset: controllers or hands. */
export class XrInput {
  #callbacks;
  #inputs;
  #raycaster = new THREE.Raycaster();

  /**
   * @param {THREE.WebGLRenderer} renderer
   * @param {THREE.Scene} scene
   * @param {XrInputCallbacks} callbacks
   */
  constructor(renderer, scene, callbacks) {
    this.#callbacks = callbacks;
    this.#inputs = [0, 1].map((place) => createInput(renderer, scene, place));
    for (const input of this.#inputs) this.#listen(input);
  }

  /**
   * Moves what the hands hold, and reads the buttons. To be called before each frame in a headset.
   * @param {number} seconds since the last frame
   */
  update(seconds) {
    const { items, grabber, panels, walker, onReset, showHands } = this.#callbacks;
    for (const panel of panels()) panel.light(undefined);
    for (const input of this.#inputs) {
      const { pointer, presses, ray, source } = input;
      pointer.updateMatrixWorld();
      input.drawHand(showHands());
      const panel = this.#findPanel(pointer);
      panel?.panel.light(panel.zone);
      ray.scale.z = grabber.itemIn(pointer)
        ? 0.05
        : (panel?.distance ?? (distanceToFirstBox(items(), this.#castRay(pointer)) || RAY_M));
      if (performance.now() - (presses.get('select') ?? Infinity) > RESET_MS) {
        presses.set('select', Infinity);
        onReset();
      }
      if (source?.gamepad) this.#readButtons(input, source.gamepad, seconds);
      if (input.aiming) walker.aim(pointer);
    }
    grabber.moveItems();
  }

  /** Lets go of everything. */
  releaseAll() {
    for (const { pointer } of this.#inputs) this.#callbacks.grabber.release(pointer);
  }

  /** @param {Input} input */
  #listen(input) {
    const { pointer, presses } = input;
    for (const press of PRESSES) {
      pointer.addEventListener(`${press}start`, () => this.#start(input, press));
      pointer.addEventListener(`${press}end`, () => this.#end(input, press));
    }
    pointer.addEventListener('disconnected', () => {
      presses.clear();
      input.aiming = '';
      this.#callbacks.grabber.release(pointer);
    });
  }

  /**
   * @param {Input} input
   * @param {Press} press
   */
  #start(input, press) {
    const { pointer, presses } = input;
    presses.set(press, performance.now());
    if (presses.size > 1) return; // the other finger has grabbed it already
    const panel = press === 'select' ? this.#findPanel(pointer) : undefined;
    if (panel) {
      presses.set(press, Infinity); // never long enough for a reset
      panel.zone?.press();
      return;
    }
    const item = this.#findItem(pointer);
    if (!item) return;
    presses.clear();
    presses.set(press, Infinity); // never long enough for a reset
    if (press === 'select' && item.isWalkable) input.aiming = 'press';
    else if (this.#callbacks.isMovable(item)) this.#callbacks.grabber.grab(pointer, item);
    else if (press === 'select') this.#callbacks.onTap();
  }

  /**
   * @param {Input} input
   * @param {Press} press
   */
  #end(input, press) {
    const { pointer, presses } = input;
    presses.delete(press);
    if (input.aiming === 'press') this.#go(input);
    if (presses.size === 0) this.#callbacks.grabber.release(pointer);
  }

  /**
   * Goes to the place that the input points at.
   * @param {Input} input
   */
  #go(input) {
    input.aiming = '';
    this.#callbacks.walker.go();
  }

  /**
   * The panel that a hand points at, the nearest where there are several.
   * @param {THREE.Object3D} pointer
   */
  #findPanel(pointer) {
    const raycaster = this.#castRay(pointer);
    const hits = this.#callbacks.panels().flatMap((panel) => {
      const hit = panel.hit(raycaster);
      return hit ? [{ panel, ...hit }] : [];
    });
    return hits.sort((one, other) => one.distance - other.distance).at(0);
  }

  /**
   * The item that a hand touches or points at.
   * @param {THREE.Object3D} pointer
   */
  #findItem(pointer) {
    pointer.updateMatrixWorld();
    const here = new THREE.Vector3().setFromMatrixPosition(pointer.matrixWorld);
    const items = this.#callbacks.items();
    return findTouchedItem(items, here) ?? pickItem(items, this.#castRay(pointer))?.item;
  }

  /** @param {THREE.Object3D} pointer */
  #castRay(pointer) {
    aimRay(this.#raycaster, pointer);
    return this.#raycaster;
  }

  /**
   * @param {Input} input
   * @param {Gamepad} gamepad
   * @param {number} seconds since the last frame
   */
  #readButtons(input, { buttons, axes }, seconds) {
    const { grabber, onMenu, onReset, walker } = this.#callbacks;
    const [menu, pressed] = [A_OR_X, B_OR_Y].map((place) => Boolean(buttons[place]?.pressed));
    if (menu && !input.menuPressed) onMenu();
    if (pressed && !input.resetPressed) onReset();
    [input.menuPressed, input.resetPressed] = [menu, pressed];
    const [x, y] = [axes[STICK_X] || 0, axes[STICK_Y] || 0].map((value) => (Math.abs(value) < DEAD_ZONE ? 0 : value));
    const rests = !x && !y;
    if (grabber.itemIn(input.pointer)) {
      if (!rests) {
        grabber.turnAndPush(input.pointer, { turn: x * TURN_PER_S * seconds, push_m: -y * PUSH_M_PER_S * seconds });
      }
    } else if (input.source?.handedness === 'right') this.#steer(input, x, y);
    else if (!rests) walker.walk(x, y, seconds);
  }

  /**
   * The right stick: to the side what `onSteer` does, and forward shows a place to go to, where it goes once the stick is let go.
   * @param {Input} input
   * @param {number} x
   * @param {number} y
   */
  #steer(input, x, y) {
    if (y < -AIM_FROM && !input.aiming) input.aiming = 'stick';
    if (y === 0 && input.aiming === 'stick') this.#go(input);
    if (!input.aiming) this.#callbacks.onSteer(x);
  }
}

/**
 * Adds an input to the scene: a pointer with its ray, the controller, and the joints of a hand, as far as the device tracks them.
 * @param {THREE.WebGLRenderer} renderer
 * @param {THREE.Scene} scene
 * @param {number} place 0 or 1
 * @returns {Input}
 */
function createInput(renderer, scene, place) {
  const pointer = renderer.xr.getController(place);
  const grip = renderer.xr.getControllerGrip(place);
  const hand = renderer.xr.getHand(place);
  const [ray, controller, joints] = [createRay(), createController(), createJoints()];
  /** @param {boolean} visible */
  const drawHand = (visible) => drawJoints(joints, visible ? hand : null);
  /** @type {Input} */
  const input = {
    pointer,
    ray,
    presses: new Map(),
    source: null,
    resetPressed: false,
    menuPressed: false,
    aiming: '',
    drawHand,
  };
  pointer.add(ray);
  grip.add(controller);
  hand.add(joints);
  pointer.addEventListener('connected', ({ data }) => {
    input.source = data;
    ray.visible = data.targetRayMode === 'tracked-pointer';
    controller.visible = ray.visible && !data.hand;
  });
  pointer.addEventListener('disconnected', () => {
    input.source = null;
  });
  scene.add(pointer, grip, hand);
  return input;
}

/** A line from the hand to what it points at. */
function createRay() {
  const geometry = new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3(0, 0, -1)]);
  return new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: COLOUR, transparent: true, opacity: 0.7 }));
}

/** A capsule in place of the controller. */
function createController() {
  const controller = new THREE.Mesh(
    new THREE.CapsuleGeometry(0.018, 0.08, 4, 12),
    new THREE.MeshStandardMaterial({ color: 0x3a3f49 }),
  );
  controller.rotation.x = Math.PI / 2;
  return controller;
}

/** Spheres for the joints of a hand, none of them shown yet. */
function createJoints() {
  const joints = new THREE.InstancedMesh(
    new THREE.SphereGeometry(1, 8, 6),
    new THREE.MeshStandardMaterial({ color: COLOUR }),
    JOINTS,
  );
  joints.count = 0;
  joints.frustumCulled = false; // its spheres are at the hand's joints, not at its own place
  return joints;
}

/**
 * Puts a sphere at each joint: all of a hand in one draw call. None without a hand.
 * @param {THREE.InstancedMesh} mesh
 * @param {THREE.XRHandSpace | null} hand
 */
function drawJoints(mesh, hand) {
  const joints = Object.values(hand?.joints ?? {}).filter((joint) => joint.visible);
  mesh.count = joints.length;
  joints.forEach((joint, place) => {
    const size = new THREE.Vector3().setScalar(JOINT_SHARE * (joint.jointRadius || JOINT_M));
    mesh.setMatrixAt(place, new THREE.Matrix4().compose(joint.position, joint.quaternion, size));
  });
  mesh.instanceMatrix.needsUpdate = true;
}
