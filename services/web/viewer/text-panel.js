// A panel of text in the room: the text of the page cannot be seen in a headset.
import * as THREE from '../vendor/three-0.187.0.module.js';

const [WIDTH_PX, LINE_PX] = [1024, 64];
const WIDTH_M = 0.9;

/**
 * Creates a panel with these lines, as a mesh that faces +Z. `dispose` of scene.js frees it.
 * @param {string[]} lines
 */
export function createTextPanel(lines) {
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [WIDTH_PX, LINE_PX * (lines.length + 1)];
  const context = canvas.getContext('2d');
  if (!context) throw new Error('This browser cannot draw on a canvas.');
  context.fillStyle = 'rgba(22, 24, 28, 0.85)';
  context.roundRect(0, 0, canvas.width, canvas.height, LINE_PX / 2);
  context.fill();
  context.fillStyle = '#eceef2';
  context.font = `${LINE_PX * 0.5}px system-ui, sans-serif`;
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  lines.forEach((line, place) => context.fillText(line, canvas.width / 2, LINE_PX * (place + 1), canvas.width - LINE_PX));
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const height = (WIDTH_M * canvas.height) / canvas.width;
  return new THREE.Mesh(new THREE.PlaneGeometry(WIDTH_M, height), new THREE.MeshBasicMaterial({ map, transparent: true }));
}
