// A card of the collection page: an asset's picture, name, labels and state, a box to choose it, and the way to its downloads.
import { loadManifest } from '../catalogue/signed-catalogue.js';
import { loadFile } from '../catalogue/verified-cache.js';
import { create } from '../shared/dom.js';
import { formatBytes, stateText } from '../shared/format.js';
import { gradeText } from '../shared/grade.js';
import { isConnectionProblem, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { AssetFile, Collection, CollectionRow, Manifest } from '../shared/types.d.ts' */

/**
 * @typedef {object} CardOptions
 * @property {boolean} chosen
 * @property {(label: string) => void} onLabel is called with a label that was clicked
 * @property {(yes: boolean) => boolean} onChoose is called when the box was clicked; returns whether the asset is chosen now
 * @property {() => void} onLost is called when the server did not serve the picture
 */

const PICTURES = ['thumbnail.webp', 'preview.png']; // the first that there is
const TURNING = 'turning.webp'; // an animation
/** @type {Record<string, string>} */
const MEDIA_TYPES = { webp: 'image/webp', png: 'image/png' }; // by the ending of the file: no other kind is shown
const SHOWN_LABELS = 6;

/** A card: an item of the page's list. */
export class Card {
  element = create('li');
  #collection;
  #row;
  #picture = create('img', { alt: '', width: 256, height: 256, decoding: 'async' });
  #facts;
  #onLost;
  /** @type {Manifest | null} */
  #manifest = null;
  /** @type {string[]} */
  #urls = []; // object URLs, which hold memory until they are revoked
  #disposed = false;
  /** @type {Promise<string | null> | null} */
  #animation = null; // object URL; null until it is asked for
  /** @type {string | null} */
  #stillUrl = null; // of the picture, while the animation may be shown in its place

  /**
   * @param {Collection} collection
   * @param {CollectionRow} row
   * @param {CardOptions} options
   */
  constructor(collection, row, { chosen, onLabel, onChoose, onLost }) {
    this.#onLost = onLost;
    this.#collection = collection;
    this.#row = row;
    this.#facts = create('p', { className: 'facts', textContent: factsOf(row) });
    const link = create('a', { href: ofShownTenant(`/view/${encodeURIComponent(row.key)}`) });
    link.append(this.#picture, create('span', { className: 'name', dir: 'auto', textContent: row.label }));
    this.element.dataset.key = row.key;
    this.element.append(
      link,
      ...createBadge(row),
      this.#facts,
      ...createLabels(row, onLabel),
      createFoot(row, chosen, onChoose),
    );
    for (const kind of ['pointerenter', 'focusin']) this.element.addEventListener(kind, () => this.#startAnimation());
    for (const kind of ['pointerleave', 'focusout']) this.element.addEventListener(kind, () => this.#stopAnimation());
  }

  /** Loads the picture. To be called when the card comes into view. */
  async loadPicture() {
    const { dataset } = this.element;
    try {
      const manifest = await loadManifest(this.#collection, this.#row);
      this.#manifest = manifest;
      if (manifest.origin === 'guess') this.#facts.textContent = t('a guess from one photo');
      if (manifest.origin === 'generated') this.#facts.textContent = t('generated from one photo, not measured');
      const file = PICTURES.map((name) => this.#findFile(name)).find(Boolean);
      if (file) this.#picture.src = await this.#loadUrl(file);
      dataset.picture = file ? file.file : 'none';
    } catch (error) {
      const { code, message } = toProblem(error);
      dataset.picture = code === 'UNKNOWN' ? 'none' : code;
      this.#facts.textContent = code === 'ASSET_TAMPERED' ? message : t('Its picture could not be loaded.');
      if (isConnectionProblem(error)) this.#onLost();
    }
  }

  /** Frees the memory of the pictures. */
  dispose() {
    this.#disposed = true;
    for (const url of this.#urls) URL.revokeObjectURL(url);
  }

  /** Shows the animation while the card is pointed at or has the focus, unless the person wants less motion. */
  async #startAnimation() {
    if (this.#stillUrl !== null || matchMedia('(prefers-reduced-motion: reduce)').matches) return;
    this.#stillUrl = this.#picture.src;
    const url = await this.#loadAnimation();
    if (url && this.#stillUrl !== null) this.#picture.src = url;
  }

  /** Shows the still picture again. */
  #stopAnimation() {
    if (this.#stillUrl) this.#picture.src = this.#stillUrl;
    this.#stillUrl = null;
  }

  /** Loads the animation, once. Null where the asset has none. */
  #loadAnimation() {
    const file = this.#findFile(TURNING);
    if (!file) return null;
    this.#animation ??= this.#loadUrl(file).catch(() => null);
    return this.#animation;
  }

  /** @param {string} name */
  #findFile(name) {
    return this.#manifest?.files.find(({ file }) => file === name);
  }

  /**
   * Loads a picture's file.
   * @param {AssetFile} file
   * @returns {Promise<string>} an object URL
   */
  async #loadUrl(file) {
    const bytes = await loadFile(file);
    const url = URL.createObjectURL(new Blob([bytes], { type: MEDIA_TYPES[file.file.split('.').pop() ?? ''] }));
    if (this.#disposed) URL.revokeObjectURL(url);
    else this.#urls.push(url);
    return url;
  }
}

/**
 * Creates the badge of an asset that is not whole; good and usable ones need none.
 * @param {CollectionRow} row
 */
function createBadge({ grade }) {
  if (grade !== 'incomplete' && grade !== 'shoot again') return [];
  return [create('span', { className: 'badge', textContent: gradeText(grade) })];
}

/** @param {CollectionRow} row */
const factsOf = ({ state, bytes }) => [stateText(state), ...(bytes ? [formatBytes(bytes)] : [])].join(', ');

/**
 * Creates the last line: the box to choose the asset, and a link to its page with the formats for other programs open; a removed asset has none.
 * @param {CollectionRow} row
 * @param {boolean} chosen
 * @param {(yes: boolean) => boolean} onChoose
 */
function createFoot({ key, label, state }, chosen, onChoose) {
  const foot = create('div', { className: 'foot' });
  foot.append(createCheckbox(label, chosen, onChoose));
  if (state === 'removed') return foot;
  const href = `${ofShownTenant(`/view/${encodeURIComponent(key)}`)}#downloads`;
  foot.append(create('a', { href, textContent: t('Download'), ariaLabel: t('Download {label}', { label }) }));
  return foot;
}

/**
 * @param {string} label
 * @param {boolean} chosen
 * @param {(yes: boolean) => boolean} onChoose
 */
function createCheckbox(label, chosen, onChoose) {
  const box = create('input', { type: 'checkbox', checked: chosen, ariaLabel: t('Choose {label}', { label }) });
  box.addEventListener('change', () => (box.checked = onChoose(box.checked)));
  const check = create('label', { className: 'check' });
  check.append(box, t('Choose'));
  return check;
}

/**
 * Creates the line of labels; nothing for an asset without any.
 * @param {CollectionRow} row
 * @param {(label: string) => void} onLabel
 */
function createLabels({ labels }, onLabel) {
  if (labels.length === 0) return [];
  const line = create('p', { className: 'labels' });
  for (const label of labels.slice(0, SHOWN_LABELS)) {
    const button = create('button', {
      type: 'button',
      dir: 'auto',
      textContent: label,
      title: t('Everything with the tag {label}', { label }),
    });
    button.addEventListener('click', () => onLabel(label));
    line.append(button);
  }
  return [line];
}
