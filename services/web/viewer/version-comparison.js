// The refined version beside the preview that it replaced, on one picture with a slider, while a button is pressed.
import { CaptureFrame } from '../graphics/capture-frame.js';
import { Comparison } from '../graphics/compare.js';
import { prepare } from '../graphics/gpu-warmup.js';
import { Model } from '../graphics/model.js';
import { getVersion } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { Stage } from '../graphics/scene.js' */
/** @import { AssetEntry } from '../shared/types.d.ts' */
/** @import { LoadedItem } from '../scenes/scene-item.js' */

/** Shows an item beside its preview. */
export class VersionComparison {
  #stage;
  #callbacks;
  #button = element('compare', HTMLButtonElement);
  #comparison;
  /** @type {LoadedItem | null} */
  #item = null; // that is offered to be compared

  /**
   * @param {Stage} stage
   * @param {{ onChange: () => void, onError: (error: unknown) => void }} callbacks onChange: is called when there is something new to draw
   */
  constructor(stage, callbacks) {
    this.#stage = stage;
    this.#callbacks = callbacks;
    this.#comparison = new Comparison(element('controls', HTMLElement), callbacks.onChange);
    this.#button.addEventListener('click', () => this.#toggle());
  }

  /** Whether two versions are shown. */
  get isOn() {
    return this.#comparison.isOn;
  }

  /**
   * Offers to compare an item, where it has a preview.
   * @param {LoadedItem} item
   */
  offer(item) {
    this.#item = item;
    this.#button.hidden = !previewOf(item.entry);
  }

  /** Shows the item alone again. */
  end() {
    this.#comparison.show(null);
    this.#button.setAttribute('aria-pressed', 'false');
    this.#callbacks.onChange();
  }

  /** Draws the scene with both versions. */
  render() {
    if (this.#item) this.#comparison.render(this.#stage, this.#item.model.object);
  }

  async #toggle() {
    if (this.isOn) {
      this.end();
      return;
    }
    this.#button.disabled = true;
    await this.#start().catch(this.#callbacks.onError);
    this.#button.disabled = false;
  }

  /** Loads the preview, and shows it to the right of the line. Throws what loading throws. */
  async #start() {
    const item = this.#item;
    const entry = item?.entry;
    const record = entry && previewOf(entry);
    if (!record || !entry.capture_to_asset) return;
    const before = await getVersion(entry.key, record.version);
    if (!before.capture_to_asset) return;
    const model = new Model(before, this.#stage.renderer, {
      prepare: (level) => prepare(this.#stage, level),
      onLevel: this.#callbacks.onChange,
    });
    await model.start();
    if (item.entry !== entry) {
      // a newer version has come meanwhile
      model.dispose();
      return;
    }
    model.want(0);
    const [here, there] = [new CaptureFrame(entry.capture_to_asset), new CaptureFrame(before.capture_to_asset)];
    model.object.applyMatrix4(here.toAsset.clone().multiply(there.toCapture)); // both in the frame of the capture
    item.group.add(model.object);
    this.#comparison.show(model, t('Refined'), t('Preview'));
    this.#button.setAttribute('aria-pressed', 'true');
    document.body.dataset.compared = String(record.version);
    this.#callbacks.onChange();
  }
}

/**
 * The version that was shown while the newest one was being refined. None of a preview, of a restored version, and where its frame is not known.
 * @param {AssetEntry} entry
 */
function previewOf({ state, version, versions = [], capture_to_asset: frame }) {
  const newest = versions.find((record) => record.version === version);
  if (state !== 'refined' || !frame || !newest || newest.restored) return undefined;
  return versions.findLast(
    (record) => record.version < version && record.state === 'preview' && record.job === newest.job,
  );
}
