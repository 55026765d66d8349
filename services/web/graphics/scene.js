// What both pages draw on: a renderer, light, a camera that sees the whole of a thing, and freeing memory.
import * as THREE from '../vendor/three-0.187.0.module.js';

/** A renderer, a scene with soft light, and a camera that fit `canvas`. */
export function makeStage(canvas) {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.debug.checkShaderErrors = false; // asking for them waits for the graphics card
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

/** Place the camera so that a box of `size` metres around `target` fills the view: a box standing on the floor where none is told. */
export function frame(camera, size, target = new THREE.Vector3(0, size[1] / 2, 0)) {
  const radius = Math.max(0.05, Math.hypot(size[0], size[1], size[2]) / 2);
  const half = Math.min(camera.fov, camera.fov * camera.aspect) / 2;
  const distance = (radius / Math.sin(THREE.MathUtils.degToRad(half))) * 0.9; // the sphere around a thing is larger than the thing
  camera.position.set(0.35, 0.3, 0.9).normalize().multiplyScalar(distance).add(target);
  camera.near = radius / 50;
  camera.far = radius * 100;
  camera.updateProjectionMatrix();
  camera.lookAt(target);
  return target;
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

/** Free an asset's GPU memory. */
export function dispose(object) {
  object.traverse((node) => {
    if (!node.isMesh && !node.isPoints) return;
    node.geometry.dispose();
    for (const material of [node.material].flat()) {
      for (const value of Object.values(material)) if (value?.isTexture) freed(value);
      material.dispose();
    }
  });
}

function freed(texture) {
  texture.dispose();
  texture.image?.close?.(); // a decoded picture waits for no garbage collector: it has up to 16 MB
}
