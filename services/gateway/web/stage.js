// An asset on a stage: loading LODs, showing the right one, swapping versions. Shared by both pages.
import * as THREE from './three-0.187.0.module.js';
import { GLTFLoader } from './three-0.187.0.gltf-loader.js';
import { MeshoptDecoder } from './three-0.187.0.meshopt-decoder.js';
import { bytesOf } from './vault.js';

// A level is fine enough while the asset's diameter takes less than this share of the view's height.
const SCREEN_SHARE = [Infinity, 0.3, 0.1];
const RETRY_MS = 2000; // doubles from try to try
const RETRY_MOST_MS = 60_000;
const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);

/** A renderer, a scene with soft light, and a camera that fit `canvas`. */
export function makeStage(canvas) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const scene = new THREE.Scene();
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f99, 2.2));
  const sun = new THREE.DirectionalLight(0xffffff, 1.4);
  sun.position.set(1, 2, 1.5);
  scene.add(sun);
  const camera = new THREE.PerspectiveCamera(45, 1, 0.01, 200);

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (renderer.xr.isPresenting || width === 0 || height === 0) return;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
  }
  new ResizeObserver(resize).observe(canvas);
  resize();
  return { renderer, scene, camera };
}

/** Place the camera so that a box of `size` metres standing on the floor fills the view. */
export function frame(camera, size) {
  const radius = Math.max(0.05, Math.hypot(size[0], size[1], size[2]) / 2);
  const half = Math.min(camera.fov, camera.fov * camera.aspect) / 2;
  const distance = (radius / Math.sin(THREE.MathUtils.degToRad(half))) * 0.9; // the sphere around a thing is larger than the thing
  const target = new THREE.Vector3(0, size[1] / 2, 0);
  camera.position.set(0.35, 0.3, 0.9).normalize().multiplyScalar(distance).add(target);
  camera.near = radius / 50;
  camera.far = radius * 100;
  camera.updateProjectionMatrix();
  camera.lookAt(target);
  return target;
}

/**
 * The asset of one catalogue entry as a THREE.LOD in metres, origin on the floor.
 * The smallest level is loaded before the promise resolves, so something shows at once; finer ones join as they come,
 * however often the connection breaks.
 * `onLevel(level)` is told of each.
 */
export async function loadAsset(entry, onLevel = () => {}) {
  const object = new THREE.LOD();
  object.name = entry.key;
  const radius = Math.hypot(...entry.size_m) / 2;
  const coarseFirst = [...entry.lods].sort((a, b) => b.level - a.level);
  await addLevel(object, coarseFirst[0], radius, onLevel);
  addFiner(object, coarseFirst.slice(1), radius, onLevel);
  return object;
}

/** The manifest's few hundred points as THREE.Points, to be seen while the first level is on its way; null without any. */
export function hintsOf(manifest, size) {
  const { xyz_m: places, rgb } = manifest.anchors || {};
  if (!places?.length) return null;
  const geometry = new THREE.BufferGeometry();
  const colours = Float32Array.from(rgb, (value) => new THREE.Color().setRGB(value / 255, 0, 0, THREE.SRGBColorSpace).r);
  geometry.setAttribute('position', new THREE.Float32BufferAttribute(places, 3));
  geometry.setAttribute('color', new THREE.Float32BufferAttribute(colours, 3));
  return new THREE.Points(geometry, new THREE.PointsMaterial({ size: Math.hypot(...size) / 40, vertexColors: true }));
}

async function addFiner(object, lods, radius, onLevel) {
  let pause = RETRY_MS;
  while (lods.length > 0 && !object.disposed) {
    try {
      await addLevel(object, lods[0], radius, onLevel);
      lods = lods.slice(1);
    } catch {
      await new Promise((resolve) => setTimeout(resolve, pause));
      pause = Math.min(2 * pause, RETRY_MOST_MS);
    }
  }
}

async function addLevel(object, lod, radius, onLevel) {
  const gltf = await loader.parseAsync(await bytesOf(lod), '');
  if (object.disposed) {
    dispose(gltf.scene);
    return;
  }
  // Seen from here, the asset's diameter takes SCREEN_SHARE of a 45-degree view's height.
  const share = SCREEN_SHARE[Math.min(lod.level, SCREEN_SHARE.length - 1)];
  const distance = share === Infinity ? 0 : (2 * radius) / (share * 2 * Math.tan(Math.PI / 8));
  gltf.scene.userData.level = lod.level;
  // The nearest level of the list serves all shorter distances too: a coarse one stands in until finer ones come.
  object.addLevel(gltf.scene, distance);
  onLevel(lod.level);
}

/** Free an asset's GPU memory. */
export function dispose(object) {
  object.disposed = true;
  object.traverse((node) => {
    if (!node.isMesh && !node.isPoints) return;
    node.geometry.dispose();
    for (const material of [node.material].flat()) {
      for (const value of Object.values(material)) if (value?.isTexture) value.dispose();
      material.dispose();
    }
  });
}

/** The level of detail that is on screen now: 0 is the finest. */
export function shownLevel(object) {
  return object.levels[object.getCurrentLevel()].object.userData.level;
}
