// Two versions on one picture, with a line between them that a slider moves: the other version lies in the frame of the one.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { create } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { Model } from './model.js' */
/** @import { Stage } from './scene.js' */

/** The other version, the slider, and how both are drawn. */
export class Comparison {
  /** @type {Model | null} */
  #other = null;
  #split = create('div', { id: 'split', hidden: true });
  #at = create('input', { id: 'split-at', type: 'range', min: '0', max: '100', value: '50' });
  #left = create('span', { id: 'split-left' });
  #right = create('span', { id: 'split-right' });

  /**
   * @param {HTMLElement} parent where the slider goes
   * @param {() => void} onChange
   */
  constructor(parent, onChange) {
    const label = create('label', {
      htmlFor: 'split-at',
      className: 'offscreen',
      textContent: t('Where the one version ends and the other begins'),
    });
    const names = create('p');
    names.append(this.#left, ' ', this.#right);
    this.#split.append(label, this.#at, names);
    parent.append(this.#split);
    this.#at.addEventListener('input', onChange);
  }

  /** Whether another version is shown. */
  get isOn() {
    return this.#other !== null;
  }

  /**
   * Shows another version to the right of the line; null ends it.
   * @param {Model | null} other
   * @param {string} left name of the one
   * @param {string} right name of the other
   */
  show(other, left = '', right = '') {
    this.#other?.dispose();
    this.#other = other;
    this.#split.hidden = other === null;
    this.#left.textContent = left;
    this.#right.textContent = right;
  }

  /**
   * Draws the scene: all of it, or one version on each side of the line.
   * @param {Stage} stage
   * @param {THREE.Object3D} one what is hidden to the right of the line
   */
  render({ renderer, scene, camera }, one) {
    if (!this.#other) {
      renderer.render(scene, camera);
      return;
    }
    const { x: width, y: height } = renderer.getSize(new THREE.Vector2());
    const edge = Math.round((width * Number(this.#at.value)) / 100);
    renderer.setScissorTest(true);
    for (const [start, end, shows] of /** @type {[number, number, boolean][]} */ ([
      [0, edge, true],
      [edge, width, false],
    ])) {
      if (end <= start) continue;
      one.visible = shows;
      this.#other.object.visible = !shows;
      renderer.setScissor(start, 0, end - start, height);
      renderer.render(scene, camera);
    }
    one.visible = true;
    renderer.setScissorTest(false);
  }
}
