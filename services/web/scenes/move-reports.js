// Tells those who look at the same scene where a thing is while it is moved here. Nothing of that is saved.
import { randomId } from './scene-item.js';

/** @import { SceneItem } from './scene-item.js' */
/** @import { Pose } from '../shared/types.d.ts' */
/** @typedef {Pose & { id: string }} MovedItem */
/** @typedef {{ sender: string, items: MovedItem[] }} Report */

const REPORT_MS = 100; // between two reports
const STILL_MS = 1000; // between two reports of a thing that is held still
const REFUSED_MS = 2000; // after a report that was refused or did not arrive: the server counts requests, and has to take the save
const MOST_MOVED = 8; // of one report, as the server takes them

/** @param {number} milliseconds */
const wait = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** Whose reports these are: this page's. */
export const sender = randomId();

/**
 * @typedef {object} ReportCallbacks
 * @property {(item: SceneItem) => boolean} isHeld whether it is still in a hand
 * @property {(report: Report) => Promise<unknown>} send
 */

/** Reports what is moved on this page, as long as it is. */
export class MoveReports {
  #callbacks;
  /** @type {Map<SceneItem, { text: string, at: number }>} */
  #sent = new Map(); // what was reported last, and when
  #isRunning = false;

  /** @param {ReportCallbacks} callbacks */
  constructor(callbacks) {
    this.#callbacks = callbacks;
  }

  /**
   * An item was moved, or is held.
   * @param {SceneItem} item
   */
  touch(item) {
    if (!this.#sent.has(item)) this.#sent.set(item, { text: '', at: 0 });
    if (!this.#isRunning) this.#run();
  }

  /** Sends one report after the other, never two at the same time: a slow network gets fewer of them. */
  async #run() {
    this.#isRunning = true;
    while (this.#sent.size > 0) {
      const items = this.#collect();
      const pause = wait(REPORT_MS);
      // One that is lost costs nothing: the next one has the newest place.
      if (items.length > 0) await this.#callbacks.send({ sender, items }).catch(() => wait(REFUSED_MS));
      await pause;
    }
    this.#isRunning = false;
  }

  /** @returns {MovedItem[]} what there is to report; what was reported where it was let go is forgotten */
  #collect() {
    const now = performance.now();
    const items = [];
    for (const [item, before] of [...this.#sent].slice(0, MOST_MOVED)) {
      const pose = item.pose;
      const text = JSON.stringify(pose);
      const isNew = text !== before.text;
      if (!item.placed || (!isNew && !this.#callbacks.isHeld(item))) this.#sent.delete(item);
      else if (isNew || now - before.at >= STILL_MS) {
        items.push({ id: item.placed.id, ...pose });
        this.#sent.set(item, { text, at: now });
      }
    }
    return items;
  }
}
