// The scene that the page shows, as something that is saved, named, added to and deleted: a draft on this page, or a document on the server.
import { hidePanelsOfOne, offerAdding, offerScene } from './panels.js';
import { showNotice } from '../scenes/messages.js';
import { MoveReports, sender } from '../scenes/move-reports.js';
import { SavedScene, loadScene } from '../scenes/saved-scene.js';
import { isLoaded } from '../scenes/scene-item.js';
import { isSame } from '../scenes/scene-merge.js';
import { deleteAt, postJson } from '../shared/api.js';
import { Problem, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { LiveMoves } from '../scenes/live-moves.js' */
/** @import { SceneItem } from '../scenes/scene-item.js' */
/** @import { SceneContent } from '../scenes/scene-merge.js' */
/** @import { MovingEvent, PlacedAsset, SceneDocument, Session } from '../shared/types.d.ts' */

/** Most things of a scene, as the server has it. */
export const MOST_ITEMS = 50;

/**
 * What a room asks and tells the viewer.
 * @typedef {object} RoomCallbacks
 * @property {() => SceneItem[]} items
 * @property {(items: SceneItem[]) => void} setItems shows these; those that are new are loaded, those that are missing are removed
 * @property {(item: SceneItem) => Promise<void>} load waits until a thing has come, or could not be loaded
 * @property {(item: SceneItem) => boolean} isHeld whether a hand or the mouse has the item
 * @property {LiveMoves} live what others are moving
 * @property {() => boolean} isVisible whether anybody looks at the page
 * @property {() => boolean} isWorn whether somebody is in the headset
 * @property {(key: string, placed: PlacedAsset | null) => SceneItem} createItem
 * @property {() => void} onChange is called when names or places have changed
 */

/** The scene that the page shows. */
export class Room {
  name = ''; // of the scene; '' for what is not saved
  #callbacks;
  /** @type {SavedScene | null} */
  #saved = null;
  #maySave = false;
  #mayAdd = false;
  #reports;
  /** Shows in the scene's panel whether it is saved. */
  #updatePanel = () => {};
  /** Takes away the notice that it is not. */
  #clearTrouble = () => {};

  /** @param {RoomCallbacks} callbacks */
  constructor(callbacks) {
    this.#callbacks = callbacks;
    this.#reports = new MoveReports({ isHeld: callbacks.isHeld, send: async (report) => this.#saved?.report(report) });
  }

  get isSaved() {
    return this.#saved !== null;
  }

  /** Whether things may be added here. */
  get mayAdd() {
    return this.#mayAdd;
  }

  /** Saves the scene under the time's name, for a wearer who cannot type; null where it is saved already, or may not be saved. */
  get saving() {
    return this.#saved || !this.#maySave
      ? null
      : () => this.save(t('Scene of {date}', { date: new Date().toLocaleString() }));
  }

  /** The collection from which things are added. */
  collection = () => this.#callbacks.items()[0]?.entry?.collections?.[0] ?? 'default';

  /**
   * Opens a scene of the server.
   * @param {string} id
   * @throws {Problem} as `getJson`
   */
  async open(id) {
    const document = await loadScene(id);
    this.#callbacks.setItems(document.items.map((placed) => this.#callbacks.createItem(placed.asset, placed)));
    this.#follow(document);
  }

  /**
   * Offers to save the scene and to add things to somebody who may; to name, share and delete one that is saved.
   * @param {Session | null} session
   */
  offer(session) {
    if (!session || ofShownTenant('') !== '') return;
    this.#maySave = session.scopes.includes('manage');
    this.#mayAdd = session.scopes.includes('read') && (this.#maySave || !this.#saved);
    if (this.#mayAdd) offerAdding((key) => this.add(key), this.collection);
    if (!this.#maySave) return;
    this.#updatePanel = offerScene({
      id: () => this.#saved?.id ?? '',
      canShare: session.via === 'session',
      name: () => this.name,
      onSave: (name) => this.save(name),
      onDelete: () => this.delete(),
    });
  }

  /**
   * Adds a thing. Where it stands is known once it is loaded.
   * @param {string} key of the asset
   */
  add(key) {
    const { items, setItems, createItem } = this.#callbacks;
    if (items().length >= MOST_ITEMS) {
      showNotice(t('A scene has at most {most} objects.', { most: MOST_ITEMS }));
      return;
    }
    hidePanelsOfOne();
    for (const item of items().filter(isLoaded)) item.fix();
    const item = createItem(key, null);
    item.isNew = true;
    setItems([...items(), item]);
  }

  /** Saves soon what was moved, added or removed. Nothing happens with what is not saved on the server. */
  touch() {
    this.#saved?.touch();
  }

  /**
   * Shows others on its way what is moved here.
   * @param {SceneItem} item
   */
  report(item) {
    if (this.#saved?.maySave) this.#reports.touch(item);
  }

  /**
   * Saves the scene under a name: a new one, or the one that the page shows.
   * @param {string} name
   * @throws {Problem} THINGS_MISSING, and as `postJson`
   */
  async save(name) {
    if (this.#saved) {
      this.name = name;
      this.#callbacks.onChange();
      this.touch();
      return;
    }
    await this.#fixAll();
    /** @type {SceneDocument} */
    const document = await postJson('/v1/scenes', { ...this.#content(), name });
    if (this.#callbacks.isWorn()) {
      history.replaceState(null, '', document.view);
    } // to load another page would end the session
    else location.assign(document.view);
    this.#follow(document); // until the other page is there, too: who presses again saves the same scene
  }

  /**
   * Makes all things part of the scene, each where it stands. Waits for those on their way: before it is loaded a thing has no place.
   * @throws {Problem} THINGS_MISSING
   */
  async #fixAll() {
    const { items, load } = this.#callbacks;
    const missing = () => items().filter((item) => !item.placed && !isLoaded(item));
    await Promise.all(missing().map(load));
    const names = missing()
      .map(({ name }) => name)
      .join(', ');
    if (names) {
      const hints = [t('Wait for what is missing and save again, or take it away.')];
      throw new Problem({ code: 'THINGS_MISSING', detail: t('Not loaded yet: {names}.', { names }), hints });
    }
    for (const item of items().filter(isLoaded)) item.fix();
  }

  /**
   * Deletes the scene from the server.
   * @throws {Problem} as `deleteAt`
   */
  async delete() {
    const saved = this.#saved;
    if (!saved) return;
    await deleteAt(`/v1/scenes/${saved.id}`);
    saved.end();
    location.assign('/browse/default');
  }

  /** @param {SceneDocument} document as the page shows it */
  #follow(document) {
    this.name = document.name;
    this.#saved = new SavedScene(document, {
      content: () => this.#content(),
      show: (content) => this.#show(content),
      onLost: (ids) => showNotice(lostText(ids.map((id) => this.#nameOf(id))), { stays: true }),
      onTrouble: (error) => this.#reportTrouble(error),
      onSaved: () => this.#reportSaved(),
      onMoving: (moving) => this.#showMoving(moving),
      onDeleted: () => this.#end(),
      isVisible: this.#callbacks.isVisible,
    });
    this.#callbacks.onChange();
    this.#updatePanel();
    this.#reportSaved();
  }

  /** @returns {SceneContent} */
  #content() {
    return { name: this.name, items: this.#callbacks.items().flatMap(({ placed }) => placed ?? []) };
  }

  /**
   * Shows what others have changed. What a hand holds goes on in that hand.
   * @param {SceneContent} content
   */
  #show({ name, items }) {
    const { items: shown, setItems, createItem, isHeld, live, onChange } = this.#callbacks;
    this.name = name;
    const present = new Map(shown().map((item) => [item.placed?.id, item]));
    const all = items.map((placed) => {
      const item = present.get(placed.id) ?? createItem(placed.asset, placed);
      const isNew = !isSame(item.placed ?? undefined, placed);
      if (isNew) item.adopt(placed);
      if (!live.has(item) && !isHeld(item)) item.place();
      else if (isNew) live.settle(item);
      return item;
    });
    setItems([...all, ...shown().filter(({ placed }) => !placed)]); // what was just added has no place yet
    onChange();
    this.#reportSaved();
  }

  /**
   * Shows on its way what somebody else is moving; not what was moved here and is not saved yet.
   * @param {MovingEvent} moving
   */
  #showMoving(moving) {
    const { items, isHeld, live } = this.#callbacks;
    const item = items().find(({ placed }) => placed?.id === moving.id);
    if (moving.sender !== sender && item?.placed && this.#saved?.isSaved(item.placed) && !isHeld(item)) {
      live.hear(item, moving);
    }
  }

  /** @param {string} id of a thing; '' means the scene */
  #nameOf(id) {
    return (
      this.#callbacks.items().find(({ placed }) => placed?.id === id)?.name ??
      (id ? t('An object') : t('The scene’s name'))
    );
  }

  #reportSaved() {
    if (!this.#saved) return;
    const { id, version, isDirty } = this.#saved;
    Object.assign(document.body.dataset, { scene: `${id} ${version}`, saved: isDirty ? 'no' : 'yes' });
    if (!isDirty) this.#clearTrouble();
  }

  /** Somebody has deleted the scene: from now on the page shows a draft, which may be saved as a new one. */
  #end() {
    this.#saved?.end();
    this.#saved = null;
    delete document.body.dataset.scene;
    document.body.dataset.saved = 'no';
    this.#updatePanel();
    this.#clearTrouble = showNotice(t('This scene was deleted. What you see here is kept nowhere.'), { stays: true });
  }

  /** @param {unknown} error */
  #reportTrouble(error) {
    const { code, message } = toProblem(error);
    document.body.dataset.saved = this.#saved?.isDirty ? 'no' : 'yes';
    if (code === 'SCENE_UNKNOWN') this.#end();
    else if (this.#saved?.isDirty) {
      this.#clearTrouble = showNotice(t('Not saved yet, trying again: {reason}', { reason: message }), { stays: true });
    }
  }
}

/** @param {string[]} names of things that others moved, too */
function lostText(names) {
  const [first, ...others] = names;
  return others.length > 0
    ? t(
        '{name} and {count} more were changed by somebody else at the same time, and stand as they have it. Change them again if you want it otherwise.',
        { name: first, count: others.length },
      )
    : t(
        '{name} was changed by somebody else at the same time, and stands as they have it. Change it again if you want it otherwise.',
        { name: first },
      );
}
