// The board of the wardrobe in the headset: what the dummy wears, seasons, the garment before and the next one.
import { INK, paintButton, paintGround } from './panel-paint.js';
import { PressPanel, reportPlaces, standBefore } from './press-panel.js';
import { countText, seasonName } from './wardrobe-panel.js';
import { SEASONS } from '../shared/garments.js';
import { t } from '../shared/texts.js';

/** @import { ArrayCamera, Scene } from '../vendor/three-0.187.0.module.js' */
/** @import { Choice } from '../shared/garments.js' */
/** @import { WardrobeState } from './wardrobe.js' */
/** @import { WardrobeActions } from './wardrobe-panel.js' */
/** @typedef {Parameters<typeof paintButton>[2]} Button */

// Letters of 28 pixels are 25 mm high at 1 m: 1.4 degrees, as on the wall of things.
const [PX, WIDTH_M] = [/** @type {[number, number]} */ ([1040, 424]), 0.94];
const WHERE = { away: 1, below: 0.3, turn: Math.PI / 5 }; // to the left of the dummy, at the height of the chest
const [EDGE, GAP, ROW] = [32, 16, 72];

/** A board that a ray can press. */
export class WardrobeBoard {
  #panel = new PressPanel(PX, WIDTH_M);
  #actions;
  /** @type {WardrobeState | null} */
  #state = null; // the last one that was shown

  /**
   * @param {Scene} scene
   * @param {WardrobeActions} actions
   */
  constructor(scene, actions) {
    this.#actions = actions;
    this.panels = [this.#panel];
    scene.add(this.#panel.mesh);
  }

  /**
   * Stands the board beside the dummy, before a wearer.
   * @param {ArrayCamera} camera
   */
  offer(camera) {
    standBefore(this.#panel, camera, WHERE);
    this.#paint();
  }

  /**
   * Shows the board before a wearer, or hides it.
   * @param {ArrayCamera} camera
   */
  toggle(camera) {
    if (this.#panel.isShown) this.hide();
    else this.offer(camera);
  }

  /** Hides it. */
  hide() {
    this.#panel.mesh.visible = false;
    this.#panel.light(undefined);
    reportPlaces(this.panels);
  }

  /** @param {WardrobeState} state */
  show(state) {
    this.#state = state;
    if (this.#panel.isShown) this.#paint();
  }

  #paint() {
    const state = this.#state;
    if (!state) return;
    this.#panel.paint((context) => {
      paintGround(context, PX);
      context.fillStyle = INK;
      context.textAlign = 'left';
      paintLine(context, state.said, 36, EDGE + ROW / 2);
      paintLine(context, countText(state), 28, EDGE + ROW);
      return this.#rows(state).flatMap((buttons, row) => paintRow(context, buttons, EDGE + (row + 1) * (ROW + GAP) + GAP));
    });
    reportPlaces(this.panels);
  }

  /**
   * @param {WardrobeState} state
   * @returns {Button[][]}
   */
  #rows({ choice, rotates, turns }) {
    const { onChoose, onStep, onRotate, onTurn, onResetView } = this.#actions;
    const choose = (/** @type {Choice} */ each, /** @type {string} */ text) => ({ name: each, text, isChosen: each === choice, press: () => onChoose(each) });
    return [
      [...SEASONS.map((season) => choose(season, seasonName(season))), choose('all', t('All'))],
      [
        { name: 'previous', text: t('Previous'), press: () => onStep(-1) },
        { name: 'next', text: t('Next'), press: () => onStep(1) },
        { name: 'rotate', text: t('Change by itself'), isChosen: rotates, press: onRotate },
      ],
      [
        { name: 'turn', text: t('Turn'), isChosen: turns, press: onTurn },
        { name: 'reset view', text: t('Reset view'), press: onResetView },
        { name: 'close', text: t('Close'), press: () => this.hide() },
      ],
    ];
  }
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {string} text
 * @param {number} size of the letters in pixels
 * @param {number} y
 */
function paintLine(context, text, size, y) {
  context.font = `${size}px system-ui, sans-serif`;
  context.fillText(text, EDGE, y, PX[0] - 2 * EDGE);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Button[]} buttons side by side
 * @param {number} y
 */
function paintRow(context, buttons, y) {
  const width = (PX[0] - 2 * EDGE + GAP) / buttons.length - GAP;
  return buttons.map((button, place) => paintButton(context, [EDGE + place * (width + GAP), y, width, ROW], button));
}
