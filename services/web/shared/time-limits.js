// Time limits, in milliseconds, of everything that pages wait for. Each wait ends in the thing itself or in a sentence with a button.
import { t } from './texts.js';

/** Without a single byte from the server. A phone that changes from one cell to the next is silent for some seconds. */
export const NETWORK_SILENCE_MS = 15_000;

/** The same, where the device has a copy that can be shown instead: a person waits no longer for something newer. */
export const CACHED_COPY_MS = 4_000;

/** For one operation of the browser's Cache Storage. It takes milliseconds on a phone, but much longer while other programs write. */
export const CACHE_STORAGE_MS = 10_000;

/** For the browser to keep a capture on the device, or to read it: 30 photos are 100 MB. */
export const KEPT_STORAGE_MS = 60_000;

/** For a mesh to come back from its worker (0.1 s on a phone). A late one costs little: the page then decodes the mesh itself. */
export const MESH_WORKER_MS = 10_000;

/** For a picture to come back from the transcoder's worker (1 s on a phone), or for that worker to start. */
export const PICTURE_WORKER_MS = 30_000;

/** For one level of detail to be decoded altogether, once its file is here. */
export const DECODE_MS = 90_000;

/** For the graphics driver to compile a level's shaders (2 s on a busy phone); without them it is drawn all the same. */
export const SHADER_MS = 10_000;

/** For the modules of the capture page's preview, a megabyte. Without them the page still links to the viewer. */
export const PREVIEW_MODULES_MS = 60_000;

/** Without a heartbeat of a job's event stream; the server sends one every 10 s. */
export const EVENTS_SILENCE_MS = 35_000;

/** For the server to check an upload once it has all of it: hundreds of photos take a minute. */
export const UPLOAD_CHECK_MS = 300_000;

/** For the server to say whether a file for another program is made: it answers within 20 s that it is being made. */
export const DOWNLOAD_ANSWER_MS = 60_000;

/** Between two attempts of an upload to go on: what is lost for a moment is back by then. */
export const UPLOAD_PAUSE_MS = 2_000;

/** For a photo's quality to come back from its worker (0.3 s on a phone). */
export const PHOTO_WORKER_MS = 30_000;

/** For the camera to start, or to take a photo (0.5 s on most phones). Afterwards frames of its film are taken. */
export const PHOTO_MS = 6_000;

/**
 * Wait for a promise, but no longer than a time limit. What the promise does later is ignored.
 * @template T
 * @param {Promise<T>} promise
 * @param {number} limitMs
 * @param {() => Error} [makeError] makes the error with which it rejects once the time is over
 * @returns {Promise<T>}
 */
export function withTimeLimit(
  promise,
  limitMs,
  makeError = () => new DOMException(t('The time limit is over.'), 'TimeoutError'),
) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(makeError()), limitMs);
    promise.then(resolve, reject).finally(() => clearTimeout(timer));
  });
}
