// The area of a surface inside a loop of points on it.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** @typedef {[THREE.Vector3, THREE.Vector3, THREE.Vector3]} Corners of a triangle */
/** @typedef {{ corners: Corners, triangle: THREE.Triangle, area: number, facing: number }} Piece a triangle, how much of it is inside, and which side it shows */

const [WELD_LOOP, WELD_SURFACE] = [1e-4, 2e-5]; // corners as near as that, of the sizes of both, are one: tiles are rounded each for itself
const LEAST_FACING = 1e-6; // cosine; a wall along the direction shows neither side

/**
 * Measures the part of a surface inside a loop: what is seen of it along the loop's own normal, in one piece with the loop's points. The
 * triangles are cut at the loop's lines, and their true areas are summed: a slope or a bulge counts in full, folds that turn away do not.
 * @param {THREE.Vector3[]} loop three points or more on the surface, in their order
 * @param {Iterable<Corners>} triangles of the surface, in the frame of the loop; the corners may be used again for the next
 * @returns {number | null} in the square of the loop's unit; null where its lines cross, or are all one line
 */
export function areaInside(loop, triangles) {
  const turn = turnOf(loop);
  if (!turn) return null;
  const flat = loop.map((point) => point.clone().applyQuaternion(turn));
  if (crossesItself(flat)) return null;
  const pieces = piecesInside(flat, triangles, turn);
  if (pieces.length === 0) return 0;
  const first = flat.map((point) => nearestPiece(pieces, point));
  const side = Math.sign(first.reduce((sum, { facing }) => sum + Math.sign(facing), 0)) || 1;
  const shown = pieces.filter(({ facing }) => facing * side > 0);
  const groupOf = connect(shown, weldSize(flat, shown));
  const wanted = new Set(first.filter((piece) => shown.includes(piece)).map(groupOf));
  return shown.reduce((sum, piece) => sum + (wanted.has(groupOf(piece)) ? piece.area : 0), 0);
}

/**
 * The turn that takes the loop's mean normal (Newell's) to +Z.
 * @param {THREE.Vector3[]} loop
 */
function turnOf(loop) {
  const middle = loop.reduce((sum, point) => sum.add(point), new THREE.Vector3()).divideScalar(loop.length);
  const [normal, cross] = [new THREE.Vector3(), new THREE.Vector3()];
  loop.forEach((point, place) => {
    const next = loop[(place + 1) % loop.length];
    normal.add(cross.crossVectors(point.clone().sub(middle), next.clone().sub(middle)));
  });
  const reach = Math.max(...loop.map((point) => point.distanceTo(middle)));
  if (!(normal.length() > 1e-9 * reach ** 2)) return null;
  return new THREE.Quaternion().setFromUnitVectors(normal.normalize(), new THREE.Vector3(0, 0, 1));
}

/** @param {THREE.Vector3[]} flat */
function crossesItself(flat) {
  const at = (/** @type {number} */ place) => flat[place % flat.length];
  const sides = flat.map((_, place) => /** @type {const} */ ([at(place), at(place + 1)]));
  return sides.some(([a, b], one) =>
    sides.some(([c, d], other) => {
      const apart = Math.abs(one - other);
      return (
        apart > 1 &&
        apart < flat.length - 1 &&
        turning(a, b, c) * turning(a, b, d) < 0 &&
        turning(c, d, a) * turning(c, d, b) < 0
      );
    }),
  );
}

/**
 * Twice the area of a triangle on the plane; positive counterclockwise.
 * @param {THREE.Vector3} a
 * @param {THREE.Vector3} b
 * @param {THREE.Vector3} c
 */
const turning = (a, b, c) => (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);

/**
 * The triangles that are inside at least in part.
 * @param {THREE.Vector3[]} flat
 * @param {Iterable<Corners>} triangles
 * @param {THREE.Quaternion} turn
 */
function piecesInside(flat, triangles, turn) {
  const box = new THREE.Box2().setFromPoints(flat.map(({ x, y }) => new THREE.Vector2(x, y)));
  const parts = THREE.ShapeUtils.triangulateShape(
    flat.map(({ x, y }) => new THREE.Vector2(x, y)),
    [],
  )
    .map((part) => part.map((place) => flat[place]))
    .map((part) => (turning(part[0], part[1], part[2]) < 0 ? part.reverse() : part));
  /** @type {Piece[]} */
  const pieces = [];
  const turned = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (const corners of triangles) {
    corners.forEach((corner, place) => turned[place].copy(corner).applyQuaternion(turn));
    if (isBeside(turned, box)) continue;
    const piece = pieceOf(turned, parts);
    if (piece.area > 0 && Math.abs(piece.facing) > LEAST_FACING) pieces.push(piece);
  }
  return pieces;
}

/**
 * @param {THREE.Vector3[]} corners
 * @param {THREE.Box2} box
 */
function isBeside([a, b, c], { min, max }) {
  return (
    Math.max(a.x, b.x, c.x) < min.x ||
    Math.min(a.x, b.x, c.x) > max.x ||
    Math.max(a.y, b.y, c.y) < min.y ||
    Math.min(a.y, b.y, c.y) > max.y
  );
}

/**
 * @param {THREE.Vector3[]} turned
 * @param {THREE.Vector3[][]} parts triangles of the loop, counterclockwise
 * @returns {Piece}
 */
function pieceOf(turned, parts) {
  const corners = /** @type {Corners} */ (turned.map((corner) => corner.clone()));
  const triangle = new THREE.Triangle(...corners);
  const area = parts.reduce(
    (sum, part) =>
      sum + polygonArea(part.reduce((kept, from, place) => clip(kept, from, part[(place + 1) % 3]), [...corners])),
    0,
  );
  return { corners, triangle, area, facing: triangle.getNormal(new THREE.Vector3()).z };
}

/**
 * The part of a polygon to the left of a line on the plane (Sutherland and Hodgman).
 * @param {THREE.Vector3[]} polygon
 * @param {THREE.Vector3} from
 * @param {THREE.Vector3} to
 */
function clip(polygon, from, to) {
  return polygon.flatMap((point, place) => {
    const next = polygon[(place + 1) % polygon.length];
    const [here, there] = [turning(from, to, point), turning(from, to, next)];
    const crossing = here * there < 0 ? [point.clone().lerp(next, here / (here - there))] : [];
    return here >= 0 ? [point, ...crossing] : crossing;
  });
}

/** @param {THREE.Vector3[]} polygon on one plane in space */
function polygonArea(polygon) {
  const sum = new THREE.Vector3();
  for (let place = 2; place < polygon.length; place++) {
    sum.add(polygon[place - 1].clone().sub(polygon[0]).cross(polygon[place].clone().sub(polygon[0])));
  }
  return sum.length() / 2;
}

/**
 * @param {Piece[]} pieces
 * @param {THREE.Vector3} point
 */
function nearestPiece(pieces, point) {
  const place = new THREE.Vector3();
  /** @param {Piece} piece */
  const distanceTo = ({ triangle }) => triangle.closestPointToPoint(point, place).distanceToSquared(point);
  return pieces.reduce(
    (best, piece) => (distanceTo(piece) < best.distance ? { piece, distance: distanceTo(piece) } : best),
    { piece: pieces[0], distance: Infinity },
  ).piece;
}

/**
 * @param {THREE.Vector3[]} flat
 * @param {Piece[]} pieces
 */
function weldSize(flat, pieces) {
  const surface = new THREE.Box3();
  for (const { corners } of pieces) for (const corner of corners) surface.expandByPoint(corner);
  const [loop, all] = [new THREE.Box3().setFromPoints(flat), surface].map((box) =>
    box.getSize(new THREE.Vector3()).length(),
  );
  return Math.max(WELD_LOOP * loop, WELD_SURFACE * all);
}

/**
 * Finds which triangles hang together by their corners. Two grids, half a cell apart, so that the border of a cell separates none.
 * @param {Piece[]} pieces
 * @param {number} size of a cell
 * @returns {(piece: Piece) => Piece} the triangle that stands for those that hang together with this one
 */
function connect(pieces, size) {
  /** @type {Map<Piece, Piece>} */
  const parents = new Map(pieces.map((piece) => [piece, piece]));
  /** @param {Piece} piece */
  const rootOf = (piece) => {
    let root = piece;
    for (let up = parents.get(root); up && up !== root; up = parents.get(root)) root = up;
    parents.set(piece, root);
    return root;
  };
  /** @type {Map<string, Piece>} */
  const cells = new Map();
  for (const piece of pieces) {
    for (const { x, y, z } of piece.corners) {
      for (const shift of [0, 0.5]) {
        const cell = `${shift} ${Math.floor(x / size + shift)} ${Math.floor(y / size + shift)} ${Math.floor(z / size + shift)}`;
        const other = cells.get(cell);
        if (other) parents.set(rootOf(piece), rootOf(other));
        else cells.set(cell, piece);
      }
    }
  }
  return rootOf;
}
