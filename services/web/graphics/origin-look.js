// Where surface comes from, in colours: measured, proposed as a guess, filled in. A file tells it at each vertex (_ORIGIN) where not all of it
// was measured. All materials share one uniform, so that showing and hiding it costs nothing and reaches levels that come later.
import * as THREE from '../vendor/three-0.187.0.module.js';

const ATTRIBUTE = '_origin'; // as GLTFLoader names it
/** Of measured, proposed and filled surface, by their numbers in files: as in the report's picture. */
export const ORIGIN_COLOURS = ['#009e73', '#e69f00', '#cc79a7'];

const shown = { value: 0 };
const colours = { value: ORIGIN_COLOURS.map((colour) => new THREE.Color(colour)) };

/**
 * Lets a material show where its surface comes from, if the file says so.
 * @param {THREE.Material} material
 * @param {THREE.BufferGeometry} geometry
 * @returns {THREE.Material} the same
 */
export function withOrigin(material, geometry) {
  if (!geometry.hasAttribute(ATTRIBUTE)) return material;
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, { originShown: shown, originColours: colours });
    shader.vertexShader = shader.vertexShader
      .replace('#include <common>', `#include <common>\nattribute float ${ATTRIBUTE};\nvarying vec3 vOrigin;`)
      .replace(
        '#include <begin_vertex>',
        // Weights of the three: a number between them would show a border of filled surface as proposed.
        `#include <begin_vertex>\nvOrigin = vec3(equal(vec3(0.0, 1.0, 2.0), vec3(${ATTRIBUTE})));`,
      );
    shader.fragmentShader = shader.fragmentShader
      .replace(
        '#include <common>',
        '#include <common>\nuniform float originShown;\nuniform vec3 originColours[3];\nvarying vec3 vOrigin;',
      )
      .replace(
        '#include <color_fragment>',
        // Some of what is light and dark in the picture stays, so that shapes are still seen.
        `#include <color_fragment>
        vec3 origin = mat3(originColours[0], originColours[1], originColours[2]) * vOrigin;
        float light = dot(diffuseColor.rgb, vec3(0.2126, 0.7152, 0.0722));
        diffuseColor.rgb = mix(diffuseColor.rgb, origin * (0.45 + 0.55 * sqrt(light)), originShown);`,
      );
  };
  material.customProgramCacheKey = () => 'origin';
  return material;
}

/**
 * Whether some of an object was not measured, as its files say.
 * @param {THREE.Object3D} object
 */
export function hasOrigins(object) {
  let found = false;
  object.traverse((node) => {
    found ||= node instanceof THREE.Mesh && node.geometry.hasAttribute(ATTRIBUTE);
  });
  return found;
}

/** @param {boolean} wanted whether all surfaces show where they come from */
export function showOrigins(wanted) {
  shown.value = Number(wanted);
}
