// The notes of a thing as they stand in the scene: numbered pins, the text of the one that is chosen, and all texts in a headset.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { createDot, createLabel } from '../graphics/marks.js';
import { dispose } from '../graphics/scene.js';
import { drawText } from '../graphics/text-panel.js';

/** @import { Note } from '../shared/types.d.ts' */

const LINE_CHARS = 28; // of a panel
const MOST_LINES = 24; // 500 characters, with a word left over in each line
const PIN_PX = 22; // from its middle, within which a tap chooses a pin

/**
 * Draws the pins in place of those before.
 * @param {THREE.Group} group
 * @param {Note[]} notes
 * @param {(note: Note) => boolean} isOpen whether a note's text is shown beside its number
 */
export function drawPins(group, notes, isOpen) {
  dispose(group);
  group.clear();
  notes.forEach((note, place) => {
    const at = new THREE.Vector3(...note.at);
    const lines = isOpen(note) ? wrap(`${place + 1}: ${note.text}`) : [String(place + 1)];
    group.add(createDot(at));
    group.add(createLabel(drawText(lines), lines.length, at));
  });
}

/**
 * The place of the pin that a tap hits: the nearest one within a finger's reach.
 * @param {Note[]} notes
 * @param {THREE.Group} group
 * @param {THREE.Vector2} tap in the view, from -1 to 1
 * @param {THREE.Camera} camera
 * @param {HTMLElement} canvas
 * @returns {number} -1 for none
 */
export function findPin(notes, group, tap, camera, canvas) {
  const distances = notes.map(({ at }) => {
    const { x, y, z } = new THREE.Vector3(...at).applyMatrix4(group.matrixWorld).project(camera);
    return z > 1
      ? Infinity
      : Math.hypot(((x - tap.x) * canvas.clientWidth) / 2, ((y - tap.y) * canvas.clientHeight) / 2);
  });
  const nearest = Math.min(Infinity, ...distances);
  return nearest <= PIN_PX ? distances.indexOf(nearest) : -1;
}

/**
 * Breaks a text into lines at its spaces; a word that is longer than a line is broken anywhere.
 * @param {string} text
 */
export function wrap(text) {
  const lines = text
    .split('\n')
    .flatMap((line) => line.match(new RegExp(`.{1,${LINE_CHARS}}(?:\\s|$)|.{1,${LINE_CHARS}}`, 'gu')) ?? ['']);
  return lines.length > MOST_LINES ? [...lines.slice(0, MOST_LINES - 1), '…'] : lines.map((line) => line.trimEnd());
}
