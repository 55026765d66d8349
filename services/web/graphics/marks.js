// Marks on a thing: dots, lines and labels that are as large on the screen from near as from afar, and seen through the thing.
import * as THREE from '../vendor/three-0.187.0.module.js';

const [DOT_PX, LINE_PX, RIM_PX] = [5, 1.5, 1.5]; // radii, and the width of the rim around both
const LABEL_PX = 30; // height of a line of a label
const RADIANS_PER_PX = 0.0014; // in a headset, which has no pixels of a page: a label is as high as a thumb's width at arm's length
const NEAREST_M = 0.01;
const [COLOUR, RIM] = [0xe8890c, 0xffffff]; // together clear before light and dark
const ORDER = 3; // of drawing: after the thing
const UP = new THREE.Vector3(0, 1, 0);

/**
 * A dot at a place of the object that it will be added to.
 * @param {THREE.Vector3} place
 */
export function createDot(place) {
  const dot = withRim(
    () => new THREE.SphereGeometry(1, 16, 12),
    (mesh, radius, px) => mesh.scale.setScalar((radius + DOT_PX) * px),
  );
  dot.position.copy(place);
  return dot;
}

/**
 * A line between two places of the object that it will be added to.
 * @param {THREE.Vector3} start
 * @param {THREE.Vector3} end
 */
export function createLine(start, end) {
  const length = start.distanceTo(end);
  const line = withRim(
    () => new THREE.CylinderGeometry(1, 1, 1, 8, 1, true),
    (mesh, radius, px) => {
      mesh.scale.set((radius + LINE_PX) * px, length, (radius + LINE_PX) * px);
    },
  );
  line.position.copy(start).lerp(end, 0.5);
  line.quaternion.setFromUnitVectors(UP, end.clone().sub(start).normalize());
  return line;
}

/**
 * A label above a place, which turns to who looks at it.
 * @param {THREE.CanvasTexture} map the words: of text-panel.js
 * @param {number} lines of the words
 * @param {THREE.Vector3} place of the object that it will be added to
 */
export function createLabel(map, lines, place) {
  const { width, height } = map.image;
  const label = new THREE.Sprite(
    new THREE.SpriteMaterial({ map, depthTest: false, depthWrite: false, toneMapped: false }),
  );
  label.center.set(0.5, -DOT_PX / LABEL_PX / lines - 0.1);
  keepSize(label, (px) => label.scale.set((px * lines * LABEL_PX * width) / height, px * lines * LABEL_PX, 1));
  label.renderOrder = ORDER + 2;
  label.position.copy(place);
  return label;
}

/**
 * A shape in the marks' colour, before a larger one in that of the rim.
 * @param {() => THREE.BufferGeometry} shape
 * @param {(mesh: THREE.Mesh, rim: number, px: number) => void} size is called before each drawing with metres for a pixel
 */
function withRim(shape, size) {
  const group = new THREE.Group();
  for (const [order, rim] of [RIM_PX, 0].entries()) {
    const material = new THREE.MeshBasicMaterial({
      color: rim ? RIM : COLOUR,
      depthTest: false,
      transparent: true,
      toneMapped: false,
    });
    const mesh = new THREE.Mesh(shape(), material);
    keepSize(mesh, (px) => size(mesh, rim, px));
    mesh.renderOrder = ORDER + order;
    group.add(mesh);
  }
  return group;
}

/**
 * Sets an object's size before each drawing of it, and lets no ray hit it.
 * @param {THREE.Object3D} object
 * @param {(px: number) => void} size is called with the length of a pixel at the object, in the frame of its parent
 */
function keepSize(object, size) {
  object.frustumCulled = false; // its size is not known before it is drawn
  object.raycast = () => {};
  object.onBeforeRender = (renderer, _, camera) => {
    const distance = Math.max(
      NEAREST_M,
      -new THREE.Vector3().setFromMatrixPosition(object.matrixWorld).applyMatrix4(camera.matrixWorldInverse).z,
    );
    size((distance * radiansPerPixel(renderer, camera)) / (object.parent?.matrixWorld.getMaxScaleOnAxis() ?? 1));
    object.updateMatrixWorld();
  };
}

/**
 * @param {THREE.WebGLRenderer} renderer
 * @param {THREE.Camera} camera
 */
function radiansPerPixel({ xr, domElement }, { projectionMatrix }) {
  return xr.isPresenting ? RADIANS_PER_PX : 2 / (projectionMatrix.elements[5] * Math.max(1, domElement.clientHeight));
}
