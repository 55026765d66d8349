// A panel in the room with parts that a ray can press: a picture that is painted on a canvas, and the rectangles in it that do something.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { headingOf, middleOf } from './xr-session.js';

/** @typedef {[x: number, y: number, width: number, height: number]} Rectangle on the canvas, in pixels */
/** @typedef {{ name: string, at: Rectangle, press: () => void }} Zone a part that can be pressed; name: for tests and for scripts */

const LIGHT = 0x4f8cff; // over what the ray points at
const LIFT_M = 0.002; // of that, in front of the panel
const MOST_ANISOTROPY = 4; // letters stay sharp on a panel that is seen at a slant

/** A panel that faces +Z. It is one quad with one texture; what a ray points at is lit by a second quad. */
export class PressPanel {
  /** @type {Zone[]} */
  #zones = [];
  #canvas = document.createElement('canvas');
  #context;
  #metresPerPixel;
  #texture = new THREE.CanvasTexture(this.#canvas);
  #light = new THREE.Mesh(
    new THREE.PlaneGeometry(1, 1),
    new THREE.MeshBasicMaterial({ color: LIGHT, transparent: true, opacity: 0.35, depthWrite: false }),
  );

  /**
   * @param {[width: number, height: number]} pixels
   * @param {number} widthM in metres
   */
  constructor([width, height], widthM) {
    const context = this.#canvas.getContext('2d');
    if (!context) throw new Error('This browser cannot draw on a canvas.');
    this.#context = context;
    [this.#canvas.width, this.#canvas.height] = [width, height];
    this.#metresPerPixel = widthM / width;
    this.#texture.colorSpace = THREE.SRGBColorSpace;
    this.#texture.anisotropy = MOST_ANISOTROPY;
    const material = new THREE.MeshBasicMaterial({ map: this.#texture, transparent: true, toneMapped: false });
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(widthM, height * this.#metresPerPixel), material);
    this.mesh.visible = this.#light.visible = false;
    this.mesh.add(this.#light);
  }

  get isShown() {
    return this.mesh.visible;
  }

  /**
   * Paints the panel anew.
   * @param {(context: CanvasRenderingContext2D) => Zone[]} draw returns what can be pressed
   */
  paint(draw) {
    this.#context.clearRect(0, 0, this.#canvas.width, this.#canvas.height);
    this.#zones = draw(this.#context);
    this.#texture.needsUpdate = true;
  }

  /**
   * Where a ray hits the panel.
   * @param {THREE.Raycaster} raycaster
   * @returns {{ distance: number, zone: Zone | undefined } | null}
   */
  hit(raycaster) {
    if (!this.isShown) return null;
    const [found] = raycaster.intersectObject(this.mesh, false);
    if (!found?.uv) return null;
    const [x, y] = [found.uv.x * this.#canvas.width, (1 - found.uv.y) * this.#canvas.height];
    return {
      distance: found.distance,
      zone: this.#zones.find(
        ({ at: [left, top, width, height] }) => x >= left && x < left + width && y >= top && y < top + height,
      ),
    };
  }

  /**
   * Lights what a ray points at; nothing lights nothing.
   * @param {Zone | undefined} zone
   */
  light(zone) {
    this.#light.visible = zone !== undefined;
    if (!zone) return;
    const [, , width, height] = zone.at;
    this.#light.position.copy(this.#centreOf(zone)).setZ(LIFT_M);
    this.#light.scale.set(width * this.#metresPerPixel, height * this.#metresPerPixel, 1);
  }

  /** The middle of each part in the world, by its name. */
  get places() {
    this.mesh.updateWorldMatrix(true, false);
    return Object.fromEntries(
      this.#zones.map((zone) => [zone.name, this.mesh.localToWorld(this.#centreOf(zone)).toArray()]),
    );
  }

  /** @param {Zone} zone */
  #centreOf({ at: [left, top, width, height] }) {
    return new THREE.Vector3(
      left + width / 2 - this.#canvas.width / 2,
      this.#canvas.height / 2 - top - height / 2,
      0,
    ).multiplyScalar(this.#metresPerPixel);
  }
}

/**
 * Stands a panel before a wearer, upright and facing them.
 * @param {PressPanel} panel
 * @param {THREE.ArrayCamera} camera
 * @param {{ away: number, below: number, turn: number }} where metres from the eyes, metres under them, and radians to the left
 */
export function standBefore({ mesh }, camera, { away, below, turn }) {
  const eye = middleOf(camera.cameras);
  const ahead = (headingOf(camera) ?? new THREE.Vector3(0, 0, -1)).applyAxisAngle(new THREE.Vector3(0, 1, 0), turn);
  mesh.position.copy(eye).addScaledVector(ahead, away);
  mesh.position.y -= below;
  mesh.rotation.y = Math.atan2(-ahead.x, -ahead.z);
  mesh.visible = true;
}

/**
 * Writes what can be pressed, and where, into the page's data attributes, for tests and for scripts.
 * @param {PressPanel[]} panels
 */
export function reportPlaces(panels) {
  const shown = panels.filter(({ isShown }) => isShown);
  document.body.dataset.wall = JSON.stringify(Object.assign({}, ...shown.map(({ places }) => places)));
}
