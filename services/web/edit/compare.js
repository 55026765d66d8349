// Two versions on one picture, with a line between them: the other version lies in the frame of the one that is edited.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { element } from '../shared/dom.js';

/** @import { Model } from '../graphics/model.js' */
/** @import { Stage } from '../graphics/scene.js' */

const page = {
  split: element('split', HTMLElement),
  at: element('split-at', HTMLInputElement),
  left: element('split-left', HTMLElement),
  right: element('split-right', HTMLElement),
};

/** The other version, and how both are drawn. */
export class Comparison {
  /** @type {Model | null} */
  #other = null;

  /** @param {() => void} onChange */
  constructor(onChange) {
    page.at.addEventListener('input', onChange);
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
    page.split.hidden = other === null;
    page.left.textContent = left;
    page.right.textContent = right;
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
    const edge = Math.round((width * Number(page.at.value)) / 100);
    renderer.setScissorTest(true);
    for (const [start, end, shows] of /** @type {[number, number, boolean][]} */ ([[0, edge, true], [edge, width, false]])) {
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
