// The planes that are cut away: chosen on the thing, moved by a slider, turned round, taken away.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { CaptureFrame } from '../graphics/capture-frame.js' */
/** @import { Picked } from '../graphics/picking.js' */
/** @import { CutPlane } from '../shared/types.d.ts' */

const MOST = 20; // planes of a recipe
const REACH = 0.1; // of the slider to both sides, of the thing's size
const BEGIN = 0.01; // in front of what was chosen, so that the plane's own points, which are noisy, go too

/** @typedef {{ point: THREE.Vector3, normal: THREE.Vector3, away: number, quad: THREE.Mesh }} Entry with the normal to what is kept, and metres in front of the point */

/** The list of planes, and how they are drawn. */
export class PlaneList {
  object = new THREE.Group();
  /** @type {Entry[]} */
  #entries = [];
  #size = 1;
  #list = element('planes', HTMLUListElement);
  #onChange;

  /** @param {() => void} onChange */
  constructor(onChange) {
    this.#onChange = onChange;
  }

  /** Whether a recipe has room for another one. */
  get isFull() {
    return this.#entries.length >= MOST;
  }

  /** The planes in the asset frame, kept side in front. */
  get planes() {
    return this.#entries.map((entry) => new THREE.Plane().setFromNormalAndCoplanarPoint(entry.normal, placeOf(entry)));
  }

  /**
   * @param {CaptureFrame} frame
   * @returns {CutPlane[]}
   */
  recipe(frame) {
    return this.#entries.map((entry) => ({
      point: frame.placeToCapture(placeOf(entry)),
      normal: frame.directionToCapture(entry.normal),
    }));
  }

  /**
   * Shows the planes of a recipe.
   * @param {CutPlane[]} planes
   * @param {CaptureFrame} frame
   * @param {number} size of the thing in metres
   */
  show(planes, frame, size) {
    this.#size = size;
    this.#entries = planes.map(({ point, normal }) =>
      this.#entry(frame.placeToAsset(point), frame.directionToAsset(normal), 0),
    );
    this.#draw();
  }

  /**
   * Adds the plane that was chosen: what is on it and behind it goes.
   * @param {Picked} picked
   */
  add({ point, normal }) {
    this.#entries.push(this.#entry(point, normal, BEGIN * this.#size));
    this.#draw();
    this.#onChange();
  }

  /**
   * @param {THREE.Vector3} point
   * @param {THREE.Vector3} normal
   * @param {number} away
   * @returns {Entry}
   */
  #entry(point, normal, away) {
    const material = new THREE.MeshBasicMaterial({
      color: 0xd6453d,
      transparent: true,
      opacity: 0.18,
      side: THREE.DoubleSide,
      depthWrite: false,
    });
    const quad = new THREE.Mesh(new THREE.PlaneGeometry(this.#size * 0.7, this.#size * 0.7), material);
    return { point: point.clone(), normal: normal.clone(), away, quad };
  }

  #draw() {
    this.object.clear();
    for (const entry of this.#entries) {
      this.object.add(entry.quad);
      place(entry);
    }
    this.#list.replaceChildren(...this.#entries.map((entry, number) => this.#row(entry, number + 1)));
  }

  /**
   * @param {Entry} entry
   * @param {number} number
   */
  #row(entry, number) {
    const reach = String(REACH * this.#size);
    const slider = create('input', { type: 'range', min: `-${reach}`, max: reach, step: 'any' });
    slider.value = String(entry.away);
    slider.addEventListener('input', () => this.#change(entry, { away: Number(slider.value) }));
    const round = create('button', { type: 'button', textContent: t('Other side') });
    round.addEventListener('click', () => {
      this.#change(entry, { normal: entry.normal.clone().negate(), away: -entry.away });
      slider.value = String(entry.away);
    });
    const remove = create('button', {
      type: 'button',
      textContent: t('Remove'),
      ariaLabel: t('Remove plane {number}', { number }),
    });
    remove.addEventListener('click', () => {
      this.#entries = this.#entries.filter((each) => each !== entry);
      this.#draw();
      this.#onChange();
    });
    const label = create('label', { textContent: `${t('Plane {number}', { number })} ` });
    label.append(slider);
    const row = create('li');
    row.append(label, round, remove);
    return row;
  }

  /**
   * @param {Entry} entry
   * @param {Partial<Entry>} changes
   */
  #change(entry, changes) {
    Object.assign(entry, changes);
    place(entry);
    this.#onChange();
  }
}

/** @param {Entry} entry */
const placeOf = ({ point, normal, away }) => point.clone().addScaledVector(normal, away);

/**
 * Puts what is drawn of a plane where it is.
 * @param {Entry} entry
 */
function place(entry) {
  entry.quad.position.copy(placeOf(entry));
  entry.quad.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), entry.normal);
}
