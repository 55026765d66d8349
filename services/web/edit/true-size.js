// The true size: two points on the thing, and the distance between them that somebody has measured.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { createDot, createLine } from '../graphics/marks.js';
import { dispose } from '../graphics/scene.js';
import { element } from '../shared/dom.js';
import { formatRounded } from '../shared/format.js';
import { t } from '../shared/texts.js';

/** @import { CaptureFrame } from '../graphics/capture-frame.js' */
/** @import { Picked } from '../graphics/picking.js' */
/** @import { MeasuredLength } from '../shared/types.d.ts' */

const [LEAST_M, MOST_M] = [0.001, 1000];

/** Two points, and the length between them. */
export class TrueSize {
  object = new THREE.Group();
  /** @type {THREE.Vector3[]} */
  #ends = []; // in the asset frame
  #onChange;
  #said = element('length-now', HTMLElement);
  #input = element('length', HTMLInputElement);

  /** @param {() => void} onChange */
  constructor(onChange) {
    this.#onChange = onChange;
    this.#input.addEventListener('input', () => this.#tell());
    element('length-reset', HTMLButtonElement).addEventListener('click', () => {
      this.#ends = [];
      this.#input.value = '';
      this.#draw();
      this.#tell();
    });
  }

  /** Metres between the points as somebody has measured them; 0 where nobody has. */
  get metres() {
    const metres = Number(this.#input.value) / 100;
    return this.#ends.length === 2 && metres >= LEAST_M && metres <= MOST_M ? metres : 0;
  }

  /** What is wrong with the length; '' where nothing is. */
  get fault() {
    if (this.#ends.length < 2 || this.#input.value === '' || this.metres) return '';
    return t('A length is from 0.1 centimetres to 100,000.');
  }

  /**
   * @param {CaptureFrame} frame
   * @returns {MeasuredLength | null}
   */
  recipe(frame) {
    return this.metres ? frame.lengthToCapture(this.#ends, this.metres) : null;
  }

  /** How much larger the thing becomes. */
  get factor() {
    return this.metres ? this.metres / this.#ends[0].distanceTo(this.#ends[1]) : 1;
  }

  /**
   * @param {MeasuredLength | null} length of a recipe
   * @param {CaptureFrame} frame
   */
  show(length, frame) {
    this.#ends = length ? [frame.placeToAsset(length.start), frame.placeToAsset(length.end)] : [];
    this.#input.value = length ? String(Number((100 * length.metres).toPrecision(6))) : '';
    this.#draw();
    this.#describe();
  }

  /**
   * Adds a point; a third one begins anew.
   * @param {Picked} picked
   * @returns {boolean} whether there are two
   */
  add({ point }) {
    if (this.#ends.length === 2) this.#ends = [];
    if (this.#ends.length === 1 && this.#ends[0].distanceTo(point) < 1e-6) return false;
    this.#ends.push(point.clone());
    this.#draw();
    this.#tell();
    return this.#ends.length === 2;
  }

  #tell() {
    this.#describe();
    this.#onChange();
  }

  #describe() {
    const complete = this.#ends.length === 2;
    this.#input.disabled = !complete;
    if (this.#ends.length === 0) this.#said.textContent = t('Choose two points whose distance you know.');
    else if (!complete) this.#said.textContent = t('And the other one.');
    else {
      this.#said.textContent =
        this.fault ||
        t('Now they are {distance} apart.', { distance: centimetres(this.#ends[0].distanceTo(this.#ends[1])) });
    }
  }

  #draw() {
    dispose(this.object);
    this.object.clear();
    for (const end of this.#ends) this.object.add(createDot(end));
    const [start, end] = this.#ends;
    if (end) this.object.add(createLine(start, end));
  }
}

/** @param {number} metres */
const centimetres = (metres) => `${formatRounded(100 * metres)} cm`;
