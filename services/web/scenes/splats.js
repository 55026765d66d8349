// Gaussian splats in place of a thing's mesh, drawn by Spark, which is loaded with this module: only where somebody asks for them.
import { SparkRenderer, SplatMesh } from '../vendor/spark-2.2.0.index.js';

/** @import { Stage } from '../graphics/scene.js' */
/** @import { LoadedItem } from './scene-item.js' */

const WIDER = { preBlurAmount: 0.3, blurAmount: 0 }; // as splats are drawn that were not trained to be thin where they are small: a surface stays opaque

/** @type {SparkRenderer | null} */
let drawing = null; // one for all scenes of the page: it keeps buffers on the graphics card

/**
 * Shows splats in place of the mesh. Throws where they cannot be read.
 * @param {LoadedItem} item
 * @param {ArrayBuffer} bytes of a .spz file
 * @param {Stage} stage
 * @param {() => void} redraw
 */
export async function showSplats(item, bytes, { renderer, scene }, redraw) {
  const { model } = item;
  const splats = await new SplatMesh({ fileBytes: new Uint8Array(bytes), fileName: 'asset.spz' }).initialized;
  if (item.model !== model) {
    // a newer version has come, or the item is gone
    splats.dispose();
    return;
  }
  drawing ??= new SparkRenderer({ renderer, onDirty: redraw, ...WIDER });
  scene.add(drawing);
  item.group.add(splats);
  model.object.visible = false;
  item.splats = {
    dispose() {
      splats.removeFromParent();
      splats.dispose();
      drawing?.removeFromParent();
      model.object.visible = true;
      item.splats = null;
      redraw();
    },
  };
  redraw();
}
