// Sends large captures so that they go on after a lost connection, a locked phone, a reloaded page or a server that restarts (tus 1.0).
// What is sent is the form that a plain upload has. The browser's storage keeps which upload the chosen files belong to.
import { finishUpload, uploadCapture } from '../shared/api.js';
import { Problem, isConnectionProblem, isTemporary, noAnswer, offline, parseAnswer } from '../shared/problems.js';
import { NETWORK_SILENCE_MS, UPLOAD_PAUSE_MS } from '../shared/time-limits.js';
import { formOf, newFiletype, partOf, pathOf } from '../shared/upload-form.js';

/** @import { DetailedError, Upload } from '../vendor/tus-js-client-4.3.1.index.js' */
/** @import { About } from '../shared/upload-form.js' */
/** @import { CaptureReceipt } from '../shared/types.d.ts' */

const RESUMABLE_BYTES = 4 << 20; // of an upload that can go on; a smaller one is sent again within seconds
const CHUNK_BYTES = 16 << 20; // of one request; the server keeps also what comes of one that breaks off
const MOST_ATTEMPTS = 60; // without a byte that gets through: two minutes, or more while the phone sleeps
const REFUSED = [400, 409, 413, 415, 422]; // of a capture, for what it is
const KEPT_MS = 86_400_000; // the server forgets an upload a day after its last byte
const STORED = 'tus::'; // how the library begins the names of what it stores

/**
 * @typedef {object} Progress
 * @property {(fraction: number) => void} onProgress
 * @property {(fraction: number) => void} onWaiting is called when the connection is lost, and the upload waits to go on
 */

/**
 * Upload files as one capture, in a way that goes on where they are large.
 * @param {File[]} files
 * @param {string} name
 * @param {About} about
 * @param {Progress} progress
 * @returns {Promise<CaptureReceipt>}
 * @throws {Problem} OFFLINE, NO_ANSWER, and what the server says
 */
export async function sendCapture(files, name, about, progress) {
  const size = files.reduce((sum, file) => sum + file.size, 0);
  if (size < RESUMABLE_BYTES) {
    const send = (/** @type {(fraction: number) => void} */ onProgress) =>
      uploadCapture(files, name, about, onProgress);
    return persist(progress, send, (error) => isTemporary(error) && !isConnectionProblem(error));
  }
  const { Upload, defaultOptions } = await import('../vendor/tus-js-client-4.3.1.index.js').catch(() => {
    throw offline();
  });
  const fingerprint = JSON.stringify(files.map((file) => [pathOf(file), file.size, file.lastModified]));
  const stored = await defaultOptions.urlStorage.findUploadsByFingerprint(fingerprint);
  const filetype = stored[0]?.metadata.filetype ?? newFiletype();
  const url = await persist(progress, (onProgress) =>
    sendRest(Upload, formOf(files.map(partOf), filetype), {
      fingerprint: async () => fingerprint,
      metadata: { name, filetype, filename: pathOf(files[0]) },
      onProgress,
    }),
  );
  const forget = async () => {
    const entries = await defaultOptions.urlStorage.findUploadsByFingerprint(fingerprint);
    await Promise.all(entries.map((entry) => defaultOptions.urlStorage.removeUpload(entry.urlStorageKey)));
  };
  try {
    const receipt = await persist(progress, () => finishUpload(url, about));
    await forget();
    return receipt;
  } catch (error) {
    if (error instanceof Problem && REFUSED.includes(error.status)) {
      await Upload.terminate(url).catch(() => {}); // it expires
      await forget();
    }
    throw error;
  }
}

/** The names of files whose upload has stopped and can go on: the first file of each. @returns {string[]} */
export function unfinishedFiles() {
  try {
    const keys = Object.keys(localStorage).filter((key) => key.startsWith(STORED));
    /** @type {{ creationTime: string, metadata: Record<string, string> }[]} */
    const entries = keys.map((key) => JSON.parse(localStorage.getItem(key) ?? 'null'));
    return entries
      .filter((each) => Date.now() - Date.parse(each?.creationTime) < KEPT_MS)
      .map((each) => each.metadata.filename);
  } catch {
    return []; // no storage, or somebody else's entries
  }
}

/**
 * Repeat what fails for want of a connection. Attempts are counted from the last byte that got through.
 * @template T
 * @param {Progress} progress
 * @param {(onProgress: (fraction: number) => void) => Promise<T>} work
 * @param {(error: unknown) => boolean} again whether to try again after an error
 * @returns {Promise<T>}
 * @throws {Problem} the last one
 */
async function persist({ onProgress, onWaiting }, work, again = isTemporary) {
  let attempts = 0;
  let best = 0;
  for (;;) {
    try {
      return await work((fraction) => {
        if (fraction > best) attempts = 0;
        best = Math.max(best, fraction);
        onProgress(fraction);
      });
    } catch (error) {
      attempts += 1;
      if (!again(error) || attempts >= MOST_ATTEMPTS) throw error;
      onWaiting(best);
      await pause();
    }
  }
}

/** Waits a moment, or until the device is online again. */
const pause = () =>
  new Promise((resolve) => {
    const timer = setTimeout(done, UPLOAD_PAUSE_MS);
    function done() {
      clearTimeout(timer);
      window.removeEventListener('online', done);
      resolve(undefined);
    }
    window.addEventListener('online', done);
  });

/**
 * Send what the server does not have of a body.
 * @param {typeof Upload} Sender the library's
 * @param {Blob} body
 * @param {{ fingerprint: () => Promise<string>, metadata: Record<string, string>, onProgress: (fraction: number) => void }} options
 * @returns {Promise<string>} the upload's address
 * @throws {Problem}
 */
function sendRest(Sender, body, { fingerprint, metadata, onProgress }) {
  return new Promise((resolve, reject) => {
    let timer = 0;
    const restart = () => {
      clearTimeout(timer);
      timer = setTimeout(() => upload.abort().finally(() => reject(noAnswer())), NETWORK_SILENCE_MS);
    };
    const upload = new Sender(body, {
      endpoint: `${location.origin}/v1/uploads`,
      chunkSize: CHUNK_BYTES,
      retryDelays: null, // `persist` repeats
      fingerprint,
      metadata,
      onProgress: (sent, total) => {
        restart();
        onProgress(total ? sent / total : 1);
      },
      onChunkComplete: restart,
      onSuccess: () => {
        clearTimeout(timer);
        resolve(upload.url ?? '');
      },
      onError: (error) => {
        clearTimeout(timer);
        reject(problemOf(/** @type {DetailedError} */ (error)));
      },
    });
    upload.findPreviousUploads().then(([previous]) => {
      if (previous) upload.resumeFromPreviousUpload(previous);
      restart();
      upload.start();
    }, reject);
  });
}

/**
 * An error of the library as a problem: what the server says, or that it cannot be reached.
 * @param {DetailedError} error
 * @returns {unknown}
 */
function problemOf({ originalResponse: answer }) {
  if (!answer) return offline();
  try {
    return parseAnswer(answer.getStatus(), answer.getBody());
  } catch (problem) {
    return problem;
  }
}
