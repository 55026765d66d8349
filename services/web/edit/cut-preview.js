// Shows what a recipe keeps while it is edited: the rest is clipped away, and stays as a ghost.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { materialsOf } from '../graphics/scene.js';

/** @import { Box } from '../graphics/capture-frame.js' */

const GHOST = new THREE.MeshBasicMaterial({
  color: 0x808894,
  transparent: true,
  opacity: 0.1,
  depthWrite: false,
  side: THREE.DoubleSide,
  polygonOffset: true,
  polygonOffsetFactor: 2,
  polygonOffsetUnits: 2, // behind what is kept, which lies at the same place
});
const COUNTED = 20_000; // most vertices that are asked whether they are kept, in every frame of a drag

/**
 * The planes that bound a box, each with its kept side in front.
 * @param {Box} box
 * @returns {THREE.Plane[]}
 */
export function planesOf({ middle, turn, size }) {
  return [0, 1, 2].flatMap((axis) =>
    [1, -1].map((sign) => {
      const outward = new THREE.Vector3().setComponent(axis, sign).applyQuaternion(turn);
      const face = middle.clone().addScaledVector(outward, size.getComponent(axis) / 2);
      return new THREE.Plane().setFromNormalAndCoplanarPoint(outward.negate(), face);
    }),
  );
}

/** Clips a thing's levels of detail, and counts what is left of the coarsest. */
export class CutPreview {
  /** @type {THREE.Plane[]} */
  world = []; // planes in the world
  share = 1; // of the vertices, which is kept
  /** @type {THREE.Vector3[]} */
  #counted = []; // vertices in the frame of the thing
  /** @type {THREE.Object3D[]} */
  #ghosts = [];
  /** @type {Map<THREE.BufferGeometry, { places: Float32Array, corners: Uint32Array, whole: THREE.BufferAttribute | null }>} */
  #surfaces = new Map(); // of the meshes, as they are whole; places in the frame of the thing
  /** @type {((places: Float32Array) => Uint8Array) | null} */
  #judge = null; // marks places that are left out for another reason than planes
  /** @type {Uint8Array | null} */
  #out = null; // of the counted vertices

  /** @param {THREE.WebGLRenderer} renderer */
  constructor(renderer) {
    renderer.localClippingEnabled = true;
  }

  /**
   * Takes the levels of detail that are loaded.
   * @param {THREE.Object3D} thing
   */
  take(thing) {
    for (const level of thing.children) {
      if (level.userData.ghost || this.#ghosts.some(({ parent }) => parent === level)) continue;
      this.#haunt(level);
      this.#keep(level, thing);
    }
    const coarsest = thing.children.at(0);
    if (coarsest && this.#counted.length === 0) {
      this.#counted = verticesOf(coarsest, thing);
      this.#count();
    }
  }

  /**
   * Leaves out triangles by their corners, whatever the planes say; null for none.
   * @param {((places: Float32Array) => Uint8Array) | null} judge marks with 1 the places (x, y, z one after the other, frame of the thing) that go
   */
  leaveOut(judge) {
    this.#judge = judge;
    this.#count();
    for (const geometry of this.#surfaces.keys()) this.#reduce(geometry);
  }

  /** The surface of the coarsest level, in the frame of the thing; null before it is there. */
  get surface() {
    return [...this.#surfaces.values()].at(0) ?? null;
  }

  /**
   * Clips, and returns the vertices of the thing that are kept.
   * @param {THREE.Object3D} thing
   * @param {THREE.Plane[]} planes in its frame
   */
  apply(thing, planes) {
    thing.updateWorldMatrix(true, false);
    this.world = planes.map((plane) => plane.clone().applyMatrix4(thing.matrixWorld));
    thing.traverse((node) => {
      for (const material of materialsOf(node)) if (material !== GHOST) material.clippingPlanes = this.world;
    });
    for (const ghost of this.#ghosts) ghost.visible = planes.length > 0 || this.#judge !== null;
    const kept = this.#counted.filter(
      (place, number) => !this.#out?.[number] && planes.every((plane) => plane.distanceToPoint(place) >= 0),
    );
    this.share = this.#counted.length ? kept.length / this.#counted.length : 1;
    return kept;
  }

  /** Forgets a thing that is no longer shown. */
  clear() {
    for (const ghost of this.#ghosts) {
      for (const copy of ghost.children) if (copy instanceof THREE.Mesh) copy.geometry.dispose();
    }
    this.#counted = [];
    this.#ghosts = [];
    this.#surfaces.clear();
    this.#judge = null;
    this.#out = null;
  }

  #count() {
    this.#out = this.#judge?.(new Float32Array(this.#counted.flatMap((place) => place.toArray()))) ?? null;
  }

  /**
   * Remembers the meshes of a level as they are whole.
   * @param {THREE.Object3D} level
   * @param {THREE.Object3D} thing
   */
  #keep(level, thing) {
    const inverse = thing.matrixWorld.clone().invert();
    level.traverse((node) => {
      if (!(node instanceof THREE.Mesh) || node.material === GHOST) return;
      const matrix = inverse.clone().multiply(node.matrixWorld);
      const { count } = node.geometry.getAttribute('position');
      const places = new Float32Array(3 * count);
      const place = new THREE.Vector3();
      for (let number = 0; number < count; number += 1) {
        node
          .getVertexPosition(number, place)
          .applyMatrix4(matrix)
          .toArray(places, 3 * number);
      }
      const whole = node.geometry.getIndex();
      const corners = Uint32Array.from(whole ? whole.array : Array.from({ length: count }, (_, number) => number));
      this.#surfaces.set(node.geometry, { places, corners, whole });
      if (this.#judge) this.#reduce(node.geometry);
    });
  }

  /**
   * Draws of a mesh the triangles of which at most one corner is left out.
   * @param {THREE.BufferGeometry} geometry
   */
  #reduce(geometry) {
    const surface = this.#surfaces.get(geometry);
    if (!surface) return;
    const { places, corners, whole } = surface;
    const out = this.#judge?.(places);
    if (!out) {
      geometry.setIndex(whole);
      return;
    }
    const kept = [];
    for (let corner = 0; corner < corners.length; corner += 3) {
      const three = corners.subarray(corner, corner + 3);
      if (out[three[0]] + out[three[1]] + out[three[2]] < 2) kept.push(...three);
    }
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(kept), 1));
  }

  /**
   * Adds a ghost to a level.
   * @param {THREE.Object3D} level
   */
  #haunt(level) {
    /** @type {THREE.Mesh[]} */
    const meshes = [];
    level.traverse((node) => {
      if (node instanceof THREE.Mesh) meshes.push(node);
    });
    const ghost = new THREE.Group();
    level.updateWorldMatrix(true, true);
    for (const mesh of meshes) {
      const copy = new THREE.Mesh(wholeOf(mesh.geometry), GHOST);
      copy.applyMatrix4(level.matrixWorld.clone().invert().multiply(mesh.matrixWorld));
      copy.raycast = () => {}; // nobody picks a place on it
      ghost.add(copy);
    }
    ghost.visible = false;
    level.add(ghost);
    this.#ghosts.push(ghost);
  }
}

/**
 * A geometry of the same vertices that stays whole where triangles are taken from the other.
 * @param {THREE.BufferGeometry} geometry
 */
function wholeOf(geometry) {
  const whole = new THREE.BufferGeometry();
  whole.setIndex(geometry.getIndex());
  for (const [name, attribute] of Object.entries(geometry.attributes)) whole.setAttribute(name, attribute);
  return whole;
}

/**
 * Some of the vertices of a level, in the frame of the thing.
 * @param {THREE.Object3D} level
 * @param {THREE.Object3D} thing
 */
export function verticesOf(level, thing) {
  thing.updateWorldMatrix(true, true);
  const inverse = thing.matrixWorld.clone().invert();
  /** @type {THREE.Vector3[]} */
  const found = [];
  level.traverse((node) => {
    if (!(node instanceof THREE.Mesh) || node.material === GHOST) return;
    const matrix = inverse.clone().multiply(node.matrixWorld);
    const { count } = node.geometry.getAttribute('position');
    const step = Math.ceil(count / COUNTED);
    for (let place = 0; place < count; place += step) {
      found.push(node.getVertexPosition(place, new THREE.Vector3()).applyMatrix4(matrix));
    }
  });
  return found;
}
