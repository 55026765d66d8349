// Which thing a hand or a ray means.
import * as THREE from '../vendor/three-0.187.0.module.js';

const REACH_M = 0.06; // a hand this near to a thing's box takes it without pointing

/** The piece whose box the point in the world is in or next to, or null. */
export function within(pieces, point) {
  const near = (piece) => {
    const local = piece.group.worldToLocal(point.clone());
    return piece.box.distanceToPoint(local) * piece.group.matrixWorld.getMaxScaleOnAxis();
  };
  const [nearest] = shownOf(pieces).map((piece) => [near(piece), piece]).sort((one, other) => one[0] - other[0]);
  return nearest && nearest[0] < REACH_M ? nearest[1] : null;
}

/** {piece, point} that the THREE.Raycaster meets first: by the mesh, else, because scans have holes, by the box; or null. */
export function met(pieces, caster) {
  const found = (way) => shownOf(pieces).map((piece) => way(piece, caster)).filter(Boolean);
  const first = (hits) => hits.sort((one, other) => one.distance - other.distance)[0];
  return first(found(onMesh)) || first(found(onBox)) || null;
}

/** Distance in metres to the first box that the ray meets, or null: quick enough for every frame. */
export function metBox(pieces, caster) {
  const hits = shownOf(pieces).map((piece) => onBox(piece, caster)).filter(Boolean);
  return hits.length ? Math.min(...hits.map((hit) => hit.distance)) : null;
}

const shownOf = (pieces) => pieces.filter((piece) => piece.model?.coarsest);

function onMesh(piece, caster) {
  const [hit] = caster.intersectObject(piece.model.coarsest, true);
  return hit && { piece, point: hit.point, distance: hit.distance };
}

function onBox(piece, caster) {
  const ray = caster.ray.clone().applyMatrix4(piece.group.matrixWorld.clone().invert());
  const point = ray.intersectBox(piece.box, new THREE.Vector3());
  if (!point) return null;
  point.applyMatrix4(piece.group.matrixWorld);
  return { piece, point, distance: point.distanceTo(caster.ray.origin) };
}
