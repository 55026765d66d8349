// The board of the wardrobe in the headset: what the dummy wears, seasons and labels, the garment before and the next one.
import { countText, seasonName } from './wardrobe-panel.js';
import { SEASONS } from '../catalogue/garments.js';
import { INK, paintButton, paintGround } from '../headset/panel-paint.js';
import { PressPanel, reportPlaces, standBefore } from '../headset/press-panel.js';
import { t } from '../shared/texts.js';

/** @import { ArrayCamera, Scene } from '../vendor/three-0.187.0.module.js' */
/** @import { Choice } from '../catalogue/garments.js' */
/** @import { WardrobeActions, WardrobeState } from './wardrobe-panel.js' */
/** @typedef {Parameters<typeof paintButton>[2]} Button */

// Letters of 28 pixels are 25 mm high at 1 m: 1.4 degrees, as on the wall of things.
const [WIDTH, WIDTH_M] = [1040, 0.94];
const WHERE = { away: 1, below: 0.3, turn: Math.PI / 5 }; // to the left of the dummy, at the height of the chest
const [EDGE, GAP, ROW] = [32, 16, 72];
const HEAD = EDGE + ROW + 2 * GAP; // what is worn, and how many there are
const MOST_ROWS = 4;
const LABELS = 5; // in a row

/** A board that a ray can press. */
export class WardrobeBoard {
  #panel = new PressPanel([WIDTH, heightOf(MOST_ROWS)], WIDTH_M);
  #actions;
  #labelPage = 0; // of those labels that do not fit in a row
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
    const rows = this.#rows(state);
    this.#panel.paint((context) => {
      paintGround(context, [WIDTH, heightOf(rows.length)]);
      context.fillStyle = INK;
      context.textAlign = 'left';
      paintLine(context, state.said, 36, EDGE + ROW / 2);
      paintLine(context, countText(state), 28, EDGE + ROW);
      return rows.flatMap((buttons, row) => paintRow(context, buttons, HEAD + row * (ROW + GAP)));
    });
    reportPlaces(this.panels);
  }

  /**
   * @param {WardrobeState} state
   * @returns {Button[][]}
   */
  #rows({ choice, labels, rotates, turns }) {
    const { onStep, onRotate, onTurn, onResetView } = this.#actions;
    const choose = (/** @type {Choice} */ each, /** @type {string} */ text) => this.#choose(each, text, choice);
    return [
      [...SEASONS.map((season) => choose(season, seasonName(season))), choose('all', t('All'))],
      ...(labels.length > 0 ? [this.#labels(labels, choice)] : []),
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

  /**
   * The labels side by side; of many some, and a button for the others.
   * @param {string[]} labels
   * @param {Choice} choice
   * @returns {Button[]}
   */
  #labels(labels, choice) {
    const button = (/** @type {string} */ label) => this.#choose(`label:${label}`, label, choice);
    if (labels.length <= LABELS) return labels.map(button);
    const [shown, pages] = [LABELS - 1, Math.ceil(labels.length / (LABELS - 1))];
    const page = this.#labelPage % pages;
    const others = {
      name: 'other labels',
      text: `${page + 1} / ${pages} ›`,
      press: () => {
        this.#labelPage = page + 1;
        this.#paint();
      },
    };
    return [...labels.slice(page * shown, (page + 1) * shown).map(button), others];
  }

  /**
   * @param {Choice} choice
   * @param {string} text
   * @param {Choice} chosen
   * @returns {Button}
   */
  #choose(choice, text, chosen) {
    return { name: choice, text, isChosen: choice === chosen, press: () => this.#actions.onChoose(choice) };
  }
}

/** @param {number} rows of buttons */
function heightOf(rows) {
  return HEAD + rows * (ROW + GAP) - GAP + EDGE;
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {string} text
 * @param {number} size of the letters in pixels
 * @param {number} y
 */
function paintLine(context, text, size, y) {
  context.font = `${size}px system-ui, sans-serif`;
  context.fillText(text, EDGE, y, WIDTH - 2 * EDGE);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Button[]} buttons side by side
 * @param {number} y
 */
function paintRow(context, buttons, y) {
  const width = (WIDTH - 2 * EDGE + GAP) / buttons.length - GAP;
  return buttons.map((button, place) => paintButton(context, [EDGE + place * (width + GAP), y, width, ROW], button));
}
