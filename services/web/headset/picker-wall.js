// The wall in the headset from which things are added to the scene: twelve pictures at a time, labels to choose from, and a few buttons.
import { INK, paintButton, paintGround, paintTile } from './panel-paint.js';
import { PressPanel, reportPlaces, standBefore } from './press-panel.js';
import { ThingSearch } from '../scenes/find-things.js';
import { fetchBytes } from '../shared/network.js';
import { sentences } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { ArrayCamera, Scene } from '../vendor/three-0.187.0.module.js' */
/** @import { Rectangle } from './press-panel.js' */
/** @import { FoundAsset } from '../shared/types.d.ts' */

/**
 * What the wall asks and does.
 * @typedef {object} PickerCallbacks
 * @property {() => string} collection that it shows
 * @property {(key: string) => void} onChoose
 * @property {() => (() => Promise<void>) | null} saving saves the scene; null where it is saved already, or may not be saved
 * @property {() => void} onResetView
 */

// Letters of 28 pixels are 35 mm high at 1.3 m: 1.5 degrees, twice the least that one reads without an effort.
const [WALL_PX, WALL_M, WALL_AWAY_M] = [/** @type {[number, number]} */ ([1280, 960]), 1.6, 1.3];
const [BUTTON_PX, BUTTON_M, BUTTON_AWAY_M] = [/** @type {[number, number]} */ ([360, 96]), 0.24, 0.6];
const BUTTON_TURN = Math.PI / 5; // to the left of what the wearer looks at first
const BUTTON_BELOW_M = 0.45; // under the eyes: at the height of the hands
const WALL_BELOW_M = 0.1;
const [EDGE, GAP, TITLE, ROW, TILE] = [32, 16, 60, 60, 218];
const COLUMNS = 4;
const MOST_LABELS = 6;

/** The wall, and the small panel beside the wearer that opens it. */
export class PickerWall {
  #callbacks;
  #wall = new PressPanel(WALL_PX, WALL_M);
  #button = new PressPanel(BUTTON_PX, BUTTON_M);
  /** @type {FoundAsset[]} */
  #things = [];
  /** @type {Map<string, ImageBitmap>} */
  #pictures = new Map(); // by key, of the page that is shown
  /** @type {string[]} */
  #labels = []; // of what the first page showed
  #label = ''; // that was chosen
  #search = new ThingSearch();
  #said = '';
  #isSaving = false;

  /**
   * @param {Scene} scene
   * @param {PickerCallbacks} callbacks
   */
  constructor(scene, callbacks) {
    this.#callbacks = callbacks;
    this.panels = [this.#wall, this.#button];
    scene.add(this.#wall.mesh, this.#button.mesh);
  }

  /**
   * Shows the small panel beside a wearer, who then need not know which button opens the wall.
   * @param {ArrayCamera} camera
   */
  offer(camera) {
    this.#button.paint((context) => {
      paintGround(context, BUTTON_PX);
      return [
        paintButton(context, [12, 12, BUTTON_PX[0] - 24, BUTTON_PX[1] - 24], {
          name: 'open',
          text: t('Add an object'),
          press: () => this.toggle(camera),
        }),
      ];
    });
    standBefore(this.#button, camera, { away: BUTTON_AWAY_M, below: BUTTON_BELOW_M, turn: BUTTON_TURN });
    reportPlaces(this.panels);
  }

  /** Hides all of it. */
  hide() {
    for (const panel of this.panels) panel.mesh.visible = false;
    reportPlaces(this.panels);
  }

  /**
   * Opens the wall before a wearer, or closes it.
   * @param {ArrayCamera} camera
   */
  toggle(camera) {
    if (this.#wall.isShown) {
      this.#close();
      return;
    }
    standBefore(this.#wall, camera, { away: WALL_AWAY_M, below: WALL_BELOW_M, turn: 0 });
    this.#show('', null);
  }

  #close() {
    this.#wall.mesh.visible = false;
    this.#wall.light(undefined);
    reportPlaces(this.panels);
  }

  /**
   * Shows a page of things.
   * @param {string} label
   * @param {string[] | null} pages of the search; null for the first one
   */
  async #show(label, pages) {
    [this.#label, this.#said, this.#things] = [label, t('Loading …'), []];
    this.#paint();
    /** @type {FoundAsset[]} */
    let things = [];
    try {
      const found = await this.#search.find(this.#callbacks.collection(), label, pages ?? undefined);
      if (!found) return; // something else has been chosen since
      things = found;
      this.#said = things.length === 0 ? t('Nothing is here yet.') : '';
      if (!label && !pages) this.#labels = commonLabels(things);
    } catch (error) {
      this.#said = sentences(error);
    }
    this.#things = things;
    this.#pictures.clear();
    this.#paint();
    await Promise.all(things.map((thing) => this.#loadPicture(thing)));
    if (this.#things === things) this.#paint();
  }

  /** @param {FoundAsset} thing */
  async #loadPicture({ key, preview }) {
    if (!preview) return;
    const answer = await fetchBytes(preview).catch(() => null);
    const picture = answer?.response.ok ? await createImageBitmap(new Blob([answer.bytes])).catch(() => null) : null;
    if (picture) this.#pictures.set(key, picture);
  }

  #paint() {
    this.#wall.paint((context) => {
      paintGround(context, WALL_PX);
      context.fillStyle = INK;
      context.font = '36px system-ui, sans-serif';
      context.textAlign = 'left';
      context.fillText(this.#said || t('Choose an object'), EDGE, EDGE + TITLE / 2, WALL_PX[0] - 2 * EDGE);
      return [...this.#paintLabels(context), ...this.#paintThings(context), ...this.#paintButtons(context)];
    });
    reportPlaces(this.panels);
  }

  /** @param {CanvasRenderingContext2D} context */
  #paintLabels(context) {
    const width = (WALL_PX[0] - 2 * EDGE + GAP) / (MOST_LABELS + 1) - GAP;
    return ['', ...this.#labels].map((label, place) =>
      paintButton(context, [EDGE + place * (width + GAP), EDGE + TITLE, width, ROW], {
        name: `label ${label}`,
        text: label || t('All'),
        isChosen: label === this.#label,
        press: () => this.#show(label, null),
      }),
    );
  }

  /** @param {CanvasRenderingContext2D} context */
  #paintThings(context) {
    const width = (WALL_PX[0] - 2 * EDGE + GAP) / COLUMNS - GAP;
    return this.#things.map(({ key, label }, place) => {
      const [column, row] = [place % COLUMNS, Math.floor(place / COLUMNS)];
      /** @type {Rectangle} */
      const at = [EDGE + column * (width + GAP), EDGE + TITLE + ROW + GAP + row * (TILE + GAP), width, TILE];
      paintTile(context, at, label, this.#pictures.get(key));
      return { name: `thing ${key}`, at, press: () => this.#choose(key) };
    });
  }

  /** @param {CanvasRenderingContext2D} context */
  #paintButtons(context) {
    const saving = this.#callbacks.saving();
    const { previous, next } = this.#search;
    const buttons = [
      previous && { name: 'previous', text: t('Previous'), press: () => this.#show(this.#label, previous) },
      next && { name: 'next', text: t('Next'), press: () => this.#show(this.#label, next) },
      saving && { name: 'save', text: t('Save scene'), press: () => this.#save(saving) },
      { name: 'reset view', text: t('Reset view'), press: () => this.#resetView() },
      { name: 'close', text: t('Close'), press: () => this.#close() },
    ];
    const width = (WALL_PX[0] - 2 * EDGE + GAP) / buttons.length - GAP;
    return buttons.flatMap((button, place) =>
      button ? paintButton(context, [EDGE + place * (width + GAP), WALL_PX[1] - EDGE - ROW, width, ROW], button) : [],
    );
  }

  /** @param {string} key */
  #choose(key) {
    this.#close();
    this.#callbacks.onChoose(key);
  }

  #resetView() {
    this.#close();
    this.#callbacks.onResetView();
  }

  /** @param {() => Promise<void>} saving */
  async #save(saving) {
    if (this.#isSaving) return; // pressed a second time
    this.#isSaving = true;
    this.#said = await saving().then(
      () => t('The scene is saved.'),
      (error) => sentences(error),
    );
    this.#isSaving = false;
    this.#paint();
  }
}

/**
 * The labels that most of these things have.
 * @param {FoundAsset[]} things
 */
function commonLabels(things) {
  /** @type {Map<string, number>} */
  const counts = new Map();
  for (const label of things.flatMap(({ labels }) => labels)) counts.set(label, (counts.get(label) ?? 0) + 1);
  return [...counts]
    .sort(([, one], [, other]) => other - one)
    .slice(0, MOST_LABELS)
    .map(([label]) => label);
}
