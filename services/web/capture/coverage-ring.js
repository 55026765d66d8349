// The ring that fills as the person walks around the object: drawn wherever the page has one.
/** @import { Coverage } from './photo-set.js' */

/**
 * Draws how far around the object the photos go into all rings of the page.
 * @param {Coverage} coverage
 * @returns {string} the degrees, in words
 */
export function drawRings({ arcs }) {
  const sum = arcs.reduce((total, [from, to]) => total + to - from, 0);
  const degrees = `${Math.round(sum / 10) * 10}°`;
  for (const group of document.querySelectorAll('.ring .arcs')) {
    group.replaceChildren(...arcs.map(([from, to]) => createArc(from, to)));
  }
  for (const text of document.querySelectorAll('.ring text')) text.textContent = degrees;
  return degrees;
}

/**
 * @param {number} from degrees
 * @param {number} to degrees
 */
function createArc(from, to) {
  const arc = document.createElementNS('http://www.w3.org/2000/svg', 'circle');
  const attributes = {
    cx: 40,
    cy: 40,
    r: 34,
    pathLength: 360,
    'stroke-dasharray': `${to - from} 360`,
    'stroke-dashoffset': -from,
  };
  for (const [name, value] of Object.entries(attributes)) arc.setAttribute(name, String(value));
  return arc;
}
