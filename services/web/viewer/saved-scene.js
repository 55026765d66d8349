// A scene on the server, kept in step with this page: saves what is changed here, and shows what others have changed.
import { isSameContent, mergeScenes } from './scene-merge.js';
import { getCachedJson, putJson } from '../shared/api.js';
import { Problem } from '../shared/problems.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { SceneContent } from './scene-merge.js' */
/** @import { SceneDocument } from '../shared/types.d.ts' */

const SAVE_MS = 500; // after a change: turns and pushes come in series
const POLL_MS = 4000; // between two looks for what others have changed, which cost 304 mostly
const MOST_TRIES = 5; // against others who save at the same time

/**
 * @typedef {object} SavedSceneCallbacks
 * @property {() => SceneContent} content what the page shows now
 * @property {(content: SceneContent) => void} show is called with what the page has to show, after others have changed it
 * @property {(ids: string[]) => void} onLost is called with things that others moved at the same time, and '' for the name: as they have it
 * @property {(error: unknown) => void} onTrouble is called where it could not be saved or read; it is tried again
 * @property {() => void} onSaved
 * @property {() => boolean} isVisible whether anybody looks at the page
 */

/** A scene on the server, and the version of it that this page knows. */
export class SavedScene {
  #document;
  #callbacks;
  #timer = 0;
  /** @type {Promise<void>} */
  #running = Promise.resolve();

  /**
   * @param {SceneDocument} document as the server has it, and as the page shows it
   * @param {SavedSceneCallbacks} callbacks
   */
  constructor(document, callbacks) {
    this.#document = document;
    this.#callbacks = callbacks;
    this.#wait(POLL_MS);
  }

  get id() {
    return this.#document.id;
  }

  get version() {
    return this.#document.version;
  }

  /** Whether this page has something that the server has not. */
  get isDirty() {
    return this.#document.may_save && !isSameContent(this.#document, this.#callbacks.content());
  }

  /** Saves soon: something was changed. */
  touch() {
    this.#wait(SAVE_MS);
  }

  /** Looks no more: the scene is deleted. */
  end() {
    clearTimeout(this.#timer);
    this.#wait = () => {};
  }

  /** @param {number} milliseconds */
  #wait = (milliseconds) => {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      this.#running = this.#running.then(() => this.#sync()).finally(() => this.#wait(POLL_MS));
    }, milliseconds);
  };

  /** Saves what was changed here, or shows what others have changed. */
  async #sync() {
    const { isVisible, onTrouble } = this.#callbacks;
    try {
      if (this.isDirty) await this.#save();
      else if (isVisible()) await this.#load();
    } catch (error) {
      onTrouble(error);
    }
  }

  async #save() {
    for (let attempt = 0; attempt < MOST_TRIES && this.isDirty; attempt++) {
      const { name, items } = this.#callbacks.content();
      try {
        /** @type {SceneDocument} */
        const saved = await putJson(addressOf(this.id), { name, items }, { 'If-Match': `"${this.version}"` });
        this.#document = saved;
        this.#callbacks.onSaved();
      } catch (error) {
        if (!(error instanceof Problem) || error.code !== 'SCENE_CHANGED') throw error;
        await this.#load();
      }
    }
  }

  /** Shows what others have changed, with what was changed here. */
  async #load() {
    const theirs = await loadScene(this.id);
    if (theirs.version <= this.version) return; // without the server it is the copy of before
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
