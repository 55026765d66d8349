// The refined version beside the preview that it replaced, on one picture with a slider.
import { CaptureFrame } from '../graphics/capture-frame.js';
import { Comparison } from '../graphics/compare.js';
import { prepare } from '../graphics/gpu-warmup.js';
import { Model } from '../graphics/model.js';
import { getVersion } from '../shared/api.js';
import { element } from '../shared/dom.js';

/** @import { Stage } from '../graphics/scene.js' */
/** @import { AssetEntry } from '../shared/types.d.ts' */
/** @import { LoadedItem } from './scene-item.js' */

/**
 * The version that was shown while the newest one was being refined. None of a preview, of a restored version, and where its frame is not known.
 * @param {AssetEntry} entry
 */
export function previewOf({ state, version, versions = [], capture_to_asset: frame }) {
  const newest = versions.find((record) => record.version === version);
  if (state !== 'refined' || !frame || !newest || newest.restored) return undefined;
  return versions.findLast((record) => record.version < version && record.state === 'preview' && record.job === newest.job);
}

/** Shows an item beside its preview. */
export class VersionComparison {
  #stage;
  #comparison;
  #onChange;
  /** @type {LoadedItem | null} */
  #item = null;

  /**
   * @param {Stage} stage
   * @param {() => void} onChange is called when there is something new to draw
   */
  constructor(stage, onChange) {
    this.#stage = stage;
    this.#onChange = onChange;
    this.#comparison = new Comparison(element('tools', HTMLElement), onChange);
  }

  /** Whether two versions are shown. */
  get isOn() {
    return this.#comparison.isOn;
  }

  /**
   * Loads the preview of an item and shows it to the right of the line. Throws what loading throws.
   * @param {LoadedItem} item
   */
  async start(item) {
    const { entry } = item;
    const record = previewOf(entry);
    if (!record || !entry.capture_to_asset) return;
    const before = await getVersion(entry.key, record.version);
    if (!before.capture_to_asset) return;
    const model = new Model(before, this.#stage.renderer, { prepare: (level) => prepare(this.#stage, level), onLevel: this.#onChange });
    await model.start();
    if (item.entry !== entry) { // a newer version has come
      model.dispose();
      return;
    }
    model.want(0);
    const [here, there] = [new CaptureFrame(entry.capture_to_asset), new CaptureFrame(before.capture_to_asset)];
    model.object.applyMatrix4(here.toAsset.clone().multiply(there.toCapture)); // both in the frame of the capture
    item.group.add(model.object);
    this.#item = item;
    this.#comparison.show(model, 'Refined', 'Preview');
    this.#onChange();
  }

  /** Shows the item alone again. */
  end() {
    this.#item = null;
    this.#comparison.show(null);
    this.#onChange();
  }

  /** Draws the scene. */
  render() {
    const { renderer, scene, camera } = this.#stage;
    if (this.#item) this.#comparison.render(this.#stage, this.#item.model.object);
    else renderer.render(scene, camera);
  }
}
