// Putting a garment on the dress dummy, and what nobody wears on the plinth.
import { measureGarment, canHang, fitGarment } from './garment-fit.js';
import { trianglesOf } from '../graphics/contact-shadow.js';

/** @import { DressDummy } from '../graphics/dress-dummy.js' */
/** @import { Hanging } from '../catalogue/garments.js' */
/** @import { LoadedItem } from '../scenes/scene-item.js' */

/**
 * Stands an item in the middle of its scene: on the dummy, which is set to it, or on the plinth. Its size stays true.
 * @param {LoadedItem} item with a place in a scene
 * @param {Hanging | null} hanging null: it is no garment
 * @param {DressDummy} dummy
 */
export function dress(item, hanging, dummy) {
  const { size_m: size } = item.entry;
  const { coarsest } = item.model;
  if (!hanging || !coarsest || !canHang(size)) {
    stand(item, [0, dummy.carry(size), 0]);
    return;
  }
  const { position_m: position, shape } = fitGarment(
    measureGarment(trianglesOf(coarsest, item.group.matrixWorld.clone().invert())),
    hanging,
  );
  dummy.wear(shape);
  stand(item, position);
}

/**
 * @param {LoadedItem} item
 * @param {number[]} position
 */
function stand(item, position) {
  if (!item.placed) throw new Error(`${item.key} has no place in a scene.`);
  item.adopt({ ...item.placed, position_m: position });
  item.place();
}
