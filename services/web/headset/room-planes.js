// The floors, walls and tables that the headset has found in the wearer's room (WebXR plane detection), as surfaces that nobody sees.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** The planes of the wearer's room. */
export class RoomPlanes {
  /** @type {Map<XRPlane, { mesh: THREE.Mesh, changed: number }>} */
  #planes = new Map();
  #renderer;

  /** @param {THREE.WebGLRenderer} renderer */
  constructor(renderer) {
    this.#renderer = renderer;
    const { xr } = renderer;
    // three.js sends this for every frame in which the headset tells of planes; `data` is the frame, though its types say otherwise.
    xr.addEventListener('planesdetected', ({ data }) =>
      this.#update(/** @type {XRFrame} */ (/** @type {unknown} */ (data))),
    );
    xr.addEventListener('sessionend', () => this.#keep(new Set()));
  }

  /** The planes, in the world. A ray hits them, and nothing draws them. */
  get surfaces() {
    return [...this.#planes.values()].map(({ mesh }) => mesh);
  }

  /** @param {XRFrame} frame */
  #update(frame) {
    const space = this.#renderer.xr.getReferenceSpace();
    const found = frame.detectedPlanes ?? new Set();
    this.#keep(found);
    for (const plane of found) {
      if (this.#planes.get(plane)?.changed === plane.lastChangedTime) continue;
      const pose = space && frame.getPose(plane.planeSpace, space);
      if (!pose) continue;
      const mesh =
        this.#planes.get(plane)?.mesh ??
        new THREE.Mesh(undefined, new THREE.MeshBasicMaterial({ side: THREE.DoubleSide }));
      mesh.geometry.dispose();
      mesh.geometry = geometryOf(plane.polygon);
      mesh.matrixAutoUpdate = false;
      mesh.matrix.fromArray(pose.transform.matrix);
      mesh.updateMatrixWorld(true);
      this.#planes.set(plane, { mesh, changed: plane.lastChangedTime });
    }
    document.body.dataset.planes = String(this.#planes.size);
  }

  /**
   * Forgets all planes but these.
   * @param {Set<XRPlane>} kept
   */
  #keep(kept) {
    for (const [plane, { mesh }] of this.#planes) {
      if (kept.has(plane)) continue;
      mesh.geometry.dispose();
      this.#planes.delete(plane);
    }
  }
}

/**
 * A polygon of WebXR, whose corners have y = 0, as triangles.
 * @param {DOMPointReadOnly[]} polygon
 */
function geometryOf(polygon) {
  const outline = polygon.map(({ x, z }) => new THREE.Vector2(x, z));
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute(
    'position',
    new THREE.Float32BufferAttribute(
      polygon.flatMap(({ x, z }) => [x, 0, z]),
      3,
    ),
  );
  geometry.setIndex(THREE.ShapeUtils.triangulateShape(outline, []).flat());
  return geometry;
}
