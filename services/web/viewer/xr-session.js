// The session in a headset: two buttons that begin it, VR and passthrough, and where the scene stands in the room.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { dispose } from '../graphics/scene.js';
import { signOf } from './text-panel.js';

const AHEAD_M = 1.5; // arm's length and a step: the whole of a person-sized thing is in view
const EYE_SHARE = 0.75; // small things are lifted so that their middle is at this share of the eyes' height
const SMALL_M = 0.8; // a thing lower than this would lie at one's feet
const HALL_M = 20; // of the floor's grid, a metre a field
const SIGN_S = 12; // long enough to read two lines, once
const WANTED = { requiredFeatures: ['local-floor'], optionalFeatures: ['hand-tracking'] };
const NAMES = { vr: 'VR', ar: 'AR' };
const HELP = ['Squeeze or pinch to take hold; two hands scale and turn.', 'B, Y, or a long pinch beside it puts it back.'];

/**
 * Offer what the device can on `buttons` {vr, ar}. Returns {tick(), placed()}: tick after each frame.
 * height(): metres of the tallest thing; `onMode('vr' | 'ar' | '')` hears of sessions, `onPlaced(metres)` where the scene
 * stands, `onRefused(error)` of a headset that does not start.
 */
export function offerSessions({ renderer, scene, root }, buttons, { height, onMode, onPlaced, onRefused }) {
  let mode = '';
  let placed = true;
  let sign = null;
  let signUntil = 0;
  const floor = new THREE.GridHelper(HALL_M, HALL_M, 0x59616e, 0x31363f);
  const dusk = new THREE.Color(0x16181c);
  renderer.xr.enabled = true;
  renderer.xr.setReferenceSpaceType('local-floor');

  for (const [kind, button] of Object.entries(buttons)) {
    button.addEventListener('click', async () => {
      const session = renderer.xr.getSession();
      if (session) return session.end();
      button.disabled = true; // a second request while the first is asked for would be refused
      await begin(kind).catch(onRefused);
      button.disabled = false;
    });
  }

  async function begin(kind) {
    const session = await navigator.xr.requestSession(`immersive-${kind}`, WANTED);
    mode = kind; // three.js tells of the start before setSession resolves
    await renderer.xr.setSession(session);
  }

  renderer.xr.addEventListener('sessionstart', () => {
    placed = false;
    // In passthrough the room itself is the background and the floor.
    scene.background = mode === 'vr' ? dusk : null;
    if (mode === 'vr') scene.add(floor);
    named(`Leave ${NAMES[mode]}`);
    onMode(mode);
  });
  renderer.xr.addEventListener('sessionend', () => {
    scene.background = null;
    floor.removeFromParent();
    takeSign();
    root.position.set(0, 0, 0);
    root.rotation.set(0, 0, 0);
    root.updateMatrixWorld(true);
    named(null);
    mode = '';
    onMode('');
  });

  function named(leave) {
    for (const [kind, button] of Object.entries(buttons)) button.textContent = leave || `Enter ${NAMES[kind]}`;
    if (leave) Object.entries(buttons).forEach(([kind, button]) => (button.hidden = kind !== mode));
    else offer();
  }

  async function offer() {
    for (const [kind, button] of Object.entries(buttons)) {
      button.hidden = !(await navigator.xr?.isSessionSupported(`immersive-${kind}`).catch(() => false));
    }
    document.getElementById('headset').hidden = Object.values(buttons).some((button) => !button.hidden);
  }

  function takeSign() {
    if (!sign) return;
    sign.removeFromParent();
    dispose(sign);
    sign = null;
  }

  /** Stand the scene 1.5 m ahead of where the wearer looks, on the floor, or at a comfortable height when it is small. */
  function placeAhead(xrCamera) {
    const eye = between(xrCamera.cameras);
    const ahead = new THREE.Vector3(0, 0, -1).transformDirection(xrCamera.matrixWorld).setY(0);
    if (ahead.lengthSq() < 1e-6) ahead.set(0, 0, -1);
    ahead.normalize();
    const tallest = height();
    root.position.copy(eye).addScaledVector(ahead, AHEAD_M);
    root.position.y = tallest < SMALL_M ? Math.max(0, eye.y * EYE_SHARE - tallest / 2) : 0;
    root.rotation.set(0, Math.atan2(-ahead.x, -ahead.z), 0);
    root.updateMatrixWorld(true);
    putSign(eye, ahead);
    onPlaced(root.position.toArray());
  }

  function putSign(eye, ahead) {
    sign = signOf(HELP);
    sign.position.copy(eye).addScaledVector(ahead, AHEAD_M);
    sign.position.y = eye.y + 0.35; // above what one looks at
    sign.rotation.y = root.rotation.y;
    scene.add(sign);
    signUntil = performance.now() + 1000 * SIGN_S;
  }

  navigator.xr?.addEventListener('devicechange', () => mode || offer());
  offer();
  return {
    tick() {
      if (sign && performance.now() > signUntil) takeSign();
      // After a frame was drawn the headset's pose is known.
      if (placed || !renderer.xr.isPresenting || renderer.xr.getCamera().cameras.length === 0 || height() === 0) return;
      placeAhead(renderer.xr.getCamera());
      placed = true;
    },
    /** The wearer knows by now what the sign says. */
    understood: takeSign,
  };
}

/** The middle between the eyes: three.js puts the camera that stands for both into one of them at first. */
function between(eyes) {
  const sum = new THREE.Vector3();
  for (const eye of eyes) sum.add(new THREE.Vector3().setFromMatrixPosition(eye.matrixWorld));
  return sum.divideScalar(eyes.length);
}
