// What is measured on a thing, from points on its surface, and how far off that may be.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { isShown } from '../graphics/picking.js';
import { formatAngle, formatArea, formatLength, formatRounded } from '../shared/format.js';
import { areaInside } from './surface-area.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, Manifest } from '../shared/types.d.ts' */
/** @import { Corners } from './surface-area.js' */
/** @typedef {'distance' | 'angle' | 'height' | 'area'} Kind */
/** @typedef {{ kind: Kind, points: THREE.Vector3[], value: number, version: number }} Measurement metres, square metres or degrees, in the asset frame */

/**
 * How well a thing's places are known.
 * @typedef {object} Accuracy
 * @property {string} confidence of its scale: metric, estimated or unknown
 * @property {number | null} point_m how far a place on the surface lies from what was captured; null where nobody knows
 * @property {number} scale share by which its size may be wrong, because of the two points by which it was set
 * @property {number} longest_m side
 */

/** @type {Record<Kind, number>} */
export const POINTS = { distance: 2, angle: 3, height: 1, area: Infinity };
export const LEAST_LOOP = 3; // points of an area

/**
 * @param {AssetEntry} entry
 * @param {Pick<Manifest, 'quality' | 'edits' | 'scale_by_model'>} manifest
 * @returns {Accuracy}
 */
export function accuracyOf(
  { scale_confidence: confidence, size_m: size },
  { quality, edits, scale_by_model: byModel },
) {
  const longest = Math.max(...size);
  const share = quality?.held_out_mean ?? quality?.points_to_mesh_median; // of the longest side
  const point = share === undefined || byModel ? null : share * longest; // nobody knows how far a model errs
  const between = edits?.length?.metres ?? longest; // what the person has measured whose length gave the scale
  const scale = confidence === 'estimated' ? (Math.SQRT2 * (point ?? 0)) / between : 0;
  return { confidence, point_m: point, scale, longest_m: longest };
}

/**
 * Measures. Null where there is nothing to measure: a loop whose lines cross, an angle with two points at one place.
 * @param {Kind} kind
 * @param {THREE.Vector3[]} points on the surface, in the asset frame
 * @param {() => Iterable<Corners>} triangles of the surface, in the same frame
 * @returns {number | null} metres, degrees, or square metres
 */
export function measure(kind, points, triangles) {
  const [a, b, c] = points;
  if (kind === 'height') return a.y; // the asset frame begins at the thing's lowest point
  if (kind === 'distance') return a.distanceTo(b) || null;
  if (kind === 'area') return areaInside(points, triangles());
  const [one, other] = [a.clone().sub(b), c.clone().sub(b)];
  return one.lengthSq() && other.lengthSq() ? THREE.MathUtils.radToDeg(one.angleTo(other)) : null;
}

/**
 * How far off a measurement may be, in its unit, to first order in its points and its scale. Null where nobody knows.
 * @param {Measurement} measurement
 * @param {Accuracy} accuracy
 */
export function errorOf({ kind, points, value }, { confidence, point_m: point, scale }) {
  if (point === null || (confidence === 'unknown' && kind !== 'angle')) return null;
  if (kind === 'angle') return THREE.MathUtils.radToDeg(point * angleSlope(points));
  if (kind === 'area') return Math.hypot(point * areaSlope(points), 2 * scale * value);
  return Math.hypot(Math.SQRT2 * point, scale * value);
}

/**
 * How much an angle changes when its three points move by one unit, each as it counts most.
 * @param {THREE.Vector3[]} points
 */
function angleSlope([a, b, c]) {
  const [one, other] = [a.distanceTo(b), c.distanceTo(b)];
  return Math.hypot(1 / one, 1 / other, a.distanceTo(c) / (one * other));
}

/**
 * How much a loop's area changes when its points move by one unit: each by half the line between its neighbours.
 * @param {THREE.Vector3[]} loop
 */
function areaSlope(loop) {
  return (
    Math.hypot(...loop.map((_, place) => loop.at(place - 1)?.distanceTo(loop[(place + 1) % loop.length]) ?? 0)) / 2
  );
}

/**
 * A measurement in words, such as "42.3 ± 0.2 cm". One of a thing of unknown size has a question mark.
 * @param {Measurement} measurement
 * @param {Accuracy} accuracy
 */
export function valueText(measurement, accuracy) {
  const { kind, value } = measurement;
  const error = errorOf(measurement, accuracy);
  if (kind === 'angle') return formatAngle(value, error);
  const text = kind === 'area' ? formatArea(value, error) : formatLength(value, error);
  return accuracy.confidence === 'unknown' ? `${text} ?` : text;
}

/**
 * What else there is to say of a measurement; '' where nothing is.
 * @param {Measurement} measurement
 * @param {Accuracy} accuracy
 */
export function detailText({ kind, points, value }, { confidence, longest_m: longest }) {
  if (confidence === 'unknown' && kind !== 'angle') {
    return kind === 'area'
      ? t('As if its size were the one that is shown.')
      : t('{percent} % of its longest side.', { percent: formatRounded((100 * value) / longest) });
  }
  if (kind === 'height') return t('Above its lowest point.');
  if (kind !== 'distance') return '';
  const way = points[1].clone().sub(points[0]);
  return t('{up} upward, {across} across.', {
    up: formatLength(Math.abs(way.y)),
    across: formatLength(Math.hypot(way.x, way.z)),
  });
}

/**
 * What a person must know of the figures.
 * @param {AssetEntry} entry
 * @param {Manifest} manifest
 */
export function scaleSentences(entry, manifest) {
  const length = manifest.edits?.length;
  const { point_m: point, confidence } = accuracyOf(entry, manifest);
  /** @type {Record<string, string>} */
  const scales = {
    metric: t('Its size was measured by what captured it.'),
    estimated: manifest.scale_by_model
      ? t('Its size is an estimate of a learned model: nobody has measured it.')
      : length
        ? t(
            'Its size was set by a length of {length} between two points that a person gave: figures are as good as that.',
            { length: formatLength(length.metres) },
          )
        : t('Its size was set by a length that a person gave: figures are as good as that.'),
    unknown: t('Its true size is not known: angles hold, and lengths only against each other.'),
  };
  return [
    entry.origin === 'guess' ? t('Its shape is a guess from one photo.') : '',
    entry.origin === 'generated' ? t('Its shape was generated from one photo: figures say nothing of the object.') : '',
    scales[confidence] ?? scales.unknown,
    point === null ? t('How near its surface is to what was captured is not known.') : surfaceText(confidence),
    manifest.capture?.up === null
      ? t('Which way is up was not told: heights are along the Y axis of the capture.')
      : '',
  ]
    .filter(Boolean)
    .join(' ');
}

/** @param {string} confidence of the scale */
const surfaceText = (confidence) =>
  confidence === 'estimated'
    ? t(
        '± tells how near its surface is to what was captured, and what that means for its size; it does not tell how well you chose the points.',
      )
    : t('± tells how near its surface is to what was captured; it does not tell how well you chose the points.');

/**
 * The triangles of what is drawn, in the frame of another object. The corners are used again for the next.
 * @param {THREE.Object3D} surface
 * @param {THREE.Object3D} frame
 * @returns {Generator<Corners>}
 */
export function* trianglesOf(surface, frame) {
  /** @type {THREE.Mesh[]} */
  const meshes = [];
  surface.traverse((node) => node instanceof THREE.Mesh && isShown(node) && meshes.push(node));
  /** @type {Corners} */
  const corners = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  for (const mesh of meshes) {
    const toFrame = frame.matrixWorld.clone().invert().multiply(mesh.matrixWorld);
    const { index } = mesh.geometry;
    const count = index ? index.count : mesh.geometry.getAttribute('position').count;
    for (let first = 0; first + 2 < count; first += 3) {
      corners.forEach((corner, place) =>
        mesh.getVertexPosition(index ? index.getX(first + place) : first + place, corner).applyMatrix4(toFrame),
      );
      yield corners;
    }
  }
}
