// Photos are looked at in a worker, or beside the page where a browser cannot draw in one.
import { PHOTO_WORKER_MS } from '../shared/time-limits.js';
import { lookAt } from './photo-quality.js';

const waiting = new Map(); // number of a question → what to do with its answer
let asked = 0;
let worker = null;
let mayWork = typeof Worker !== 'undefined' && typeof OffscreenCanvas !== 'undefined';
let before = Promise.resolve();
let silence = 0; // timer: a worker that has photos and says nothing is given up

/** What photo-quality.js tells of a file, or null for one that this browser cannot show. */
export function look(file) {
  if (!mayWork) return lookHere(file);
  worker ??= started();
  return new Promise((resolve) => {
    waiting.set(++asked, { file, resolve });
    worker.postMessage({ number: asked, file });
    if (waiting.size === 1) watch(worker);
  });
}

function started() {
  const made = new Worker('/web/capture/photo-quality-worker.js', { type: 'module' });
  made.addEventListener('message', ({ data: { number, look: found } }) => {
    waiting.get(number)?.resolve(found);
    waiting.delete(number);
    watch(made);
  });
  // A browser without module workers, or one that lost its connection: the photos are seen all the same.
  made.addEventListener('error', () => giveUp(made));
  return made;
}

/** Wait for the worker's next answer, while there is one to come. */
function watch(made) {
  clearTimeout(silence);
  if (waiting.size > 0) silence = setTimeout(() => giveUp(made), PHOTO_WORKER_MS);
}

/** End the worker, and look at its photos on the page. */
function giveUp(made) {
  clearTimeout(silence);
  made.terminate();
  mayWork = false;
  for (const { file, resolve } of waiting.values()) lookHere(file).then(resolve);
  waiting.clear();
}

function lookHere(file) {
  const found = before.then(() => lookAt(file, canvasOf)).catch(() => null);
  before = found;
  return found;
}

function canvasOf(width, height) {
  return Object.assign(document.createElement('canvas'), { width, height });
}
