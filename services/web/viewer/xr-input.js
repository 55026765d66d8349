// Controllers and hands in the headset: what they look like, what they take hold of, and what their buttons do.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { met, metBox, within } from './hit-test.js';

const RAY_M = 2; // of a ray that meets nothing
const RESET_MS = 1500; // a pinch or trigger held on nothing: longer than anyone searches for a thing
const [B_OR_Y, STICK_X, STICK_Y] = [5, 2, 3]; // places in the gamepad of the WebXR mapping "xr-standard"
const DEAD = 0.2; // a thumbstick at rest is not quite at rest
const TURN_PER_S = 1.5; // radians, the stick pushed to its end
const PUSH_M_PER_S = 0.8;
const JOINTS = 25; // of a hand in WebXR
const JOINT_M = 0.008; // radius, where the device tells none
const SLIM = 0.7; // of the radius: a hand of whole ones would hide what it holds
const INK = 0xdfe5f0; // of rays and hands: seen against the floor and against a room

/**
 * Two inputs in the scene. Returns {tick(seconds), letGo()}; tick is called in each frame of a session.
 * pieces(): what there is to take; grasp: of grab.js; onReset(): asked for by B, by Y, or by a long pinch on nothing;
 * ownHands(): whether the wearer's hands must be drawn, because passthrough does not show them.
 */
export function makeHands(renderer, scene, { pieces, grasp, onReset, ownHands }) {
  const hands = [0, 1].map((place) => handOf(renderer, scene, place));
  const caster = new THREE.Raycaster();

  for (const { pointer, pressed } of hands) {
    for (const kind of ['select', 'squeeze']) {
      pointer.addEventListener(`${kind}start`, () => press(pointer, pressed, kind));
      pointer.addEventListener(`${kind}end`, () => release(pointer, pressed, kind));
    }
    pointer.addEventListener('disconnected', () => {
      pressed.clear();
      grasp.letGo(pointer);
    });
  }

  function press(pointer, pressed, kind) {
    pressed.set(kind, performance.now());
    if (pressed.size > 1) return; // the other finger has taken it already
    const piece = meant(pointer);
    if (piece) {
      pressed.clear();
      pressed.set(kind, Infinity); // never long enough for a reset
      grasp.take(pointer, piece);
    }
  }

  function release(pointer, pressed, kind) {
    pressed.delete(kind);
    if (pressed.size === 0) grasp.letGo(pointer);
  }

  function meant(pointer) {
    pointer.updateMatrixWorld();
    const here = new THREE.Vector3().setFromMatrixPosition(pointer.matrixWorld);
    return within(pieces(), here) || met(pieces(), aimed(pointer))?.piece;
  }

  function aimed(pointer) {
    caster.ray.origin.setFromMatrixPosition(pointer.matrixWorld);
    caster.ray.direction.set(0, 0, -1).transformDirection(pointer.matrixWorld);
    return caster;
  }

  function tick(seconds) {
    for (const hand of hands) {
      const { pointer, pressed, source } = hand;
      pointer.updateMatrixWorld();
      hand.bend(ownHands());
      hand.ray.scale.z = grasp.heldBy(pointer) ? 0.05 : metBox(pieces(), aimed(pointer)) || RAY_M;
      if (performance.now() - pressed.get('select') > RESET_MS) {
        pressed.set('select', Infinity);
        onReset();
      }
      if (source()?.gamepad) buttons(hand, source().gamepad, seconds);
    }
    grasp.carry();
  }

  function buttons(hand, { buttons: all, axes }, seconds) {
    const reset = Boolean(all[B_OR_Y]?.pressed);
    if (reset && !hand.reset) onReset();
    hand.reset = reset;
    const [across, along] = [axes[STICK_X] || 0, axes[STICK_Y] || 0].map((value) => (Math.abs(value) < DEAD ? 0 : value));
    if (across || along) grasp.nudge(hand.pointer, { turn: across * TURN_PER_S * seconds, push_m: -along * PUSH_M_PER_S * seconds });
  }

  return { tick, letGo: () => hands.forEach(({ pointer }) => grasp.letGo(pointer)) };
}

/** A pointer with its ray, the controller's body, and the joints of a hand, as far as the device tracks them. */
function handOf(renderer, scene, place) {
  const pointer = renderer.xr.getController(place);
  const grip = renderer.xr.getControllerGrip(place);
  const joints = renderer.xr.getHand(place);
  const ray = rayMade();
  const body = bodyMade();
  const knuckles = knucklesMade();
  let source = null;
  pointer.add(ray);
  grip.add(body);
  joints.add(knuckles);
  pointer.addEventListener('connected', ({ data }) => {
    source = data;
    ray.visible = data.targetRayMode === 'tracked-pointer';
    body.visible = ray.visible && !data.hand;
  });
  pointer.addEventListener('disconnected', () => {
    source = null;
  });
  scene.add(pointer, grip, joints);
  return { pointer, ray, pressed: new Map(), source: () => source, reset: false, bend: (drawn) => bend(knuckles, drawn ? joints : null) };
}

function rayMade() {
  const geometry = new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3(0, 0, -1)]);
  return new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: INK, transparent: true, opacity: 0.7 }));
}

function bodyMade() {
  const body = new THREE.Mesh(new THREE.CapsuleGeometry(0.018, 0.08, 4, 12), new THREE.MeshStandardMaterial({ color: 0x3a3f49 }));
  body.rotation.x = Math.PI / 2;
  return body;
}

function knucklesMade() {
  const made = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 8, 6), new THREE.MeshStandardMaterial({ color: INK }), JOINTS);
  made.count = 0;
  made.frustumCulled = false; // it is where the joints are, not where it stands
  return made;
}

/** Put a sphere at every joint: all of a hand in one draw call. None without a hand. */
function bend(knuckles, hand) {
  const joints = Object.values(hand?.joints || {}).filter((joint) => joint.visible);
  knuckles.count = joints.length;
  joints.forEach((joint, place) => {
    const size = new THREE.Vector3().setScalar(SLIM * (joint.jointRadius || JOINT_M));
    knuckles.setMatrixAt(place, new THREE.Matrix4().compose(joint.position, joint.quaternion, size));
  });
  knuckles.instanceMatrix.needsUpdate = true;
}
