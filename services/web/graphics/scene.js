// What the pages draw with: renderer, light, a camera that sees the whole of a thing, and freeing memory of the graphics card.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { createStudioLight } from './studio-light.js';
import { createContext, pixelRatio } from './webgl-context.js';

/** @import { Manifest, SizeM } from '../shared/types.d.ts' */

/** @typedef {{ renderer: THREE.WebGLRenderer, scene: THREE.Scene, camera: THREE.PerspectiveCamera }} Stage */

const VIEW = new THREE.Vector3(0.35, 0.3, 0.9).normalize(); // from the middle of a thing to the camera
/** How much of the view's width and height `frame` fills with a thing: above and below it are words and buttons. */
export const FILLED = [0.88, 0.76];
const POINT_SHARE = 1 / 40; // size of a point of the hints, of the thing's diameter

/**
 * Creates a renderer, a scene in the light of a studio, and a camera that fit a canvas. Throws where the browser has no WebGL.
 * @param {HTMLCanvasElement} canvas
 * @param {WebGL2RenderingContext | null} [context] of the canvas, by `createContext`
 * @returns {Stage}
 */
export function createStage(canvas, context = createContext(canvas)) {
  const renderer = new THREE.WebGLRenderer({ canvas, context: context ?? undefined });
  renderer.debug.checkShaderErrors = false; // asking for them waits for the graphics card
  renderer.toneMapping = THREE.NeutralToneMapping; // Khronos PBR Neutral: keeps hues and all but the brightest tones; filmic curves tint paint
  const scene = new THREE.Scene();
  scene.add(...createStudioLight());
  const camera = new THREE.PerspectiveCamera(45, 1, 0.01, 200);

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (renderer.xr.isPresenting || width === 0 || height === 0) return;
    renderer.setDrawingBufferSize(width, height, pixelRatio()); // once: each new size costs the canvas its memory, and half a tenth of a second
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
  }
  new ResizeObserver(resize).observe(canvas);
  resize();
  return { renderer, scene, camera };
}

/**
 * Places the camera so that a box fills the view.
 * @param {THREE.PerspectiveCamera} camera
 * @param {SizeM | THREE.Vector3Tuple} size in metres
 * @param {THREE.Vector3} [target] the middle of the box; without it the box stands on the floor
 * @returns {THREE.Vector3} the target
 */
export function frame(camera, size, target = new THREE.Vector3(0, size[1] / 2, 0)) {
  const radius = Math.max(0.05, Math.hypot(size[0], size[1], size[2]) / 2);
  camera.position.copy(target).add(VIEW);
  camera.lookAt(target);
  camera.position.copy(target).addScaledVector(VIEW, Math.max(radius, distanceToFit(camera, size)));
  camera.near = radius / 50;
  camera.far = radius * 100;
  camera.updateProjectionMatrix();
  return target;
}

/**
 * From how far away the camera sees all corners of a box, in metres from its middle.
 * @param {THREE.PerspectiveCamera} camera that looks at the middle
 * @param {SizeM | THREE.Vector3Tuple} size
 */
function distanceToFit(camera, size) {
  const half = Math.tan(THREE.MathUtils.degToRad(camera.fov / 2));
  const [across, up] = [half * camera.aspect * FILLED[0], half * FILLED[1]];
  const turn = camera.quaternion.clone().invert();
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(
    (place) => new THREE.Vector3(...size.map((side, axis) => (place & (1 << axis) ? side / 2 : -side / 2))),
  );
  return Math.max(
    ...corners.map((corner) => {
      const { x, y, z } = corner.applyQuaternion(turn);
      return Math.max(Math.abs(x) / across, Math.abs(y) / up) + z;
    }),
  );
}

/**
 * Creates the manifest's few hundred points, which are shown until the first level of detail is loaded.
 * @param {Partial<Manifest>} manifest
 * @param {SizeM} size
 * @returns {THREE.Points | null} null where the manifest has none
 */
export function hintsOf({ anchors }, size) {
  if (!anchors?.xyz_m?.length) return null;
  const geometry = new THREE.BufferGeometry();
  const colours = Float32Array.from(
    anchors.rgb,
    (value) => new THREE.Color().setRGB(value / 255, 0, 0, THREE.SRGBColorSpace).r,
  );
  geometry.setAttribute('position', new THREE.Float32BufferAttribute(anchors.xyz_m, 3));
  geometry.setAttribute('color', new THREE.Float32BufferAttribute(colours, 3));
  return new THREE.Points(
    geometry,
    new THREE.PointsMaterial({ size: Math.hypot(...size) * POINT_SHARE, vertexColors: true, toneMapped: false }),
  );
}

/**
 * The materials of an object of the scene; none of one without materials.
 * @param {THREE.Object3D} object
 * @returns {THREE.Material[]}
 */
export function materialsOf(object) {
  const materials = 'material' in object ? [object.material].flat() : [];
  return materials.filter((material) => material instanceof THREE.Material);
}

/**
 * The textures of a material.
 * @param {THREE.Material} material
 * @returns {THREE.Texture[]}
 */
export function texturesOf(material) {
  return Object.values(material).filter((value) => value instanceof THREE.Texture);
}

/**
 * Frees what an object and all below it hold on the graphics card.
 * @param {THREE.Object3D} object
 */
export function dispose(object) {
  object.traverse((node) => {
    if (!(node instanceof THREE.Mesh || node instanceof THREE.Points)) return;
    node.geometry.dispose();
    for (const material of materialsOf(node)) {
      texturesOf(material).forEach(disposeTexture);
      material.dispose();
    }
  });
}

/** @param {THREE.Texture} texture */
function disposeTexture(texture) {
  texture.dispose();
  if (texture.image instanceof ImageBitmap) texture.image.close(); // up to 16 MB, which the garbage collector would free late
}
