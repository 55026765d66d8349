// Queue of photos to measure. A web worker measures them, or the page's own thread where a browser cannot draw in a worker.
import { measurePhoto } from './photo-quality.js';
import { PHOTO_WORKER_MS } from '../shared/time-limits.js';

/** @import { PhotoAnswer, PhotoQuality, PhotoRequest } from './photo-quality.js' */

/** @type {WeakMap<Blob, Promise<PhotoQuality | null>>} */
const measured = new WeakMap(); // the camera asks before a photo is chosen, and the guidance afterwards
/** @type {Map<number, { file: Blob, resolve: (quality: PhotoQuality | null) => void }>} */
const pending = new Map(); // by the number of the request
let lastNumber = 0;
/** @type {Worker | null} */
let worker = null;
let canUseWorker = typeof Worker !== 'undefined' && typeof OffscreenCanvas !== 'undefined';
/** @type {Promise<PhotoQuality | null>} */
let previous = Promise.resolve(null);
let silenceTimer = 0;

/**
 * Measures a photo, once. Resolves to null for a file that this browser cannot decode.
 * @param {Blob} file
 * @returns {Promise<PhotoQuality | null>}
 */
export function queuePhoto(file) {
  const quality = measured.get(file) ?? measureInTurn(file);
  measured.set(file, quality);
  return quality;
}

/**
 * @param {Blob} file
 * @returns {Promise<PhotoQuality | null>}
 */
function measureInTurn(file) {
  if (!canUseWorker) return measureHere(file);
  const target = (worker ??= startWorker());
  return new Promise((resolve) => {
    /** @type {PhotoRequest} */
    const request = { number: ++lastNumber, file };
    pending.set(request.number, { file, resolve });
    target.postMessage(request);
    if (pending.size === 1) limitSilence(target);
  });
}

/** Starts the worker. Without it, or after an error in it, the page's own thread measures the photos. */
function startWorker() {
  const started = new Worker('/web/capture/photo-quality-worker.js', { type: 'module' });
  started.addEventListener('message', (event) => {
    const { number, quality } = /** @type {PhotoAnswer} */ (event.data);
    pending.get(number)?.resolve(quality);
    pending.delete(number);
    limitSilence(started);
  });
  // A browser without module workers, or one that was offline when it loaded the worker.
  started.addEventListener('error', () => giveUp(started));
  return started;
}

/**
 * Waits for the worker's next answer, while there is one to come.
 * @param {Worker} started
 */
function limitSilence(started) {
  clearTimeout(silenceTimer);
  if (pending.size > 0) silenceTimer = setTimeout(() => giveUp(started), PHOTO_WORKER_MS);
}

/**
 * Ends the worker, and measures its photos on the page's own thread.
 * @param {Worker} started
 */
function giveUp(started) {
  clearTimeout(silenceTimer);
  started.terminate();
  canUseWorker = false;
  for (const { file, resolve } of pending.values()) measureHere(file).then(resolve);
  pending.clear();
}

/**
 * Measures a photo on the page's own thread, after the one before.
 * @param {Blob} file
 */
function measureHere(file) {
  previous = previous.then(() => measurePhoto(file, createCanvas)).catch(() => null);
  return previous;
}

/**
 * @param {number} width
 * @param {number} height
 */
function createCanvas(width, height) {
  return Object.assign(document.createElement('canvas'), { width, height });
}
