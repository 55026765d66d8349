// The panel of the viewer's page that measures a thing: distances, angles, heights and areas between points that are chosen on it.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { drawMeasurements } from './measure-marks.js';
import {
  LEAST_LOOP,
  POINTS,
  accuracyOf,
  detailText,
  measure,
  scaleSentences,
  trianglesOf,
  valueText,
} from './measurement.js';
import { pick, watchTaps } from '../graphics/picking.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { Stage } from '../graphics/scene.js' */
/** @import { AssetEntry, Manifest } from '../shared/types.d.ts' */
/** @import { Accuracy, Kind, Measurement } from './measurement.js' */
/** @import { SceneItem } from '../scenes/scene-item.js' */

/**
 * @typedef {object} MeasuringCallbacks
 * @property {(entry: AssetEntry) => Promise<Manifest>} loadManifest
 * @property {() => void} redraw
 * @property {() => void} onStart is called before points are chosen
 */

/** @type {Record<Kind, string>} */
const TITLES = { distance: t('Distance'), angle: t('Angle'), height: t('Height'), area: t('Area') };
/** @type {Record<Kind, string[]>} */
const PROMPTS = {
  distance: [t('Choose a point on it.'), t('And the other one.')],
  angle: [t('Choose a point on one side of the angle.'), t('Now its corner.'), t('And a point on its other side.')],
  height: [t('Choose the point whose height you want.')],
  area: [
    t('Choose the points around it, one after the other.'),
    t('The next one.'),
    t('The next one.'),
    t('The next one, or close the loop.'),
  ],
};
const NOTHING_THERE = t('There is nothing of it. Choose a point on the object.');
const CROSSES = t('The lines of this loop cross, so it has no inside. Take the last point back.');
const SAME_PLACE = t('Two of these points are one. Choose again.');
const CROSS_STEP = 0.05; // of half the view, by one key press
const CROSS_MOST = 0.95;
/** @type {Record<string, [x: number, y: number]>} */
const CROSS_KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const panel = {
  details: element('measure', HTMLDetailsElement),
  canvas: element('stage', HTMLCanvasElement),
  cross: element('cross', HTMLElement),
  kinds: element('measure-kinds', HTMLElement),
  said: element('measure-said', HTMLElement),
  close: element('measure-close', HTMLButtonElement),
  undo: element('measure-undo', HTMLButtonElement),
  clear: element('measure-clear', HTMLButtonElement),
  list: element('measure-list', HTMLElement),
  scale: element('measure-scale', HTMLElement),
};

/** Measuring on one thing. */
export class Measuring {
  #item;
  #stage;
  #callbacks;
  /** @type {Kind | ''} */
  #kind = '';
  /** @type {THREE.Vector3[]} */
  #points = []; // of the measurement that is not complete, in the asset frame
  /** @type {Measurement[]} */
  #measurements = [];
  /** @type {Accuracy} */
  #accuracy = { confidence: 'unknown', point_m: null, scale: 0, longest_m: 1 };
  #version = 0;
  #marks = new THREE.Group();
  #cross = new THREE.Vector2(); // in the view, from -1 to 1

  /**
   * @param {SceneItem} item
   * @param {Stage} stage
   * @param {MeasuringCallbacks} callbacks
   */
  constructor(item, stage, callbacks) {
    this.#item = item;
    this.#stage = stage;
    this.#callbacks = callbacks;
    item.group.add(this.#marks);
    watchTaps(
      panel.canvas,
      (place) => this.#tap(place),
      () => this.#cross,
    );
    panel.canvas.addEventListener('keydown', (event) => this.#moveCross(event), { capture: true });
    document.addEventListener('keydown', (event) => this.#leave(event));
    for (const button of this.#buttons) {
      button.addEventListener('click', () => this.#choose(this.#kind === button.dataset.kind ? '' : kindOf(button)));
    }
    panel.close.addEventListener('click', () => this.#complete());
    panel.undo.addEventListener('click', () => this.#takeBack());
    panel.clear.addEventListener('click', () => this.#remove(...this.#measurements));
    element('move', HTMLElement).addEventListener('click', () => this.#choose(''));
    panel.details.addEventListener('toggle', () => this.#choose(panel.details.open ? 'distance' : ''));
    this.#choose('distance');
  }

  /** Takes the accuracy of the version that is shown. To be called when there is a new one. */
  async update() {
    const { entry } = this.#item;
    if (!entry || entry.version === this.#version) return;
    this.#version = entry.version;
    const manifest = await this.#callbacks.loadManifest(entry).catch(() => /** @type {Manifest} */ ({ files: [] }));
    this.#accuracy = accuracyOf(entry, manifest);
    panel.scale.textContent = scaleSentences(entry, manifest);
    const last = this.#measurements.at(-1);
    if (last && this.#points.length === 0) this.#tell(last); // it was measured before this was known
    this.#show();
  }

  get #buttons() {
    return [...panel.kinds.querySelectorAll('button')];
  }

  /** @param {Kind | ''} kind that the next points measure; '' for none */
  #choose(kind) {
    this.#kind = kind;
    this.#points = [];
    for (const button of this.#buttons) button.setAttribute('aria-pressed', String(button.dataset.kind === kind));
    if (kind) {
      this.#callbacks.onStart();
      panel.canvas.focus();
    }
    document.body.toggleAttribute('data-measuring', kind !== '');
    this.#say(kind ? PROMPTS[kind][0] : '');
    this.#show();
  }

  /** @param {THREE.Vector2} place in the view, from -1 to 1 */
  #tap(place) {
    const { surface, group } = this.#item;
    if (!this.#kind || !surface || this.#stage.renderer.xr.isPresenting) return;
    const picked = pick(surface, place, this.#stage.camera);
    if (!picked) {
      this.#say(NOTHING_THERE);
      return;
    }
    this.#points.push(group.worldToLocal(surface.localToWorld(picked.point)));
    if (this.#points.length === POINTS[this.#kind]) this.#complete();
    else this.#prompt();
    this.#show();
  }

  /** Measures what the points are chosen for. */
  #complete() {
    const { surface, group } = this.#item;
    if (!this.#kind || !surface) return;
    const value = measure(this.#kind, this.#points, () => trianglesOf(surface, group));
    if (value === null && this.#kind === 'area') {
      this.#say(CROSSES);
      return;
    }
    if (value === null) this.#say(SAME_PLACE);
    else this.#add({ kind: this.#kind, points: this.#points, value, version: this.#version });
    this.#points = [];
    this.#show();
  }

  /** @param {Measurement} measurement */
  #add(measurement) {
    this.#measurements.push(measurement);
    this.#tell(measurement);
  }

  /** @param {Measurement} measurement */
  #tell(measurement) {
    this.#say(`${TITLES[measurement.kind]}: ${valueText(measurement, this.#accuracy)}.`);
  }

  /** @param {Measurement[]} removed */
  #remove(...removed) {
    this.#measurements = this.#measurements.filter((each) => !removed.includes(each));
    this.#say(removed.length === 1 ? t('Removed.') : t('All are removed.'));
    this.#show();
    (this.#measurements.length ? panel.clear : this.#buttons[0]).focus(); // the button that had the focus is gone
  }

  #takeBack() {
    this.#points.pop();
    this.#prompt();
    this.#show();
  }

  #prompt() {
    if (!this.#kind) return;
    const prompts = PROMPTS[this.#kind];
    this.#say(prompts[Math.min(this.#points.length, prompts.length - 1)]);
  }

  /** @param {KeyboardEvent} event */
  #leave(event) {
    if (event.key !== 'Escape' || !panel.details.open) return;
    if (this.#points.length) {
      this.#choose(this.#kind);
      return;
    }
    panel.details.open = false;
    panel.details.querySelector('summary')?.focus();
  }

  /** @param {KeyboardEvent} event */
  #moveCross(event) {
    const step = CROSS_KEYS[event.key];
    if (!this.#kind || !event.shiftKey || !step) return;
    event.preventDefault();
    event.stopImmediatePropagation(); // without Shift they turn the camera
    const [x, y] = this.#cross
      .toArray()
      .map((value, axis) => THREE.MathUtils.clamp(value + CROSS_STEP * step[axis], -CROSS_MOST, CROSS_MOST));
    this.#cross.set(x, y);
    Object.assign(panel.cross.style, { left: `${50 + 50 * x}%`, top: `${50 - 50 * y}%` });
  }

  /** @param {string} text */
  #say(text) {
    panel.said.textContent = text;
  }

  /** Shows the list, the buttons, and what stands in the scene. */
  #show() {
    const texts = this.#measurements.map((each) => valueText(each, this.#accuracy));
    panel.close.hidden = this.#kind !== 'area' || this.#points.length < LEAST_LOOP;
    panel.undo.hidden = this.#points.length === 0;
    panel.clear.hidden = this.#measurements.length === 0;
    panel.list.replaceChildren(...this.#measurements.map((each, place) => this.#createRow(each, texts[place])));
    const pending = this.#kind ? [{ kind: this.#kind, points: this.#points, text: '' }] : [];
    drawMeasurements(this.#marks, [
      ...this.#measurements.map((each, place) => ({ ...each, text: texts[place] })),
      ...pending,
    ]);
    document.body.dataset.measured = this.#measurements.map(({ kind, value }) => `${kind} ${value}`).join('; ');
    document.body.dataset.points = String(this.#points.length);
    this.#callbacks.redraw();
  }

  /**
   * @param {Measurement} measurement
   * @param {string} text
   */
  #createRow(measurement, text) {
    const { kind, version } = measurement;
    const row = create('li');
    const older = version === this.#version ? '' : t('Measured on version {version}.', { version });
    const facts = [detailText(measurement, this.#accuracy), older].filter(Boolean).join(' ');
    const words = create('p', { textContent: `${TITLES[kind]} ${text}` });
    const remove = create('button', {
      type: 'button',
      textContent: '✕',
      ariaLabel: t('Remove {name}', { name: `${TITLES[kind]} ${text}` }),
    });
    remove.addEventListener('click', () => this.#remove(measurement));
    row.append(words, remove, create('p', { className: 'quiet', textContent: facts }));
    return row;
  }
}

/** @param {HTMLButtonElement} button */
const kindOf = ({ dataset }) => /** @type {Kind} */ (dataset.kind);
