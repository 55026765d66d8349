// The panel of the viewer's page with the notes that are pinned to a thing: everybody who sees the thing reads them, who manages it pins them.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { drawPins, findPin } from './note-pins.js';
import { orbitTo } from './camera-orbit.js';
import { pick, watchTaps } from '../graphics/picking.js';
import { deleteAt, getCachedJson, patchJson, postJson } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { OrbitControls } from '../vendor/three-0.187.0.orbit-controls.js' */
/** @import { Stage } from '../graphics/scene.js' */
/** @import { Note, NoteList, Triple } from '../shared/types.d.ts' */
/** @import { SceneItem } from '../scenes/scene-item.js' */
/** @typedef {{ at: Triple, normal: Triple }} Spot in the asset frame */
/** @typedef {{ controls: OrbitControls, redraw: () => void, onStart: () => void }} NotesCallbacks onStart is called before a place is chosen */

const panel = {
  details: element('notes', HTMLDetailsElement),
  canvas: element('stage', HTMLCanvasElement),
  list: element('notes-list', HTMLElement),
  said: element('notes-said', HTMLElement),
  trouble: element('notes-trouble', HTMLElement),
  form: element('notes-form', HTMLFormElement),
  text: element('notes-text', HTMLTextAreaElement),
  pin: element('notes-pin', HTMLButtonElement),
  cancel: element('notes-cancel', HTMLButtonElement),
};

/** The notes of one thing. */
export class Notes {
  #item;
  #stage;
  #callbacks;
  #mayPin = false;
  #version = 0;
  /** @type {Note[]} */
  #notes = [];
  /** @type {string} */
  #open = ''; // id of the note whose text stands in the scene
  /** @type {Spot | null} */
  #spot = null; // of the note that is being written
  #editing = ''; // id of the note that is being changed
  #choosing = false;
  #marks = new THREE.Group();

  /**
   * @param {SceneItem} item
   * @param {Stage} stage
   * @param {NotesCallbacks} callbacks
   */
  constructor(item, stage, callbacks) {
    this.#item = item;
    this.#stage = stage;
    this.#callbacks = callbacks;
    item.group.add(this.#marks);
    watchTaps(panel.canvas, (place) => this.#tap(place));
    panel.pin.addEventListener('click', () => this.#choose(!this.#choosing));
    panel.cancel.addEventListener('click', () => this.#write(null, ''));
    panel.form.addEventListener('submit', (event) => {
      event.preventDefault();
      attempt(panel.trouble, () => this.#save(), panel.form);
    });
    panel.details.addEventListener('toggle', () => panel.details.open && this.load());
    document.addEventListener('keydown', ({ key }) => key === 'Escape' && panel.details.open && this.#leave());
    stage.renderer.xr.addEventListener('sessionstart', () => this.#show());
    stage.renderer.xr.addEventListener('sessionend', () => this.#show());
  }

  /** Lets the person pin notes. */
  allowPinning() {
    this.#mayPin = true;
    panel.pin.hidden = false;
    this.#show();
  }

  /** Asks for the notes. */
  async load() {
    await attempt(panel.trouble, async () => {
      /** @type {NoteList} */
      const { notes, version } = await getCachedJson(ofShownTenant(this.#path));
      this.#notes = notes;
      this.#version = version;
      panel.details.hidden = notes.length === 0 && !this.#mayPin;
      this.#show();
    });
  }

  get #path() {
    return `/v1/assets/${encodeURIComponent(this.#item.key)}/notes`;
  }

  /** @param {boolean} choosing */
  #choose(choosing) {
    this.#choosing = choosing;
    panel.pin.setAttribute('aria-pressed', String(choosing));
    document.body.toggleAttribute('data-pinning', choosing);
    this.#say(choosing ? t('Choose the place on it: tap it, or press Enter for the middle of the view.') : '');
    if (!choosing) return;
    this.#callbacks.onStart();
    panel.canvas.focus();
  }

  /** @param {THREE.Vector2} place in the view, from -1 to 1 */
  #tap(place) {
    const { renderer, camera } = this.#stage;
    if (renderer.xr.isPresenting || document.body.hasAttribute('data-measuring')) return;
    if (this.#choosing) {
      this.#pickSpot(place);
      return;
    }
    const found = findPin(this.#notes, this.#marks, place, camera, panel.canvas);
    if (found < 0) return;
    panel.details.open = true;
    this.#toggle(this.#notes[found], { turn: false });
  }

  /** @param {THREE.Vector2} place in the view */
  #pickSpot(place) {
    const { surface, group } = this.#item;
    const picked = surface ? pick(surface, place, this.#stage.camera) : null;
    if (!surface || !picked) {
      this.#say(t('There is nothing of it. Choose a point on the object.'));
      return;
    }
    const toGroup = group.matrixWorld.clone().invert().multiply(surface.matrixWorld);
    this.#choose(false);
    this.#write(
      { at: picked.point.applyMatrix4(toGroup).toArray(), normal: picked.normal.transformDirection(toGroup).toArray() },
      '',
    );
  }

  /**
   * Shows the form for a new note at a place, or for the one with this id; without both hides it.
   * @param {Spot | null} spot
   * @param {string} id
   */
  #write(spot, id) {
    this.#spot = spot;
    this.#editing = id;
    panel.form.hidden = !spot && !id;
    panel.text.value = this.#notes.find((note) => note.id === id)?.text ?? '';
    if (panel.form.hidden) return;
    panel.text.focus();
    this.#say('');
  }

  async #save() {
    const text = panel.text.value;
    if (this.#spot) await postJson(this.#path, { text, ...this.#spot });
    else await patchJson(`${this.#path}/${this.#editing}`, { text });
    this.#write(null, '');
    this.#say(t('Saved.'));
    await this.load();
  }

  /** @param {Note} note */
  async #remove({ id }) {
    await deleteAt(`${this.#path}/${id}`);
    this.#say(t('Removed.'));
    await this.load();
    panel.pin.focus(); // the button that had the focus is gone
  }

  /**
   * Shows a note's text in the scene, or hides it again.
   * @param {Note} note
   * @param {{ turn: boolean }} options turn: whether the camera comes to where the note is seen from
   */
  #toggle(note, { turn }) {
    this.#open = this.#open === note.id ? '' : note.id;
    if (turn && this.#open) this.#turnTo(note);
    this.#show();
    const row = [...panel.list.children].find((each) => each instanceof HTMLElement && each.dataset.note === note.id);
    row?.scrollIntoView({ block: 'nearest' });
    row?.querySelector('button')?.focus();
  }

  /** @param {Note} note */
  #turnTo({ at, normal }) {
    const { matrixWorld } = this.#item.group;
    const place = new THREE.Vector3(...at).applyMatrix4(matrixWorld);
    const toward = normal
      ? new THREE.Vector3(...normal).transformDirection(matrixWorld)
      : place.clone().sub(this.#callbacks.controls.target);
    orbitTo(this.#callbacks.controls, toward);
  }

  #leave() {
    if (this.#choosing) this.#choose(false);
    else if (!panel.form.hidden) this.#write(null, '');
    else {
      panel.details.open = false;
      panel.details.querySelector('summary')?.focus();
    }
  }

  /** @param {string} text */
  #say(text) {
    panel.said.textContent = text;
  }

  /** Shows the list, and the pins. */
  #show() {
    panel.list.replaceChildren(...this.#notes.map((note, place) => this.#createRow(note, place)));
    const inHeadset = this.#stage.renderer.xr.isPresenting;
    drawPins(this.#marks, this.#notes, ({ id }) => inHeadset || id === this.#open);
    Object.assign(document.body.dataset, { notes: String(this.#notes.length), note: this.#open });
    this.#callbacks.redraw();
  }

  /**
   * @param {Note} note
   * @param {number} place
   */
  #createRow(note, place) {
    const row = create('li');
    row.dataset.note = note.id;
    const show = create('button', {
      type: 'button',
      textContent: `${place + 1}`,
      ariaLabel: t('Show note {place}', { place: place + 1 }),
    });
    show.setAttribute('aria-pressed', String(note.id === this.#open));
    show.addEventListener('click', () => this.#toggle(note, { turn: true }));
    row.append(
      show,
      create('p', { dir: 'auto', className: 'text', textContent: note.text }),
      create('p', { className: 'quiet', textContent: this.#facts(note) }),
    );
    if (this.#mayPin) {
      row.append(
        this.#createButton(t('Change'), t('Change note {place}', { place: place + 1 }), () =>
          this.#write(null, note.id),
        ),
      );
    }
    if (this.#mayPin) {
      row.append(
        this.#createButton(t('Remove'), t('Remove note {place}', { place: place + 1 }), (button) =>
          attempt(panel.trouble, () => this.#remove(note), button),
        ),
      );
    }
    return row;
  }

  /**
   * @param {string} verb
   * @param {string} name for who does not see which row it is in
   * @param {(button: HTMLButtonElement) => void} onClick
   */
  #createButton(verb, name, onClick) {
    const button = create('button', { type: 'button', className: 'link', textContent: verb, ariaLabel: name });
    button.addEventListener('click', () => onClick(button));
    return button;
  }

  /** @param {Note} note */
  #facts({ author, created, edited, version, frame }) {
    const date = new Date(edited || created).toLocaleDateString(undefined, { dateStyle: 'medium' });
    const displaced = frame === this.#version ? '' : t('pinned on version {version}: it may be displaced', { version });
    return [author, edited ? t('changed {date}', { date }) : date, displaced].filter(Boolean).join(' · ');
  }
}
