// The measurements as they stand in the scene: dots, lines and labels, in the frame of the thing.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { createDot, createLabel, createLine } from '../graphics/marks.js';
import { dispose } from '../graphics/scene.js';
import { drawText } from '../graphics/text-panel.js';

/** @import { Kind } from './measurement.js' */

/**
 * Draws measurements in place of those before.
 * @param {THREE.Group} group
 * @param {{ kind: Kind, points: THREE.Vector3[], text: string }[]} measurements without a text: one that is not complete
 */
export function drawMeasurements(group, measurements) {
  dispose(group);
  group.clear();
  for (const { kind, points, text } of measurements) {
    const ends = kind === 'height' ? [...points, ...points.map((point) => point.clone().setY(0))] : points;
    const lines = sidesOf(kind, ends, text !== '').map(([start, end]) => createLine(start, end));
    for (const mark of [...lines, ...ends.map((end) => createDot(end))]) group.add(mark);
    if (text) group.add(createLabel(drawText([text]), 1, labelPlace(kind, ends)));
  }
}

/**
 * The lines from point to point; those of a complete loop come back to the first.
 * @param {Kind} kind
 * @param {THREE.Vector3[]} points
 * @param {boolean} isComplete
 */
function sidesOf(kind, points, isComplete) {
  const closed = kind === 'area' && isComplete ? [...points, points[0]] : points;
  return closed
    .slice(1)
    .map((end, place) => [closed[place], end])
    .filter(([start, end]) => start.distanceTo(end) > 0);
}

/**
 * At the corner of an angle, in the middle of everything else.
 * @param {Kind} kind
 * @param {THREE.Vector3[]} points
 */
function labelPlace(kind, points) {
  if (kind === 'angle') return points[1];
  return points.reduce((sum, point) => sum.add(point), new THREE.Vector3()).divideScalar(points.length);
}
