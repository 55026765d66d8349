// The session in a headset: two buttons that start it, for VR and for passthrough (AR), and where the scene stands in the room.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { dispose } from '../graphics/scene.js';
import { createTextPanel } from '../graphics/text-panel.js';
import { element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @typedef {'vr' | 'ar'} Mode */
/** @typedef {{ renderer: THREE.WebGLRenderer, scene: THREE.Scene, root: THREE.Group }} World root: what is placed in front of the wearer */

/**
 * @typedef {object} XrSessionCallbacks
 * @property {() => number} height of the tallest thing, in metres
 * @property {() => THREE.Vector3 | null} standingPlace where in the scene's frame the wearer begins, when it is large; null: in front of it
 * @property {() => string[]} help what a wearer is told at the beginning, a line each
 * @property {(mode: Mode | '') => void} onMode is called when a session begins, and with '' when it ends
 * @property {(metres: number[]) => void} onPlaced is called with the place of the scene
 * @property {(error: Error) => void} onRefused is called when the headset does not start
 */

const AHEAD_M = 1.5; // a thing as large as a person is in view
const EYE_SHARE = 0.75; // small things are lifted so that their middle is at this share of the eyes' height
const SMALL_M = 0.8; // a thing lower than this would lie at the wearer's feet
const FLOOR_M = 20; // of the floor's grid, a metre for each field
const HELP_S = 12; // long enough to read two lines
const FEATURES = { requiredFeatures: ['local-floor'], optionalFeatures: ['hand-tracking', 'plane-detection'] };
const NAMES = { vr: 'VR', ar: 'AR' };
/** @type {Mode[]} */
const MODES = ['vr', 'ar'];
/** What a wearer does with things. */
export const HELP = [
  t('Squeeze or pinch to take hold; two hands scale and turn.'),
  t('B, Y, or a long pinch beside it puts it back.'),
];
const WALKING_HELP = [
  t('The left stick walks, the right one turns.'),
  t('Point at the floor and pull the trigger, or pinch, to go there.'),
];

/** The session in a headset, and its two buttons. */
export class XrSession {
  #world;
  #buttons;
  #callbacks;
  /** @type {Mode | ''} */
  #mode = '';
  #placed = true;
  /** @type {ReturnType<typeof createTextPanel> | null} */
  #help = null;
  #helpUntil = 0;
  #floor = new THREE.GridHelper(FLOOR_M, FLOOR_M, 0x59616e, 0x31363f);
  #background = new THREE.Color(0x16181c);

  /**
   * Offers the sessions that the device can start.
   * @param {World} world
   * @param {Record<Mode, HTMLButtonElement>} buttons
   * @param {XrSessionCallbacks} callbacks
   */
  constructor(world, buttons, callbacks) {
    this.#world = world;
    this.#buttons = buttons;
    this.#callbacks = callbacks;
    const { xr } = world.renderer;
    xr.enabled = true;
    xr.setReferenceSpaceType('local-floor');
    xr.addEventListener('sessionstart', () => this.#started());
    xr.addEventListener('sessionend', () => this.#ended());
    for (const mode of MODES) buttons[mode].addEventListener('click', () => this.#toggle(mode));
    navigator.xr?.addEventListener('devicechange', () => {
      if (!this.#mode) this.#offer();
    });
    this.#offer();
  }

  /** Places the scene once the headset's pose is known. To be called after each frame. */
  update() {
    const { renderer } = this.#world;
    if (this.#help && performance.now() > this.#helpUntil) this.hideHelp();
    if (this.#placed || !renderer.xr.isPresenting || this.#callbacks.height() === 0) return;
    /** @type {THREE.ArrayCamera} */
    const camera = renderer.xr.getCamera(); // without cameras before the first frame
    if (camera.cameras.length === 0) return;
    this.#placeAhead(camera);
    this.#placed = true;
  }

  /** Places the scene before the wearer again, as at the beginning. */
  placeAgain() {
    this.#placed = false;
  }

  /** Removes the panel with the help. */
  hideHelp() {
    if (!this.#help) return;
    this.#help.removeFromParent();
    dispose(this.#help);
    this.#help = null;
  }

  /**
   * Starts a session, or ends the one that runs.
   * @param {Mode} mode
   */
  async #toggle(mode) {
    const session = this.#world.renderer.xr.getSession();
    if (session) {
      session.end();
      return;
    }
    const button = this.#buttons[mode];
    button.disabled = true; // the browser would refuse a second request
    await this.#start(mode).catch(this.#callbacks.onRefused);
    button.disabled = false;
  }

  /** @param {Mode} mode */
  async #start(mode) {
    if (!navigator.xr) throw new Error(t('this browser has no WebXR'));
    const session = await navigator.xr.requestSession(`immersive-${mode}`, FEATURES);
    this.#mode = mode; // three.js sends 'sessionstart' before setSession resolves
    await this.#world.renderer.xr.setSession(session);
  }

  /** Prepares the scene for the headset. */
  #started() {
    if (!this.#mode) return;
    const { scene } = this.#world;
    this.#placed = false;
    // In passthrough the room itself is the background and the floor.
    scene.background = this.#mode === 'vr' ? this.#background : null;
    if (this.#mode === 'vr') scene.add(this.#floor);
    for (const mode of MODES) {
      this.#buttons[mode].textContent = t('Leave {mode}', { mode: NAMES[this.#mode] });
      this.#buttons[mode].hidden = mode !== this.#mode;
    }
    this.#callbacks.onMode(this.#mode);
  }

  /** Puts the scene back as the page shows it. */
  #ended() {
    const { scene, root } = this.#world;
    scene.background = null;
    this.#floor.removeFromParent();
    this.hideHelp();
    root.position.set(0, 0, 0);
    root.rotation.set(0, 0, 0);
    root.updateMatrixWorld(true);
    for (const mode of MODES) this.#buttons[mode].textContent = t('Enter {mode}', { mode: NAMES[mode] });
    this.#offer();
    this.#mode = '';
    this.#callbacks.onMode('');
  }

  /** Shows a button for each kind of session that the device supports, and without any the way to open the page in a headset. */
  async #offer() {
    for (const mode of MODES) {
      const supported = await navigator.xr?.isSessionSupported(`immersive-${mode}`).catch(() => false);
      this.#buttons[mode].hidden = !supported;
    }
    element('headset', HTMLElement).hidden = MODES.some((mode) => !this.#buttons[mode].hidden);
  }

  /**
   * Places the scene 1.5 m ahead of where the wearer looks: on the floor, or at a comfortable height when it is small. A large one is
   * placed around the wearer.
   * @param {THREE.ArrayCamera} camera
   */
  #placeAhead(camera) {
    const { root } = this.#world;
    const eye = middleOf(camera.cameras);
    const ahead = headingOf(camera) ?? new THREE.Vector3(0, 0, -1);
    const height = this.#callbacks.height();
    root.rotation.set(0, Math.atan2(-ahead.x, -ahead.z), 0);
    const inside = this.#callbacks.standingPlace();
    if (inside) {
      root.position.copy(inside).applyEuler(root.rotation).negate().add(eye.clone().setY(0));
    } else {
      root.position.copy(eye).addScaledVector(ahead, AHEAD_M);
      root.position.y = height < SMALL_M ? Math.max(0, eye.y * EYE_SHARE - height / 2) : 0;
    }
    root.updateMatrixWorld(true);
    this.#showHelp(eye, ahead, [...(inside ? WALKING_HELP : []), ...this.#callbacks.help()]);
    this.#callbacks.onPlaced(root.position.toArray());
  }

  /**
   * @param {THREE.Vector3} eye
   * @param {THREE.Vector3} ahead unit vector
   * @param {string[]} lines
   */
  #showHelp(eye, ahead, lines) {
    this.hideHelp();
    const help = createTextPanel(lines);
    help.position.copy(eye).addScaledVector(ahead, AHEAD_M);
    help.position.y = eye.y + 0.35; // above the things
    help.rotation.y = this.#world.root.rotation.y;
    this.#world.scene.add(help);
    this.#help = help;
    this.#helpUntil = performance.now() + 1000 * HELP_S;
  }
}

/**
 * The horizontal direction in which a wearer looks, a unit vector. Null where they look straight up or down.
 * @param {THREE.Camera} camera
 */
export function headingOf({ matrixWorld }) {
  const ahead = new THREE.Vector3(0, 0, -1).transformDirection(matrixWorld).setY(0);
  return ahead.lengthSq() < 1e-6 ? null : ahead.normalize();
}

/**
 * The middle between the eyes. Not the camera that stands for both: three.js puts that one into an eye at first.
 * @param {THREE.Camera[]} eyes
 */
export function middleOf(eyes) {
  const sum = new THREE.Vector3();
  for (const eye of eyes) sum.add(new THREE.Vector3().setFromMatrixPosition(eye.matrixWorld));
  return sum.divideScalar(eyes.length);
}
