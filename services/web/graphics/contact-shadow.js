// The soft shadow of a thing on the floor under it: how high its underside is over each spot, darkest where it touches, blurred. It is worked
// out on the CPU from the coarsest level of detail, once, in milliseconds: no shader, no render target, and a headset draws one quad.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { pause } from './gpu-warmup.js';
import { dispose } from './scene.js';

const CELLS = 64; // along each side of the shadow
const MARGIN = 8; // cells around the thing's outline, into which the blur runs out
const REACH = 0.3; // height up to which the underside darkens the floor, of the thing's longest side
const [SOFT_CELLS, SHARP_CELLS] = [3, 1]; // radius of the blur: of all of the shadow, and of where the thing nearly touches
const TOUCHING = 0.06; // height that counts as touching, of the longest side
const DARKNESS = { soft: 0.34, sharp: 0.3 }; // most opacity of each
const PASSES = 3; // of a box blur, which then is nearly Gaussian
const MOST_TRIANGLES = 30_000; // a coarser mesh is looked at in whole, a finer one in part

/** A thing's shadow: an object for the frame of the floor, whose Y is up. */
export class ContactShadow {
  object;
  #texels = new Uint8Array(4 * CELLS * CELLS); // black, as dark as their opacity
  #texture = new THREE.DataTexture(this.#texels, CELLS, CELLS);

  constructor() {
    this.#texture.magFilter = THREE.LinearFilter;
    const material = new THREE.MeshBasicMaterial({
      map: this.#texture,
      transparent: true,
      depthWrite: false,
      toneMapped: false,
    });
    this.object = new THREE.Mesh(new THREE.PlaneGeometry(1, 1).rotateX(-Math.PI / 2), material); // from below it is not seen
    this.object.renderOrder = -1; // under the thing, which may touch the floor
    this.object.raycast = () => {}; // nobody takes hold of it
  }

  /**
   * Works the shadow out anew, for a thing that has come, or was turned, scaled or lifted.
   * @param {THREE.Object3D} thing its coarsest level of detail
   * @param {THREE.Matrix4} toFloor from the world to the frame of the floor, where the height is 0
   */
  cast(thing, toFloor) {
    const parts = this.#parts(thing, toFloor);
    while (!parts.next().done) continue;
  }

  /**
   * The same in parts, between which the page goes on: the first time the browser has not compiled this code yet, and all of it takes several frames.
   * @param {THREE.Object3D} thing
   * @param {THREE.Matrix4} toFloor
   */
  async castInParts(thing, toFloor) {
    const parts = this.#parts(thing, toFloor);
    while (!parts.next().done) await pause();
  }

  /**
   * @param {THREE.Object3D} thing
   * @param {THREE.Matrix4} toFloor
   */
  *#parts(thing, toFloor) {
    const triangles = trianglesOf(thing, toFloor);
    yield;
    const box = new THREE.Box3().setFromArray(triangles);
    const size = box.getSize(new THREE.Vector3());
    const reach = REACH * Math.max(size.x, size.y, size.z);
    const side = (Math.max(size.x, size.z) * CELLS) / (CELLS - 2 * MARGIN);
    const middle = box.getCenter(new THREE.Vector3());
    const heights = heightsUnder(triangles, { x: middle.x - side / 2, z: middle.z - side / 2, cell: side / CELLS });
    yield;
    const soft = blur(
      heights.map((height) => Math.max(0, 1 - height / reach) ** 2),
      SOFT_CELLS,
    );
    yield;
    const sharp = blur(
      heights.map((height) => Math.max(0, 1 - height / ((reach * TOUCHING) / REACH))),
      SHARP_CELLS,
    );
    for (let place = 0; place < soft.length; place++) {
      const flipped = place + (CELLS - 1 - 2 * Math.floor(place / CELLS)) * CELLS; // a texture's rows begin at the near edge
      this.#texels[4 * flipped + 3] = 255 * (DARKNESS.soft * soft[place] + DARKNESS.sharp * sharp[place]);
    }
    this.#texture.needsUpdate = true;
    this.object.position.set(middle.x, 0, middle.z);
    this.object.scale.set(side, 1, side);
  }

  /** Frees its memory, and removes it. */
  dispose() {
    dispose(this.object);
    this.object.removeFromParent();
  }
}

/**
 * Corners of triangles, nine numbers each, in the frame of the floor.
 * @param {THREE.Object3D} thing
 * @param {THREE.Matrix4} toFloor from the world
 */
export function trianglesOf(thing, toFloor) {
  /** @type {THREE.Mesh[]} */
  const meshes = [];
  thing.updateWorldMatrix(true, true);
  thing.traverse((node) => node instanceof THREE.Mesh && meshes.push(node));
  const parts = meshes.map(({ geometry, matrixWorld }) =>
    cornersOf(geometry, new THREE.Matrix4().multiplyMatrices(toFloor, matrixWorld)),
  );
  const all = new Float32Array(parts.reduce((sum, { length }) => sum + length, 0));
  parts.reduce((start, part) => {
    all.set(part, start);
    return start + part.length;
  }, 0);
  return all;
}

/**
 * @param {THREE.BufferGeometry} geometry
 * @param {THREE.Matrix4} matrix
 */
function cornersOf({ index, attributes: { position } }, matrix) {
  const count = Math.floor((index?.count ?? position.count) / 3);
  const step = Math.ceil(count / MOST_TRIANGLES);
  const corners = new Float32Array(9 * Math.ceil(count / step));
  const corner = new THREE.Vector3();
  for (let place = 0; 3 * place < corners.length; place++) {
    const source = 3 * step * Math.floor(place / 3) + (place % 3);
    corner
      .fromBufferAttribute(position, index ? index.getX(source) : source)
      .applyMatrix4(matrix)
      .toArray(corners, 3 * place);
  }
  return corners;
}

/**
 * The height of the lowest surface over each cell of the floor, row by row; Infinity where there is none.
 * @param {Float32Array} triangles
 * @param {{ x: number, z: number, cell: number }} grid its corner and the side of a cell, in metres
 */
function heightsUnder(triangles, { x, z, cell }) {
  const heights = new Float32Array(CELLS * CELLS).fill(Infinity);
  const [a, b, c] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (let first = 0; first < triangles.length; first += 9) {
    [a, b, c].forEach((corner, place) => {
      corner.fromArray(triangles, first + 3 * place);
      corner.set((corner.x - x) / cell, Math.max(0, corner.y), (corner.z - z) / cell);
      lower(heights, Math.floor(corner.x), Math.floor(corner.z), corner.y); // a triangle may be smaller than a cell
    });
    lowerInside(heights, a, b, c);
  }
  return heights;
}

/**
 * @param {Float32Array} heights
 * @param {number} column
 * @param {number} row
 * @param {number} height
 */
function lower(heights, column, row, height) {
  const place = row * CELLS + column;
  if (height < heights[place]) heights[place] = height;
}

/**
 * Lowers the heights of all cells whose middle is inside a triangle (barycentric coordinates).
 * @param {Float32Array} heights
 * @param {THREE.Vector3} a x and z in cells, y in metres, as the others
 * @param {THREE.Vector3} b
 * @param {THREE.Vector3} c
 */
function lowerInside(heights, a, b, c) {
  const area = (b.x - a.x) * (c.z - a.z) - (c.x - a.x) * (b.z - a.z);
  if (area === 0) return;
  const lastRow = Math.floor(Math.max(a.z, b.z, c.z) - 0.5);
  const lastColumn = Math.floor(Math.max(a.x, b.x, c.x) - 0.5);
  for (let row = Math.ceil(Math.min(a.z, b.z, c.z) - 0.5); row <= lastRow; row++) {
    for (let column = Math.ceil(Math.min(a.x, b.x, c.x) - 0.5); column <= lastColumn; column++) {
      const [x, z] = [column + 0.5 - a.x, row + 0.5 - a.z];
      const second = (x * (c.z - a.z) - (c.x - a.x) * z) / area;
      const third = ((b.x - a.x) * z - x * (b.z - a.z)) / area;
      if (second < 0 || third < 0 || second + third > 1) continue;
      lower(heights, column, row, a.y + second * (b.y - a.y) + third * (c.y - a.y));
    }
  }
}

/**
 * @param {Float32Array} values of all cells
 * @param {number} radius in cells
 */
function blur(values, radius) {
  let blurred = values;
  for (let pass = 0; pass < PASSES; pass++) blurred = blurRows(blurRows(blurred, radius), radius);
  return blurred;
}

/**
 * Averages each cell with its neighbours in its row, and turns rows into columns: twice is both ways.
 * @param {Float32Array} values
 * @param {number} radius
 */
function blurRows(values, radius) {
  const turned = new Float32Array(values.length);
  for (let row = 0; row < CELLS; row++) {
    let sum = 0;
    for (let column = -radius; column < CELLS; column++) {
      if (column + radius < CELLS) sum += values[row * CELLS + column + radius];
      if (column - radius - 1 >= 0) sum -= values[row * CELLS + column - radius - 1];
      if (column >= 0) turned[column * CELLS + row] = sum / (2 * radius + 1);
    }
  }
  return turned;
}
