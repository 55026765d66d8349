// The wardrobe (/wardrobe/{collection}): the garments of a season, one after the other, on a dress dummy.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { dress } from './dressing.js';
import { loadGarmentRows, preload } from './garment-source.js';
import { WardrobeBoard } from './wardrobe-board.js';
import { addressOf, choiceIn, emptyText, secondsIn } from './wardrobe-choice.js';
import { WardrobePanel } from './wardrobe-panel.js';
import { cutText } from '../catalogue/collection-rows.js';
import { chooseGarments, hangingOf, otherLabels } from '../catalogue/garments.js';
import { BARE, DressDummy } from '../graphics/dress-dummy.js';
import { FILLED } from '../graphics/scene.js';
import { StickPush } from '../headset/stick-push.js';
import { GONE } from '../scenes/item-updates.js';
import { showError, showNotice, showNothing } from '../scenes/messages.js';
import { SceneItem, isLoaded, randomId } from '../scenes/scene-item.js';
import { child, element } from '../shared/dom.js';
import { isConnectionProblem, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { LoadedItem } from '../scenes/scene-item.js' */
/** @import { Choice } from '../catalogue/garments.js' */
/** @import { WardrobeState } from './wardrobe-panel.js' */
/** @import { CollectionRow } from '../shared/types.d.ts' */

/**
 * What the wardrobe asks and tells the viewer.
 * @typedef {object} WardrobeCallbacks
 * @property {THREE.Scene} scene
 * @property {THREE.Group} root the garment's and the dummy's place, which turns in a headset
 * @property {(items: SceneItem[]) => void} setItems shows these; those that are new are loaded, those that are missing are removed
 * @property {() => void} onChange is called when there is something new to draw and to say
 * @property {() => void} frameAll
 * @property {() => boolean} isVisible whether anybody looks at the page
 * @property {() => void} onResetView places the scene before a wearer again
 */

const EVERY_S = 20; // from one garment to the next: a whole turn, and a moment
const TURN_S = 15; // for a whole turn, as the turntable of the page
const OTHER_SIZE = [0.5, 1.1]; // of what the camera looks at: when the whole is less, or more, it looks anew

/** The garments of a collection, and which of them the dummy wears. */
export class Wardrobe {
  #collection;
  #callbacks;
  #dummy = new DressDummy();
  #panel;
  #board;
  #push = new StickPush();
  /** @type {CollectionRow[]} */
  #garments = [];
  /** @type {SceneItem | null} */
  #worn = null;
  /** @type {SceneItem | null} */
  #coming = null; // what is worn stays until it is there
  #framed = new THREE.Vector3();
  #timer = 0;
  #everySeconds = secondsIn(location.search);
  #request = 0; // an older one that is still loading shows nothing any more
  /** @type {WardrobeState} */
  #state;

  /**
   * @param {string} collection
   * @param {WardrobeCallbacks} callbacks
   */
  constructor(collection, callbacks) {
    this.#collection = collection;
    this.#callbacks = callbacks;
    const turns = !matchMedia('(prefers-reduced-motion: reduce)').matches;
    this.#state = {
      choice: choiceIn(location.search),
      labels: [],
      place: 0,
      count: 0,
      said: t('Loading …'),
      rotates: this.#everySeconds > 0,
      turns,
    };
    this.#everySeconds ||= EVERY_S;
    const actions = {
      onChoose: (/** @type {Choice} */ choice) => this.choose(choice),
      onStep: (/** @type {number} */ by) => this.step(by),
      onRotate: () => this.#rotate(!this.#state.rotates),
      onTurn: () => this.#show({ turns: !this.#state.turns }),
      onResetView: callbacks.onResetView,
    };
    this.#panel = new WardrobePanel(actions);
    this.#board = new WardrobeBoard(callbacks.scene, actions);
    callbacks.root.add(this.#dummy.object);
    if (turns) element('turn', HTMLButtonElement).click();
  }

  /** The board in the headset. */
  get board() {
    return this.#board;
  }

  /** What a wearer is told who does not know it yet. */
  get help() {
    return [
      t('The right stick to the side, or a pinch on the garment: another one.'),
      t('A or X shows the board and hides it.'),
    ];
  }

  /** The box of the dummy or plinth with what it shows, in the frame of the root. */
  get box() {
    const box = this.#dummy.box;
    const item = this.#worn;
    return item && isLoaded(item) ? box.union(item.box.applyMatrix4(item.group.matrix)) : box;
  }

  /** The same with what the controls cover under it: the camera looks at so much. */
  get view() {
    const { box } = this;
    const covered = Math.min(0.5, child(document.body, 'footer', HTMLElement).offsetHeight / innerHeight);
    const [filled, free] = [FILLED[1], (1 + FILLED[1]) / 2 - covered];
    if (filled > free) box.min.y -= (box.max.y - box.min.y) * (filled / free - 1);
    return box;
  }

  /** Shows the garments that the page's address asks for, without one those of this season. */
  async open() {
    await this.choose(this.#state.choice);
    this.#callbacks.frameAll();
  }

  /**
   * Shows the garments of a choice, from the one on that is shown already.
   * @param {Choice} choice
   */
  async choose(choice) {
    const request = ++this.#request;
    this.#show({ choice, said: t('Loading …') });
    try {
      const { rows, isCut } = await loadGarmentRows(this.#collection);
      if (request !== this.#request) return;
      history.replaceState(null, '', addressOf(choice));
      this.#show({ labels: otherLabels(rows), place: 0 });
      if (isCut) showNotice(cutText());
      this.#list(chooseGarments(rows, choice), emptyText(choice));
    } catch (error) {
      if (request !== this.#request) return;
      this.#show({ said: toProblem(error).message });
      if (this.#worn) showNotice(this.#state.said, { stays: true });
      else showError(error, { canRetry: true });
    }
  }

  /**
   * Shows the next garment, or one before.
   * @param {number} by 1: the next one, -1: the one before
   */
  step(by) {
    const { count, place } = this.#state;
    if (count > 0) this.#bring((place + by + count) % count);
  }

  /**
   * Dresses the dummy in an item that has come, or in its new version.
   * @param {SceneItem} item
   */
  wear(item) {
    const row = this.#garments.find(({ key }) => key === item.key);
    if (!isLoaded(item) || (item !== this.#coming && item !== this.#worn)) return;
    if (item === this.#coming) [this.#worn, this.#coming] = [item, null];
    dress(item, row ? hangingOf(row) : null, this.#dummy);
    this.#callbacks.setItems([item]);
    this.#show({ said: item.name });
    this.#frameIfOther();
    this.#rotate(this.#state.rotates);
    const { place, count } = this.#state;
    if (count > 1) preload(this.#garments[(place + 1) % count].key);
  }

  /**
   * Says why a garment does not come, and goes on to the next one. Without a connection nothing else would come either: what is worn stays.
   * @param {SceneItem} item
   * @param {unknown} error
   */
  fail(item, error) {
    const { code, message } = toProblem(error);
    if (item !== this.#coming && !GONE.includes(code)) return; // a newer version that did not come
    const name = this.#garments.find(({ key }) => key === item.key)?.label ?? item.name;
    showNotice(`${name}: ${message}`, { stays: true });
    if (!isConnectionProblem(error)) {
      this.#list(
        this.#garments.filter(({ key }) => key !== item.key),
        message,
      );
    } else this.#stay(message);
  }

  /**
   * Turns the dummy before a wearer. To be called before each frame in a headset.
   * @param {number} seconds since the last frame
   */
  update(seconds) {
    const { root } = this.#callbacks;
    if (!this.#state.turns) return;
    root.rotation.y += (2 * Math.PI * seconds) / TURN_S;
    root.updateMatrixWorld(true);
  }

  /**
   * Shows the next garment, or the one before, where the stick is pushed to the side.
   * @param {number} x of the thumbstick
   */
  steer(x) {
    const push = this.#push.read(x);
    if (push) this.step(push);
  }

  /** @param {string} mode of the headset: "vr", "ar", or "" */
  showMode(mode) {
    this.#dummy.showShadow(mode !== 'ar'); // in passthrough the room's own floor is where nobody knows
    if (!mode) this.#board.hide();
  }

  /**
   * Goes through other garments, from the one on that is worn, else from the place on that is shown.
   * @param {CollectionRow[]} garments
   * @param {string} emptyReason why there are none
   */
  #list(garments, emptyReason) {
    const before = this.#state.place;
    const worn = garments.findIndex(({ key }) => key === this.#worn?.key);
    this.#garments = garments;
    this.#show({ count: garments.length });
    if (garments.length > 0) this.#bring(worn >= 0 && !this.#coming ? worn : before % garments.length);
    else this.#bare(emptyReason);
  }

  /** @param {string} reason why the dummy wears nothing */
  #bare(reason) {
    this.#worn = this.#coming = null;
    this.#dummy.wear(BARE);
    this.#callbacks.setItems([]);
    showNothing(t('Wardrobe'), reason);
    this.#show({ place: 0, said: reason });
    this.#frameIfOther();
  }

  /** @param {string} reason why nothing else comes */
  #stay(reason) {
    const worn = this.#worn;
    this.#coming = null;
    this.#callbacks.setItems(worn ? [worn] : []);
    if (!worn) showNothing(t('Wardrobe'), reason);
    this.#show({
      said: worn?.name ?? reason,
      place: Math.max(
        0,
        this.#garments.findIndex(({ key }) => key === worn?.key),
      ),
    });
    this.#rotate(this.#state.rotates); // then it is tried again
  }

  /** @param {number} place of a garment, which is loaded */
  #bring(place) {
    const { key, label } = this.#garments[place];
    this.#show({ place, said: label });
    if (this.#worn?.key === key && this.#worn.entry) {
      this.#coming = null;
      this.#callbacks.setItems([this.#worn]);
      return;
    }
    this.#coming = new SceneItem(key, {
      id: randomId(),
      asset: key,
      position_m: [0, 0, 0],
      rotation: [0, 0, 0, 1],
      scale: 1,
    });
    this.#callbacks.setItems(this.#worn ? [this.#worn, this.#coming] : [this.#coming]);
  }

  /** @param {boolean} rotates whether the next garment comes by itself, after a while from now on */
  #rotate(rotates) {
    clearTimeout(this.#timer);
    this.#show({ rotates });
    if (!rotates) return;
    this.#timer = setTimeout(() => {
      if (this.#callbacks.isVisible() && this.#state.count > 1) this.step(1);
      else this.#rotate(true);
    }, 1000 * this.#everySeconds);
  }

  /** Shows all of it where it does not fit in the view, or is lost in it; otherwise the camera stays where the person has it. */
  #frameIfOther() {
    const size = this.box.getSize(new THREE.Vector3());
    const factor = Math.max(...size.toArray().map((side, axis) => side / this.#framed.getComponent(axis)));
    if (factor >= OTHER_SIZE[0] && factor <= OTHER_SIZE[1]) return;
    this.#framed.copy(size);
    this.#callbacks.frameAll();
  }

  /** @param {Partial<WardrobeState>} changed */
  #show(changed) {
    Object.assign(this.#state, changed);
    this.#panel.show(this.#state, this.#garments[this.#state.place]?.key ?? '');
    this.#board.show(this.#state);
    document.body.dataset.worn = this.#worn?.key ?? ''; // for tests and for scripts
    this.#callbacks.onChange();
  }
}
