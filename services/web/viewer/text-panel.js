// A few words that stand in the room: a page's text does not reach into a headset.
import * as THREE from '../vendor/three-0.187.0.module.js';

const [WIDTH_PX, LINE_PX] = [1024, 64];
const WIDTH_M = 0.9;

/** A sign of these lines, as a mesh that faces +Z; `dispose` of scene.js frees it. */
export function signOf(lines) {
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [WIDTH_PX, LINE_PX * (lines.length + 1)];
  const pen = canvas.getContext('2d');
  pen.fillStyle = 'rgba(22, 24, 28, 0.85)';
  pen.roundRect(0, 0, canvas.width, canvas.height, LINE_PX / 2);
  pen.fill();
  Object.assign(pen, { fillStyle: '#eceef2', font: `${LINE_PX * 0.5}px system-ui, sans-serif`, textAlign: 'center', textBaseline: 'middle' });
  lines.forEach((line, place) => pen.fillText(line, canvas.width / 2, LINE_PX * (place + 1), canvas.width - LINE_PX));
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const height = (WIDTH_M * canvas.height) / canvas.width;
  return new THREE.Mesh(new THREE.PlaneGeometry(WIDTH_M, height), new THREE.MeshBasicMaterial({ map, transparent: true }));
}
