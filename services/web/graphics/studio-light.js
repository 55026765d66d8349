// The light that things without a light of their own stand in: a photographer's studio, worked out as nine numbers and one lamp.
// Nothing is downloaded and no texture is filtered, so that neither a phone's start nor a headset's frame pays for it.
import * as THREE from '../vendor/three-0.187.0.module.js';

const DIRECTIONS = 1024; // in which the studio is looked at
const GOLDEN_ANGLE = Math.PI * (3 - Math.sqrt(5));
const MEAN = 0.75; // of the radiance from all around, where 1 shows white as white; the lamp adds the rest
const [CEILING, FLOOR] = [0.75, 0.3]; // radiance, before all of it is scaled to MEAN
const LAMP_INTENSITY = 0.8; // beside the soft boxes: hard enough to draw folds
/** @type {THREE.Vector3Tuple} */
const LAMP_PLACE = [0.6, 1, 0.8]; // as the key

// Where they hang, how bright they are, and how narrow (exponent of the cosine).
const SOFT_BOXES = [
  { place: new THREE.Vector3(0.4, 1, 0.5).normalize(), radiance: 2.2, narrow: 4 }, // key, over the right shoulder
  { place: new THREE.Vector3(-1, 0.4, 0.5).normalize(), radiance: 0.7, narrow: 3 }, // fill, from the left
  { place: new THREE.Vector3(-0.3, 0.7, -1).normalize(), radiance: 1.6, narrow: 4 }, // rim, so that the back is not dark
];

/**
 * Creates the light of a studio that favours no colour.
 *
 * Irradiance by the first nine spherical harmonics of the studio's radiance: within 1 % of the integral for matt surfaces (Ramamoorthi and
 * Hanrahan, "An Efficient Representation for Irradiance Environment Maps", 2001).
 * @returns {THREE.Light[]}
 */
export function createStudioLight() {
  const weights = new Array(9).fill(0);
  const basis = new Array(9).fill(0);
  let whole = 0;
  for (const direction of evenDirections()) {
    const radiance = radianceFrom(direction);
    THREE.SphericalHarmonics3.getBasisAt(direction, basis);
    basis.forEach((value, place) => (weights[place] += value * radiance));
    whole += radiance;
  }
  const probe = new THREE.LightProbe();
  const scale = (4 * Math.PI * MEAN) / whole;
  probe.sh.coefficients.forEach((coefficient, place) => coefficient.setScalar(weights[place] * scale));
  const lamp = new THREE.DirectionalLight(0xffffff, LAMP_INTENSITY);
  lamp.position.set(...LAMP_PLACE);
  return [probe, lamp];
}

/**
 * How bright the studio is in a direction, before it is scaled.
 * @param {THREE.Vector3} direction unit vector, Y up
 */
function radianceFrom(direction) {
  const walls = THREE.MathUtils.lerp(FLOOR, CEILING, (direction.y + 1) / 2);
  return SOFT_BOXES.reduce(
    (sum, { place, radiance, narrow }) => sum + radiance * Math.max(0, direction.dot(place)) ** narrow,
    walls,
  );
}

/** Directions spread evenly over the sphere (a Fibonacci lattice). */
function evenDirections() {
  return Array.from({ length: DIRECTIONS }, (_, place) => {
    const y = 1 - (2 * place + 1) / DIRECTIONS;
    return new THREE.Vector3().setFromSphericalCoords(1, Math.acos(y), place * GOLDEN_ANGLE);
  });
}
