// Text in the room: the text of the page cannot be seen in a headset.
import * as THREE from '../vendor/three-0.187.0.module.js';

const LINE_PX = 64;
const WIDTH_PX = 1024; // of a panel
const WIDTH_M = 0.9;

/**
 * Creates a panel with these lines, as a mesh that faces +Z. `dispose` of scene.js frees it.
 * @param {string[]} lines
 */
export function createTextPanel(lines) {
  const map = drawText(lines, WIDTH_PX);
  const height = (WIDTH_M * map.image.height) / WIDTH_PX;
  return new THREE.Mesh(
    new THREE.PlaneGeometry(WIDTH_M, height),
    new THREE.MeshBasicMaterial({ map, transparent: true }),
  );
}

/**
 * Draws lines of text on a dark panel.
 * @param {string[]} lines
 * @param {number} [width] of the panel in pixels; without it as the longest line needs
 */
export function drawText(lines, width) {
  const canvas = document.createElement('canvas');
  const context = canvas.getContext('2d');
  if (!context) throw new Error('This browser cannot draw on a canvas.');
  const font = `${LINE_PX * 0.5}px system-ui, sans-serif`;
  context.font = font;
  canvas.width = width ?? Math.ceil(LINE_PX + Math.max(...lines.map((line) => context.measureText(line).width)));
  canvas.height = LINE_PX * (lines.length + (width ? 1 : 0.25));
  context.fillStyle = 'rgba(22, 24, 28, 0.85)';
  context.roundRect(0, 0, canvas.width, canvas.height, LINE_PX / 2);
  context.fill();
  context.fillStyle = '#eceef2';
  context.font = font; // a canvas forgets it with its old size
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  const first = (canvas.height - LINE_PX * (lines.length - 1)) / 2;
  lines.forEach((line, place) =>
    context.fillText(line, canvas.width / 2, first + LINE_PX * place, canvas.width - LINE_PX / 2),
  );
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  return map;
}
