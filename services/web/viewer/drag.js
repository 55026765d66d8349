// Moving things on the page: by mouse, by one finger or two, and by keys. Off, the same gestures move the camera.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { met } from './hit-test.js';
import { SCALES } from './saved-placement.js';

const STEP_M = 0.05;
const TURN = Math.PI / 12;
const GROW = 1.1; // by one key press
const WHEEL = 1 / 800; // of a natural logarithm for a pixel of scrolling: a notch is about a tenth
const TURN_PX = 0.01; // radians for a pixel
const FLAT = 0.2; // sine of the angle below which a view along the floor makes dragging on it too wild

/**
 * Returns {on(yes), choose(piece)}. pieces(): what there is to move; `onMoved(piece)` hears when one was let go;
 * `onChosen(piece)` whom the keys mean.
 */
export function makeArranger({ camera, canvas }, { pieces, onMoved, onChosen }) {
  let active = false;
  let chosen = null;
  const fingers = new Map(); // pointer id → its last place on the canvas
  let drag = null; // { piece, plane, turning }
  const caster = new THREE.Raycaster();

  const listen = (kind, does) => canvas.addEventListener(kind, (event) => active && does(event), { capture: true, passive: false });
  listen('pointerdown', down);
  listen('pointermove', move);
  listen('pointerup', up);
  listen('pointercancel', up);
  listen('wheel', wheel);
  listen('keydown', key);
  listen('contextmenu', (event) => event.preventDefault());

  function choose(piece) {
    chosen = piece;
    onChosen(piece);
  }

  function down(event) {
    const hit = met(pieces(), aimed(event));
    if (!hit && !drag) return; // beside everything: the camera's
    mine(event);
    canvas.focus();
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, placeOf(event));
    if (drag) return;
    const turning = event.button === 2 || event.ctrlKey;
    drag = { piece: hit.piece, plane: planeThrough(hit.point, event.shiftKey), turning };
    choose(hit.piece);
  }

  function move(event) {
    const was = fingers.get(event.pointerId);
    if (!drag || !was) return;
    mine(event);
    const now = placeOf(event);
    const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    if (others.length > 0) byTwo(was, now, others[0]);
    else if (drag.turning) turn(drag.piece, (now.x - was.x) * TURN_PX);
    else slide(was, now);
    fingers.set(event.pointerId, now);
  }

  function slide(was, now) {
    const [from, to] = [was, now].map((place) => aimed(place).ray.intersectPlane(drag.plane, new THREE.Vector3()));
    if (from && to) drag.piece.group.position.add(to.sub(from));
  }

  /** The finger that moved scales and turns about the one that rests. */
  function byTwo(was, now, rest) {
    const [before, after] = [was, now].map((place) => ({ x: place.x - rest.x, y: place.y - rest.y }));
    scale(drag.piece, Math.hypot(after.x, after.y) / Math.max(1, Math.hypot(before.x, before.y)));
    turn(drag.piece, Math.atan2(before.y, before.x) - Math.atan2(after.y, after.x));
  }

  function up(event) {
    if (!fingers.delete(event.pointerId) || !drag) return;
    mine(event);
    if (fingers.size > 0) return;
    onMoved(drag.piece);
    drag = null;
  }

  function wheel(event) {
    const hit = met(pieces(), aimed(event));
    if (!hit) return;
    mine(event);
    choose(hit.piece);
    scale(hit.piece, Math.exp(-event.deltaY * WHEEL));
    onMoved(hit.piece);
  }

  function key(event) {
    const piece = chosen || pieces()[0];
    const does = piece && KEYS[event.key];
    if (!does || event.altKey || event.ctrlKey || event.metaKey) return;
    mine(event);
    does(piece, camera);
    onMoved(piece);
  }

  function aimed({ x, y }) {
    const { left, top, width, height } = canvas.getBoundingClientRect();
    caster.setFromCamera(new THREE.Vector2((2 * (x - left)) / width - 1, 1 - (2 * (y - top)) / height), camera);
    return caster;
  }

  /** The floor at this height, or, to lift it and where one looks along the floor, the plane that faces the camera. */
  function planeThrough(point, lifting) {
    const view = camera.getWorldDirection(new THREE.Vector3());
    const upright = lifting || Math.abs(view.y) < FLAT;
    const normal = upright ? view.setY(0).normalize() : new THREE.Vector3(0, 1, 0);
    return new THREE.Plane().setFromNormalAndCoplanarPoint(normal, point);
  }

  return {
    choose,
    on(yes) {
      active = yes;
      fingers.clear();
      drag = null;
    },
  };
}

const KEYS = {
  ArrowLeft: (piece, camera) => step(piece, camera, -1, 0),
  ArrowRight: (piece, camera) => step(piece, camera, 1, 0),
  ArrowUp: (piece, camera) => step(piece, camera, 0, 1),
  ArrowDown: (piece, camera) => step(piece, camera, 0, -1),
  PageUp: (piece) => (piece.group.position.y += STEP_M),
  PageDown: (piece) => (piece.group.position.y -= STEP_M),
  ',': (piece) => turn(piece, TURN),
  '.': (piece) => turn(piece, -TURN),
  '+': (piece) => scale(piece, GROW),
  '-': (piece) => scale(piece, 1 / GROW),
};

/** A step on the floor, to the right and away as the camera sees it. */
function step(piece, camera, right, away) {
  const ahead = camera.getWorldDirection(new THREE.Vector3()).setY(0).normalize();
  const beside = new THREE.Vector3(-ahead.z, 0, ahead.x);
  piece.group.position.addScaledVector(beside, right * STEP_M).addScaledVector(ahead, away * STEP_M);
}

function turn(piece, angle) {
  piece.group.quaternion.premultiply(new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 1, 0), angle));
}

function scale(piece, factor) {
  piece.group.scale.setScalar(THREE.MathUtils.clamp(piece.group.scale.x * factor, ...SCALES));
}

function placeOf({ x, y }) {
  return { x, y };
}

function mine(event) {
  event.preventDefault();
  event.stopImmediatePropagation();
}
