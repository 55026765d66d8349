// The camera of a photo: where in the upright photo a place of the thing is, and whether the photo shows it.
import { loadFile } from '../catalogue/verified-cache.js';

/** @import { AssetFile } from '../shared/types.d.ts' */

/**
 * A camera as cameras.json of a bundle has it. `size`, `camera` (fx, fy, cx, cy) and `distortion` (OpenCV's k1, k2, p1, p2, k3) are of the
 * stored picture in pixels, whose centres are at integers; `camera_to_world`: three rows, OpenCV axes, metres with Z up; `turns`: clockwise
 * quarter turns to the upright picture; `part`: left, top, right, bottom of what it shows of its file.
 * @typedef {{ name: string, size: number[], camera: number[], distortion: number[], camera_to_world: number[][], turns: number, part: number[] }} StoredCamera
 */

/**
 * Loads the cameras of a version's photos; none where the version has no such file.
 * @param {AssetFile | undefined} file
 */
export async function loadCameras(file) {
  if (!file) return [];
  /** @type {{ cameras: StoredCamera[] }} */
  const { cameras } = JSON.parse(new TextDecoder().decode(await loadFile(file)));
  return cameras;
}

const CELLS = 256; // along the longer side, in which surfaces hide each other
const BEHIND = 1.03; // of the depth that a photo shows up to which a place is that surface: as the worker has it

/** One photo's camera. Places are in the asset frame: metres, Y up. */
export class PhotoCamera {
  /** @type {StoredCamera} */
  #stored;
  /** @type {Float32Array | null} */
  #reach = null; // depth of the surface in each cell
  #columns = 0;
  #rows = 0;

  /** @param {StoredCamera} stored */
  constructor(stored) {
    this.#stored = stored;
    const [width, height] = stored.size;
    const cell = Math.max(width, height) / CELLS;
    [this.#columns, this.#rows] = [Math.ceil(width / cell), Math.ceil(height / cell)];
  }

  /**
   * Takes the surface by which places are hidden.
   * @param {Float32Array} places x, y, z one after the other
   * @param {ArrayLike<number>} corners of triangles
   */
  look(places, corners) {
    const depth = new Float32Array(this.#columns * this.#rows).fill(Infinity);
    const seen = new Float32Array(places.length);
    for (let place = 0; place < places.length; place += 3) {
      const [x, y, z] = this.#straight(places, place);
      seen.set([x * this.#columns, y * this.#rows, z], place);
    }
    for (let corner = 0; corner < corners.length; corner += 3) {
      this.#fill(depth, seen, 3 * corners[corner], 3 * corners[corner + 1], 3 * corners[corner + 2]);
    }
    this.#reach = widened(depth, this.#columns, this.#rows);
  }

  /**
   * Where a place is in the upright photo, as shares of its sides, and whether the photo shows it; null where it is beside or behind the photo.
   * @param {Float32Array} places
   * @param {number} at of the place's x
   * @returns {{ x: number, y: number, seen: boolean } | null}
   */
  see(places, at) {
    const [x, y, z] = this.#straight(places, at);
    if (!(z > 0 && x >= 0 && x < 1 && y >= 0 && y < 1)) return null;
    const reach = this.#reach?.[Math.floor(y * this.#rows) * this.#columns + Math.floor(x * this.#columns)] ?? Infinity;
    return { ...this.#upright(x, y), seen: z <= BEHIND * reach };
  }

  /**
   * Shares of the sides of the picture without its distortion, and the depth.
   * @param {Float32Array} places
   * @param {number} at
   */
  #straight(places, at) {
    const { size, camera, camera_to_world: rows } = this.#stored;
    // From Y up to Z up, and from the camera's place.
    const from = [places[at] - rows[0][3], -places[at + 2] - rows[1][3], places[at + 1] - rows[2][3]];
    const [x, y, z] = [0, 1, 2].map(
      (axis) => rows[0][axis] * from[0] + rows[1][axis] * from[1] + rows[2][axis] * from[2],
    );
    return [((camera[0] * x) / z + camera[2] + 0.5) / size[0], ((camera[1] * y) / z + camera[3] + 0.5) / size[1], z];
  }

  /**
   * A place of the picture without distortion in the upright photo.
   * @param {number} x
   * @param {number} y
   */
  #upright(x, y) {
    const {
      size,
      camera: [fx, fy, cx, cy],
      distortion: [k1, k2, p1, p2, k3],
      turns,
      part: [left, top, right, bottom],
    } = this.#stored;
    const [u, v] = [(x * size[0] - 0.5 - cx) / fx, (y * size[1] - 0.5 - cy) / fy];
    const r = u * u + v * v;
    const radial = 1 + r * (k1 + r * (k2 + r * k3));
    const bent = [
      u * radial + 2 * p1 * u * v + p2 * (r + 2 * u * u),
      v * radial + p1 * (r + 2 * v * v) + 2 * p2 * u * v,
    ];
    const stored = [(fx * bent[0] + cx + 0.5) / size[0], (fy * bent[1] + cy + 0.5) / size[1]];
    const [across, down] = [left + stored[0] * (right - left), top + stored[1] * (bottom - top)];
    const turned = [
      [across, down],
      [1 - down, across],
      [1 - across, 1 - down],
      [down, 1 - across],
    ][turns];
    return { x: turned[0], y: turned[1] };
  }

  /**
   * Draws a triangle into the depth of the cells.
   * @param {Float32Array} depth
   * @param {Float32Array} seen cells and depth of all places
   * @param {number} a
   * @param {number} b
   * @param {number} c
   */
  #fill(depth, seen, a, b, c) {
    if (!(seen[a + 2] > 0 && seen[b + 2] > 0 && seen[c + 2] > 0)) return;
    const [ax, ay, bx, by, cx, cy] = [seen[a], seen[a + 1], seen[b], seen[b + 1], seen[c], seen[c + 1]];
    const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    if (area === 0) return;
    const [left, right] = [
      Math.max(0, Math.floor(Math.min(ax, bx, cx))),
      Math.min(this.#columns - 1, Math.floor(Math.max(ax, bx, cx))),
    ];
    const [top, bottom] = [
      Math.max(0, Math.floor(Math.min(ay, by, cy))),
      Math.min(this.#rows - 1, Math.floor(Math.max(ay, by, cy))),
    ];
    for (let row = top; row <= bottom; row += 1) {
      for (let column = left; column <= right; column += 1) {
        const [x, y] = [column + 0.5, row + 0.5];
        const [ofB, ofC] = [
          ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area,
          ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area,
        ];
        if (ofB < 0 || ofC < 0 || ofB + ofC > 1) continue;
        const z = seen[a + 2] + ofB * (seen[b + 2] - seen[a + 2]) + ofC * (seen[c + 2] - seen[a + 2]);
        const cell = row * this.#columns + column;
        if (z < depth[cell]) depth[cell] = z;
      }
    }
  }
}

/**
 * The farthest surface of each cell and those beside it: one may be seen at a slant.
 * @param {Float32Array} depth infinite where there is none
 * @param {number} columns
 * @param {number} rows
 */
function widened(depth, columns, rows) {
  const found = new Float32Array(depth.length).fill(Infinity);
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      let farthest = -Infinity;
      for (let y = Math.max(0, row - 1); y <= Math.min(rows - 1, row + 1); y += 1) {
        for (let x = Math.max(0, column - 1); x <= Math.min(columns - 1, column + 1); x += 1) {
          const here = depth[y * columns + x];
          if (here < Infinity && here > farthest) farthest = here;
        }
      }
      if (farthest > 0) found[row * columns + column] = farthest;
    }
  }
  return found;
}
