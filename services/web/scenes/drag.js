// Dragging things on the page: by mouse, by one finger or two, and by keys. While it is off, the same gestures move the camera.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { pickItem } from './hit-test.js';
import { SCALES } from './saved-placement.js';
import { placeOf } from '../graphics/picking.js';

/** @import { LoadedItem, SceneItem } from './scene-item.js' */
/** @typedef {{ x: number, y: number }} Point on the canvas, in pixels */
/** @typedef {{ item: LoadedItem, plane: THREE.Plane, turning: boolean, moved: boolean }} Drag a drag that goes on, on a plane */

/**
 * @typedef {object} DragCallbacks
 * @property {() => LoadedItem[]} items what can be moved
 * @property {(item: LoadedItem) => void} onDrag is called while an item is being dragged
 * @property {(item: LoadedItem) => void} onDrop is called when an item that was dragged is let go
 * @property {(item: LoadedItem) => void} onMove is called when an item was moved by a key or by scrolling
 * @property {(item: SceneItem) => void} onSelect is called with the item that the keys move from now on
 */

const STEP_M = 0.05; // by one key press
const TURN = Math.PI / 12; // by one key press
const GROWTH = 1.1; // by one key press
const GROWTH_PX = 1 / 800; // natural logarithm of the growth for a pixel of scrolling: a notch is about a tenth
const TURN_PX = 0.01; // radians for a pixel
const LOW_VIEW = 0.2; // sine of the angle between view and floor below which dragging on the floor would jump far

/** Drag controls for all items of a scene, on one canvas. */
export class DragControls {
  #camera;
  #canvas;
  #callbacks;
  #enabled = false;
  /** @type {SceneItem | null} */
  #selected = null; // by the list of the page or by a click
  /** @type {Map<number, Point>} */
  #pointers = new Map(); // where each finger or mouse was last, by the id of the pointer
  /** @type {Drag | null} */
  #drag = null;
  #raycaster = new THREE.Raycaster();

  /**
   * @param {THREE.PerspectiveCamera} camera
   * @param {HTMLCanvasElement} canvas
   * @param {DragCallbacks} callbacks
   */
  constructor(camera, canvas, callbacks) {
    this.#camera = camera;
    this.#canvas = canvas;
    this.#callbacks = callbacks;
    this.#listen('pointerdown', (event) => this.#pointerDown(event));
    this.#listen('pointermove', (event) => this.#pointerMove(event));
    this.#listen('pointerup', (event) => this.#pointerUp(event));
    this.#listen('pointercancel', (event) => this.#pointerUp(event));
    this.#listen('wheel', (event) => this.#scroll(event));
    this.#listen('keydown', (event) => this.#keyDown(event));
    this.#listen('contextmenu', (event) => event.preventDefault());
  }

  /**
   * Switches dragging on or off.
   * @param {boolean} enabled
   */
  enable(enabled) {
    this.#enabled = enabled;
    this.#pointers.clear();
    this.#drag = null;
  }

  /**
   * Whether an item is being dragged.
   * @param {SceneItem} item
   */
  holds(item) {
    return this.#drag?.item === item;
  }

  /**
   * Selects the item that the keys move.
   * @param {SceneItem} item
   */
  select(item) {
    this.#selected = item;
    this.#callbacks.onSelect(item);
  }

  /**
   * Calls a listener while dragging is on, before the controls of the camera get the event.
   * @template {keyof HTMLElementEventMap} K
   * @param {K} kind
   * @param {(event: HTMLElementEventMap[K]) => void} listener
   */
  #listen(kind, listener) {
    this.#canvas.addEventListener(kind, (event) => this.#enabled && listener(event), { capture: true, passive: false });
  }

  /** @param {PointerEvent} event */
  #pointerDown(event) {
    const hit = this.#pick(event);
    if (!hit && !this.#drag) return; // beside everything: this moves the camera
    consume(event);
    this.#canvas.focus();
    this.#canvas.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, pointOf(event));
    if (this.#drag || !hit) return;
    const turning = event.button === 2 || event.ctrlKey;
    this.#drag = { item: hit.item, plane: this.#dragPlane(hit.point, event.shiftKey), turning, moved: false };
    this.select(hit.item);
  }

  /** @param {PointerEvent} event */
  #pointerMove(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!this.#drag || !before) return;
    consume(event);
    const now = pointOf(event);
    const others = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, point]) => point);
    if (others.length > 0) scaleAndTurn(this.#drag.item, before, now, others[0]);
    else if (this.#drag.turning) turn(this.#drag.item, (now.x - before.x) * TURN_PX);
    else this.#slide(this.#drag, before, now);
    this.#pointers.set(event.pointerId, now);
    this.#drag.moved = true;
    this.#callbacks.onDrag(this.#drag.item);
  }

  /** @param {PointerEvent} event */
  #pointerUp(event) {
    if (!this.#pointers.delete(event.pointerId) || !this.#drag) return;
    consume(event);
    if (this.#pointers.size > 0) return;
    const { item, moved } = this.#drag;
    this.#drag = null;
    if (moved) this.#callbacks.onDrop(item);
  }

  /** @param {WheelEvent} event */
  #scroll(event) {
    const hit = this.#pick(event);
    if (!hit) return;
    consume(event);
    this.select(hit.item);
    scale(hit.item, Math.exp(-event.deltaY * GROWTH_PX));
    this.#callbacks.onMove(hit.item);
  }

  /** @param {KeyboardEvent} event */
  #keyDown(event) {
    const items = this.#callbacks.items();
    const item = items.find((each) => each === this.#selected) ?? items[0];
    const action = KEYS[event.key];
    if (!item || !action || event.altKey || event.ctrlKey || event.metaKey) return;
    consume(event);
    action(item, this.#camera);
    this.#callbacks.onMove(item);
  }

  /**
   * Moves an item along the plane of its drag.
   * @param {Drag} drag
   * @param {Point} before
   * @param {Point} now
   */
  #slide({ item, plane }, before, now) {
    const from = this.#castRay(before).ray.intersectPlane(plane, new THREE.Vector3());
    const to = this.#castRay(now).ray.intersectPlane(plane, new THREE.Vector3());
    if (from && to) item.group.position.add(to.sub(from));
  }

  /** @param {Point} point */
  #pick(point) {
    return pickItem(this.#callbacks.items(), this.#castRay(point));
  }

  /**
   * The ray from the camera through a point of the canvas.
   * @param {Point} point
   */
  #castRay({ x, y }) {
    this.#raycaster.setFromCamera(placeOf({ clientX: x, clientY: y }, this.#canvas), this.#camera);
    return this.#raycaster;
  }

  /**
   * The plane to drag on: level, or facing the camera in order to lift the item and where the camera looks along the floor.
   * @param {THREE.Vector3} point on the plane
   * @param {boolean} lifting
   */
  #dragPlane(point, lifting) {
    const view = this.#camera.getWorldDirection(new THREE.Vector3());
    const upright = lifting || Math.abs(view.y) < LOW_VIEW;
    const normal = upright ? view.setY(0).normalize() : new THREE.Vector3(0, 1, 0);
    return new THREE.Plane().setFromNormalAndCoplanarPoint(normal, point);
  }
}

/** @type {Record<string, (item: LoadedItem, camera: THREE.Camera) => void>} */
const KEYS = {
  ArrowLeft: (item, camera) => step(item, camera, -1, 0),
  ArrowRight: (item, camera) => step(item, camera, 1, 0),
  ArrowUp: (item, camera) => step(item, camera, 0, 1),
  ArrowDown: (item, camera) => step(item, camera, 0, -1),
  PageUp: ({ group }) => (group.position.y += STEP_M),
  PageDown: ({ group }) => (group.position.y -= STEP_M),
  ',': (item) => turn(item, TURN),
  '.': (item) => turn(item, -TURN),
  '+': (item) => scale(item, GROWTH),
  '-': (item) => scale(item, 1 / GROWTH),
};

/**
 * Scales and turns an item with two fingers: one moves, the other rests.
 * @param {LoadedItem} item
 * @param {Point} before of the finger that moves
 * @param {Point} now of the finger that moves
 * @param {Point} rest the other finger
 */
function scaleAndTurn(item, before, now, rest) {
  const [from, to] = [before, now].map((point) => ({ x: point.x - rest.x, y: point.y - rest.y }));
  scale(item, Math.hypot(to.x, to.y) / Math.max(1, Math.hypot(from.x, from.y)));
  turn(item, Math.atan2(from.y, from.x) - Math.atan2(to.y, to.x));
}

/**
 * Moves an item one step on the floor, as the camera sees it.
 * @param {LoadedItem} item
 * @param {THREE.Camera} camera
 * @param {number} right steps
 * @param {number} away steps
 */
function step({ group }, camera, right, away) {
  const ahead = camera.getWorldDirection(new THREE.Vector3()).setY(0).normalize();
  const side = new THREE.Vector3(-ahead.z, 0, ahead.x);
  group.position.addScaledVector(side, right * STEP_M).addScaledVector(ahead, away * STEP_M);
}

/**
 * @param {LoadedItem} item
 * @param {number} angle radians about the vertical
 */
function turn({ group }, angle) {
  group.quaternion.premultiply(new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 1, 0), angle));
}

/**
 * @param {LoadedItem} item
 * @param {number} factor
 */
function scale({ group }, factor) {
  group.scale.setScalar(THREE.MathUtils.clamp(group.scale.x * factor, ...SCALES));
}

/**
 * @param {Point} event
 * @returns {Point}
 */
function pointOf({ x, y }) {
  return { x, y };
}

/**
 * Keeps an event from the controls of the camera and from the browser.
 * @param {Event} event
 */
function consume(event) {
  event.preventDefault();
  event.stopImmediatePropagation();
}
