// A tailor's dummy: a torso of cloth on a stand of wood, which can be set to a garment's girth, depth and height. Made from a few measures, without a file.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { ContactShadow } from './contact-shadow.js';

/** @import { SizeM } from '../shared/types.d.ts' */
/** @typedef {{ y: number, x: number, z: number }} Ring of the torso: height over the floor, half its width, half its depth, in metres */
/** @typedef {{ scale: { x: number, y: number, z: number }, lift: number }} DummyShape sizes of the torso against `TORSO`, and metres by which the stand is drawn out */

/**
 * The torso of a grown woman of middling size (chest 0.88 m, waist 0.67 m, hips 0.94 m around), from the neck down.
 * @type {Ring[]}
 */
export const TORSO = [
  { y: 1.56, x: 0.05, z: 0.052 },
  { y: 1.49, x: 0.06, z: 0.058 },
  { y: 1.465, x: 0.1, z: 0.064 },
  { y: 1.435, x: 0.155, z: 0.068 },
  { y: 1.405, x: 0.18, z: 0.076 },
  { y: 1.34, x: 0.172, z: 0.096 },
  { y: 1.24, x: 0.16, z: 0.118 },
  { y: 1.15, x: 0.137, z: 0.101 },
  { y: 1.04, x: 0.119, z: 0.09 },
  { y: 0.94, x: 0.15, z: 0.106 },
  { y: 0.84, x: 0.169, z: 0.122 },
  { y: 0.76, x: 0.16, z: 0.112 },
];
/** The torso's shoulders, from the neck down to where arms would begin. */
export const SHOULDERS = TORSO.slice(1, 5);
/** Height of the bust. */
export const BUST_M = 1.24;
/** Height of the waist. */
export const WAIST_M = 1.04;
/** Height of the hips. */
export const HIP_M = 0.84;
/** The dummy as it stands bare. @type {DummyShape} */
export const BARE = { scale: { x: 1, y: 1, z: 1 }, lift: 0 };

const [CLOTH, WOOD] = [0x9a948b, 0x5a4030];
const [ROWS, AROUND] = [36, 32]; // 2,300 triangles
const [CAP_M, POLE_M] = [0.03, 0.016]; // height of the cap on the neck, radius of the pole
const FOOT = { radius: 0.17, height: 0.025 };
const PLINTH_TOP_M = 0.9; // of the plinth for what is small: it is looked at, not down upon
const LEAST_PLINTH_M = 0.06;
const PLINTH_RIM_M = 0.06;

/**
 * The torso of size 1 at a height, between its rings.
 * @param {number} y
 * @returns {Ring}
 */
export function torsoAt(y) {
  const place = Math.max(
    1,
    TORSO.findIndex((ring) => ring.y <= y),
  );
  const [above, below] = [TORSO[place - 1], TORSO[place]];
  const share = Math.min(1, Math.max(0, (above.y - y) / (above.y - below.y)));
  return { y, x: above.x + share * (below.x - above.x), z: above.z + share * (below.z - above.z) };
}

/** The dummy, and the plinth that takes its place under what nobody wears. Both stand on the floor of `object`, around its origin. */
export class DressDummy {
  object = new THREE.Group();
  #dummy = new THREE.Group();
  #torso = new THREE.Group();
  #pole;
  #foot;
  #plinth;
  #shadow = new ContactShadow();

  constructor() {
    const [cloth, wood] = [material(CLOTH, 0.95), material(WOOD, 0.55)];
    const top = TORSO[0];
    const cap = mesh(new THREE.CylinderGeometry(0.4 * top.x, 1.02 * top.x, CAP_M, AROUND), wood, top.y + CAP_M / 2);
    this.#pole = mesh(new THREE.CylinderGeometry(POLE_M, POLE_M, 1, 16).translate(0, 0.5, 0), wood, 0);
    this.#plinth = mesh(new THREE.CylinderGeometry(1, 1, 1, 64).translate(0, 0.5, 0), material(CLOTH, 0.8), 0);
    this.#torso.add(mesh(torsoGeometry(), cloth, 0), cap);
    this.#foot = mesh(
      new THREE.CylinderGeometry(0.9 * FOOT.radius, FOOT.radius, FOOT.height, 48).translate(0, FOOT.height / 2, 0),
      wood,
      0,
    );
    this.#dummy.add(this.#torso, this.#pole, this.#foot);
    this.object.add(this.#dummy, this.#plinth, this.#shadow.object);
    this.wear(BARE);
  }

  /**
   * Sets the dummy to a garment.
   * @param {DummyShape} shape
   */
  wear({ scale, lift }) {
    this.#torso.scale.set(scale.x, scale.y, scale.z);
    this.#torso.position.y = lift;
    this.#pole.scale.y = scale.y * (TORSO[TORSO.length - 1].y + POLE_M) + lift; // it ends inside the torso
    this.#foot.scale.setScalar(scale.y);
    this.#show(this.#dummy);
  }

  /**
   * Puts a plinth in the dummy's place.
   * @param {SizeM} size of what stands on it
   * @returns {number} the height on which it stands, in metres
   */
  carry([width, height, depth]) {
    const top = Math.max(LEAST_PLINTH_M, PLINTH_TOP_M - height / 2);
    const radius = Math.hypot(width, depth) / 2 + PLINTH_RIM_M;
    this.#plinth.scale.set(radius, top, radius);
    this.#show(this.#plinth);
    return top;
  }

  /**
   * Shows its shadow, or hides it: in passthrough the floor is the room's own.
   * @param {boolean} visible
   */
  showShadow(visible) {
    this.#shadow.object.visible = visible;
  }

  /** Its box in the frame of `object`. */
  get box() {
    const shown = this.#dummy.visible ? this.#dummy : this.#plinth;
    shown.updateWorldMatrix(true, true);
    return new THREE.Box3().setFromObject(shown).applyMatrix4(this.object.matrixWorld.clone().invert());
  }

  /** @param {THREE.Object3D} shown */
  #show(shown) {
    this.#dummy.visible = shown === this.#dummy;
    this.#plinth.visible = shown === this.#plinth;
    this.object.updateWorldMatrix(true, true);
    this.#shadow.cast(shown, this.object.matrixWorld.clone().invert());
  }
}

/** The torso: its rings, smoothly joined. The seam is at the back. */
function torsoGeometry() {
  const [widths, depths] = /** @type {const} */ (['x', 'z']).map(
    (side) =>
      new THREE.CatmullRomCurve3(
        TORSO.map((ring) => new THREE.Vector3(ring[side], ring.y, 0)),
        false,
        'centripetal',
      ),
  );
  const rows = Array.from({ length: ROWS + 1 }, (_, row) => 1 - row / ROWS); // from the bottom up, as the lathe has its outside
  const outline = rows.map((share) => widths.getPoint(share));
  const [bottom, top] = [outline[0], outline[ROWS]];
  const points = [new THREE.Vector3(0, bottom.y - 0.02, 0), ...outline, new THREE.Vector3(0, top.y, 0)];
  const flat = [1, ...rows.map((share, row) => depths.getPoint(share).x / outline[row].x), 1];
  const geometry = new THREE.LatheGeometry(
    points.map(({ x, y }) => new THREE.Vector2(x, y)),
    AROUND,
    Math.PI,
  );
  const { position } = geometry.attributes;
  for (let place = 0; place < position.count; place++) {
    position.setZ(place, position.getZ(place) * flat[place % points.length]);
  }
  geometry.computeVertexNormals();
  return geometry;
}

/**
 * @param {THREE.BufferGeometry} geometry
 * @param {THREE.Material} of
 * @param {number} y
 */
function mesh(geometry, of, y) {
  const made = new THREE.Mesh(geometry, of);
  made.position.y = y;
  return made;
}

/**
 * @param {number} color
 * @param {number} roughness
 */
const material = (color, roughness) => new THREE.MeshStandardMaterial({ color, roughness });
