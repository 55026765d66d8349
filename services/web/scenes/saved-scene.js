// A scene on the server, kept in step with this page: saves what is changed here, and follows what others change.
import { isSame, isSameContent, mergeScenes } from './scene-merge.js';
import { cacheAnswer, getCachedJson, postJson, putJson } from '../shared/api.js';
import { followEvents } from '../shared/event-stream.js';
import { Problem } from '../shared/problems.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { SceneContent } from './scene-merge.js' */
/** @import { Report } from './move-reports.js' */
/** @import { MovingEvent, PlacedAsset, SceneDocument } from '../shared/types.d.ts' */

const SAVE_MS = 500; // after a change: turns and pushes come in series
const POLL_MS = 4000; // between two looks for what others have changed, while no stream of events tells it
const MOST_TRIES = 5; // against others who save at the same time

/**
 * @typedef {object} SavedSceneCallbacks
 * @property {() => SceneContent} content what the page shows now
 * @property {(content: SceneContent) => void} show is called with what the page has to show, after others have changed it
 * @property {(ids: string[]) => void} onLost is called with things that others moved at the same time, and '' for the name: as they have it
 * @property {(error: unknown) => void} onTrouble is called where it could not be saved or read; it is tried again
 * @property {() => void} onSaved
 * @property {(moving: MovingEvent) => void} onMoving is called with where a thing is that somebody is moving, here or elsewhere
 * @property {() => void} onDeleted is called when somebody has deleted the scene
 * @property {() => boolean} isVisible whether anybody looks at the page
 */

/** A scene on the server, and the version of it that this page knows. */
export class SavedScene {
  #document;
  #callbacks;
  #timer = 0;
  #hasEnded = false;
  /** @type {(() => void) | null} */
  #stopFollowing = null; // while nobody looks at the page
  #isLive = false; // whether the stream of events is open
  /** @type {Promise<void>} */
  #running = Promise.resolve();

  /**
   * @param {SceneDocument} known as the server has it, and as the page shows it
   * @param {SavedSceneCallbacks} callbacks
   */
  constructor(known, callbacks) {
    this.#document = known;
    this.#callbacks = callbacks;
    this.#wait(POLL_MS);
    this.#followIfVisible();
    document.addEventListener('visibilitychange', this.#followIfVisible);
  }

  get id() {
    return this.#document.id;
  }

  get version() {
    return this.#document.version;
  }

  /** Whether this page has something that the server has not. */
  get isDirty() {
    return this.maySave && !isSameContent(this.#document, this.#callbacks.content());
  }

  /** Whether what is changed on this page is saved. */
  get maySave() {
    return this.#document.may_save;
  }

  /**
   * Whether a thing stands where the server has it.
   * @param {PlacedAsset} placed
   */
  isSaved(placed) {
    return isSame(
      placed,
      this.#document.items.find(({ id }) => id === placed.id),
    );
  }

  /**
   * Tells those who follow the scene where things are while they are moved.
   * @param {Report} report
   * @throws {Problem} as `postJson`
   */
  report(report) {
    return postJson(`${addressOf(this.id)}/moving`, report);
  }

  /** Saves soon: something was changed. */
  touch() {
    this.#wait(SAVE_MS);
  }

  /** Looks no more: the scene is deleted. */
  end() {
    clearTimeout(this.#timer);
    this.#hasEnded = true;
    this.#followIfVisible();
    document.removeEventListener('visibilitychange', this.#followIfVisible);
  }

  /** @param {number} milliseconds */
  #wait(milliseconds) {
    clearTimeout(this.#timer);
    if (this.#hasEnded) return;
    const timer = setTimeout(async () => {
      this.#followIfVisible(); // a headset's session may have begun or ended
      await this.#inTurn(() => this.#sync());
      if (this.#timer === timer) this.#wait(POLL_MS); // else something was changed meanwhile
    }, milliseconds);
    this.#timer = timer;
  }

  /**
   * Does something after what goes on: what an event says is not looked at before the answer to a save, of which it may tell.
   * @param {() => Promise<void>} step
   */
  #inTurn(step) {
    this.#running = this.#running.then(step).catch((error) => {
      if (!this.#hasEnded) this.#callbacks.onTrouble(error);
    });
    return this.#running;
  }

  /** Follows the scene while somebody looks at the page. */
  #followIfVisible = () => {
    const wanted = !this.#hasEnded && this.#callbacks.isVisible();
    if (wanted) this.#stopFollowing ??= this.#follow();
    else {
      this.#stopFollowing?.();
      this.#stopFollowing = null;
      this.#isLive = false;
    }
  };

  /** @returns {() => void} stops */
  #follow() {
    const lose = () => {
      this.#isLive = false;
    };
    return followEvents({
      address: () => ofShownTenant(`${addressOf(this.id)}/events?after=${this.version}`),
      events: {
        scene: (data) => this.#inTurn(() => this.#hear(data)),
        moving: (data) => this.#callbacks.onMoving(JSON.parse(data)),
        deleted: () => this.#callbacks.onDeleted(),
      },
      onOpen: () => {
        this.#isLive = true;
      },
      onBreak: lose,
      onLost: lose,
    });
  }

  /** @param {string} data a version of the scene */
  async #hear(data) {
    this.#show(JSON.parse(data));
    await cacheAnswer(ofShownTenant(addressOf(this.id)), data);
  }

  /** Saves what was changed here, or looks for what others have changed, of which no event tells. */
  async #sync() {
    if (this.isDirty) await this.#save();
    else if (!this.#isLive && this.#callbacks.isVisible()) await this.#load();
  }

  async #save() {
    for (let attempt = 0; attempt < MOST_TRIES && this.isDirty; attempt++) {
      const { name, items } = this.#callbacks.content();
      try {
        /** @type {SceneDocument} */
        const saved = await putJson(addressOf(this.id), { name, items }, { 'If-Match': `"${this.version}"` });
        this.#document = saved;
        if (!this.#hasEnded) this.#callbacks.onSaved();
      } catch (error) {
        if (!(error instanceof Problem) || error.code !== 'SCENE_CHANGED') throw error;
        await this.#load();
      }
    }
  }

  async #load() {
    this.#show(await loadScene(this.id));
  }

  /**
   * Shows what others have changed, with what was changed here.
   * @param {SceneDocument} theirs
   */
  #show(theirs) {
    if (this.#hasEnded || theirs.version <= this.version) return; // saved here, or without the server the copy of before
    const { lost, ...merged } = mergeScenes(this.#document, this.#callbacks.content(), theirs);
    this.#document = theirs;
    this.#callbacks.show(merged);
    if (lost.length > 0) this.#callbacks.onLost(lost);
    if (this.isDirty) this.touch();
  }
}

/**
 * Loads a scene; without the server, as it was at the last visit.
 * @param {string} id
 * @returns {Promise<SceneDocument>}
 * @throws {Problem} as `getJson`
 */
export const loadScene = (id) => getCachedJson(ofShownTenant(addressOf(id)));

/** @param {string} id */
const addressOf = (id) => `/v1/scenes/${encodeURIComponent(id)}`;
