// How a surface is drawn. Colours that were captured hold the light they were captured in, and are shown as they are; all else stands in
// the light of the studio: things without colours as clay, things of one colour as painted, and normal maps, which only show in a light.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { withOrigin } from './origin-look.js';

/** @import { GLTFLoaderPlugin } from '../vendor/three-0.187.0.gltf-loader.js' */

const CLAY = new THREE.Color(0xbdb3a6); // warm beside the cool grey of the pages
const CLAY_ROUGHNESS = 0.62; // a broad sheen along folds
const LOOKED_AT = 512; // vertices whose colours are compared
const ONE_COLOUR = 0.02; // most difference in linear light between colours that count as one

/**
 * A plugin of GLTFLoader that gives the surfaces of a file their look.
 * @returns {GLTFLoaderPlugin}
 */
export function surfaceLook() {
  return {
    name: 'capture2vr_surface_look',
    async afterRoot({ scene }) {
      scene.traverse((node) => {
        if (node instanceof THREE.Mesh) node.material = withOrigin(lookOf(node.material, node.geometry), node.geometry);
      });
    },
  };
}

/**
 * @param {THREE.Material} material of a mesh, as GLTFLoader makes it
 * @param {THREE.BufferGeometry} geometry
 * @returns {THREE.Material}
 */
function lookOf(material, geometry) {
  if (material instanceof THREE.MeshBasicMaterial) return Object.assign(material, { toneMapped: false }); // KHR_materials_unlit
  if (!(material instanceof THREE.MeshStandardMaterial) || material.normalMap) return material;
  const { map, vertexColors, color, side } = material;
  if (!map && !vertexColors) return new THREE.MeshStandardMaterial({ color: CLAY, roughness: CLAY_ROUGHNESS, side });
  if (!map && isOneColour(geometry.getAttribute('color'))) return material;
  return new THREE.MeshBasicMaterial({ map, vertexColors, color, side, toneMapped: false });
}

/**
 * Whether the vertices of a mesh are all of one colour: painted so, or never looked at.
 * @param {THREE.BufferAttribute | THREE.InterleavedBufferAttribute} colours
 */
function isOneColour(colours) {
  const step = Math.ceil(colours.count / LOOKED_AT);
  for (let place = step; place < colours.count; place += step) {
    for (const channel of [0, 1, 2]) {
      if (Math.abs(colours.getComponent(place, channel) - colours.getComponent(0, channel)) > ONE_COLOUR) return false;
    }
  }
  return true;
}
