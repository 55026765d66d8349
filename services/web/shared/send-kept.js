// Sends captures that were kept on the device: uploads that go on where they stopped (tus 1.0), then the job. Runs in pages and in the service
// worker, which has neither XMLHttpRequest nor the storage that the pages' library for uploads needs.
import { forgetFiles, keep, listKept, readKept, readKeptFiles } from './kept-captures.js';
import { fetchBytes } from './network.js';
import { Problem, isConnectionProblem, parseAnswer, sentences } from './problems.js';
import { t } from './texts.js';
import { UPLOAD_CHECK_MS } from './time-limits.js';
import { captureAddress, formOf } from './upload-form.js';

/** @import { CaptureReceipt, Job, Session } from './types.d.ts' */
/** @import { KeptCapture } from './kept-captures.js' */

const TUS = { 'Tus-Resumable': '1.0.0' };
const CHUNK_BYTES = 2 << 20; // of one request: what a slow line sends within the time limit
const REFUSED = [400, 403, 404, 409, 413, 415, 422]; // what the server will not take later either
const DAMAGED = 'UPLOAD_DAMAGED'; // the server has lost a part of what was sent
const OF_UPLOAD = ['UPLOAD_OFFSET', 'UPLOAD_INCOMPLETE']; // conflicts that the next try ends
const GONE = [404, 410]; // an upload that has expired
const LOCK = 'capture2vr-send'; // one of the pages and the service worker sends at a time

/** @typedef {(capture: KeptCapture, fraction: number) => void} OnSending */

/**
 * Sends all captures that wait, of who is logged in now. Another page that is sending, or the service worker, ends first. A capture that fails
 * does not keep the next ones from being sent, unless they would fail too.
 * @param {OnSending} [onSending]
 * @returns {Promise<void>}
 * @throws {Problem} OFFLINE, NO_ANSWER, and what else may be better later, with the names of the captures that failed
 */
export async function sendKept(onSending = () => {}) {
  await exclusively(async () => {
    const tenant = await loggedInTenant();
    const troubles = [];
    for (const { id } of (await listKept(tenant)).filter(({ state }) => state === 'waiting')) {
      const capture = await readKept(id);
      if (capture?.state !== 'waiting') continue;
      try {
        await sendOrRefuse(capture, onSending);
      } catch (error) {
        if (holdsForAll(error)) throw error;
        troubles.push(`${capture.name}: ${sentences(error)}`);
      }
    }
    if (troubles.length) throw new Problem({ detail: troubles.join(' ') });
  });
}

/**
 * Whether other captures would meet the same: no connection, nobody logged in, a limit, or a server in trouble.
 * @param {unknown} error
 */
const holdsForAll = (error) =>
  isConnectionProblem(error) ||
  (error instanceof Problem && (error.status === 401 || error.status === 429 || error.status >= 500));

/**
 * Does something while nobody else of this browser sends kept captures.
 * @template T
 * @param {() => Promise<T>} work
 * @returns {Promise<T>}
 */
export async function exclusively(work) {
  // Over plain http there are no locks, and no service worker that could send the same.
  return navigator.locks ? await navigator.locks.request(LOCK, work) : work();
}

/** The tenant as pages know it: '' where nobody has to log in. Throws where nobody has. */
async function loggedInTenant() {
  /** @type {Session} */
  const { tenant, via } = await ask('/v1/session', {});
  if (via === 'anonymous') throw new Problem({ status: 401, detail: t('Nobody is logged in.') });
  return via === 'session' ? tenant : '';
}

/**
 * Sends a capture; writes down why where the server refuses it for what it is.
 * @param {KeptCapture} capture
 * @param {OnSending} onSending
 */
async function sendOrRefuse(capture, onSending) {
  try {
    await send(capture, onSending);
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    if (error.code === DAMAGED) throw await beginAgain(capture);
    if (!REFUSED.includes(error.status) || OF_UPLOAD.includes(error.code)) throw error;
    Object.assign(capture, { state: 'refused', trouble: `${error.file && `${error.file}: `}${sentences(error)}` });
    await keep(capture);
  }
}

/**
 * Forgets an upload of which the server has lost a part; what is on the device is whole. The server's own hint would have the person delete it.
 * @param {KeptCapture} capture
 */
async function beginAgain(capture) {
  await keep(Object.assign(capture, { upload: '' }));
  return new Problem({
    code: DAMAGED,
    detail: t('The server has lost a part of what was sent. The next try sends all of it again.'),
  });
}

/**
 * Sends a capture. Every step is written down before the next, so that a page that is closed meanwhile repeats none.
 * @param {KeptCapture} capture
 * @param {OnSending} onSending
 */
async function send(capture, onSending) {
  if (!capture.capture) {
    const files = await readKeptFiles(capture.id);
    const body = formOf(
      files.map((file) => ({ path: file.path, body: file.body })),
      capture.filetype,
    );
    await upload(capture, body, (fraction) => onSending(capture, fraction));
    /** @type {CaptureReceipt} */
    const receipt = await ask(captureAddress(`${capture.upload}/capture`, capture), { method: 'POST' });
    capture.capture = receipt.capture;
    await keep(capture);
  }
  const job = await orderJob(capture);
  Object.assign(capture, { state: 'sent', job: job.id });
  await keep(capture);
  await forgetFiles(capture.id);
}

/**
 * Makes the job of a capture that is on the server.
 * @param {KeptCapture} capture
 * @returns {Promise<Job>}
 */
async function orderJob({ capture, order, jobKey }) {
  if (!order) throw new Error(t('A draft is not sent.'));
  const headers = { 'Content-Type': 'application/json', 'Idempotency-Key': jobKey };
  return ask(order.path, { method: 'POST', headers, body: JSON.stringify({ ...order.body, capture }) });
}

/**
 * Uploads what the server does not have of a body.
 * @param {KeptCapture} capture is told the upload's address
 * @param {Blob} body
 * @param {(fraction: number) => void} onProgress
 */
async function upload(capture, body, onProgress) {
  let offset = capture.upload ? await offsetOf(capture.upload) : null;
  if (offset === null) {
    capture.upload = await beginUpload(body.size, { name: capture.name, filetype: capture.filetype });
    await keep(capture);
    offset = 0;
  }
  while (offset < body.size) {
    onProgress(offset / body.size);
    const headers = { ...TUS, 'Content-Type': 'application/offset+octet-stream', 'Upload-Offset': String(offset) };
    const chunk = body.slice(offset, offset + CHUNK_BYTES);
    const { response, bytes } = await fetchBytes(capture.upload, {
      method: 'PATCH',
      headers,
      body: chunk,
      silenceMs: UPLOAD_CHECK_MS,
    });
    if (!response.ok) parseAnswer(response.status, new TextDecoder().decode(bytes));
    offset += chunk.size;
  }
  onProgress(1);
}

/**
 * @param {number} size
 * @param {Record<string, string>} metadata
 * @returns {Promise<string>} the upload's address
 */
async function beginUpload(size, metadata) {
  const told = Object.entries(metadata)
    .map(([key, value]) => `${key} ${base64(value)}`)
    .join(',');
  const headers = { ...TUS, 'Upload-Length': String(size), 'Upload-Metadata': told };
  const { response, bytes } = await fetchBytes('/v1/uploads', { method: 'POST', headers });
  if (!response.ok) parseAnswer(response.status, new TextDecoder().decode(bytes));
  return response.headers.get('Location') ?? '';
}

/**
 * How many bytes of an upload have arrived; null where it has expired.
 * @param {string} address
 * @returns {Promise<number | null>}
 */
async function offsetOf(address) {
  const { response } = await fetchBytes(address, { method: 'HEAD', headers: TUS });
  if (GONE.includes(response.status)) return null;
  if (!response.ok) throw new Problem({ status: response.status });
  return Number(response.headers.get('Upload-Offset'));
}

/**
 * @template T
 * @param {string} address
 * @param {RequestInit} request
 * @returns {Promise<T>} what the caller declares
 */
async function ask(address, request) {
  const { response, bytes } = await fetchBytes(address, { ...request, cache: 'no-store', silenceMs: UPLOAD_CHECK_MS });
  return parseAnswer(response.status, new TextDecoder().decode(bytes));
}

/** UTF-8 as base64. @param {string} text */
const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
