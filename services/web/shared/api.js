// The gateway's HTTP API, as all pages use it.
import { deleteEntry, openCache, readEntry, writeEntry } from './cache-storage.js';
import { followEvents } from './event-stream.js';
import { leadToLogin } from './login-redirect.js';
import { fetchBytes } from './network.js';
import { isConnectionProblem, noAnswer, offline, otherLogin, parseAnswer } from './problems.js';
import { captureAddress } from './upload-form.js';
import { hasOtherTenant, ofShownTenant, ownName, showAsVisitor } from './whose.js';
import { CACHED_COPY_MS, NETWORK_SILENCE_MS, UPLOAD_CHECK_MS } from './time-limits.js';

/** @import { About, MarkedBox } from './upload-form.js' */
/** @import { AnchorPoints, AnchorsEvent, AssetEntry, CaptureReceipt, JobProgress, PhotoOutline, Session } from './types.d.ts' */

const CATALOGUE = 'catalogue-1'; // the cache of answers that a visit without the server needs
const GATEWAY_ERRORS = [502, 503, 504]; // a proxy's word that the server behind it cannot be reached
const GONE = [404, 410];
const LOGIN_PAGES = ['/login', '/pair']; // where nobody has to be logged in

/**
 * Parse the body of an answer to what a page needs in order to show anything: without a session it leads to the login page.
 * @template T
 * @param {Response} response
 * @param {ArrayBuffer} bytes
 * @returns {T} as `parseAnswer`
 * @throws {Problem} as `parseAnswer`
 */
function parseNeeded({ status }, bytes) {
  if (status === 401 && !LOGIN_PAGES.includes(location.pathname) && !showAsVisitor()) leadToLogin();
  return parseAnswer(status, decodeText(bytes));
}

/** @param {ArrayBuffer} bytes */
const decodeText = (bytes) => new TextDecoder().decode(bytes);

/**
 * GET a JSON document.
 * @template T
 * @param {string} url
 * @returns {Promise<T>} what the caller declares
 * @throws {Problem} OFFLINE, NO_ANSWER, and what the server says
 */
export async function getJson(url) {
  const { response, bytes } = await fetchBytes(url, { cache: 'no-cache' });
  return parseNeeded(response, bytes);
}

/**
 * Who is logged in. A session that has ended is none to a visitor, who needs none; on one's own pages it leads to the login page.
 * @returns {Promise<Session>}
 * @throws {Problem} as `getJson`
 */
export async function getSession() {
  const { response, bytes } = await fetchBytes('/v1/session', { cache: 'no-cache' });
  if (response.status === 401 && ofShownTenant('') !== '') return { tenant: '', scopes: [], via: 'anonymous', key: '' };
  return parseNeeded(response, bytes);
}

/**
 * GET a JSON document, network first: the answer is cached, and shown again while the server cannot be reached.
 * @template T
 * @param {string} url
 * @returns {Promise<T>} what the caller declares
 * @throws {Problem} as `getJson`
 */
export async function getCachedJson(url) {
  const cache = await openCache(ownName(CATALOGUE));
  const copy = await readEntry(cache, url);
  const silenceMs = copy ? CACHED_COPY_MS : NETWORK_SILENCE_MS;
  try {
    const { response, bytes } = await fetchBytes(url, { cache: 'no-cache', silenceMs });
    if (GATEWAY_ERRORS.includes(response.status) && copy) throw offline();
    if (GONE.includes(response.status)) await deleteEntry(cache, url);
    /** @type {T} */
    const document = parseNeeded(response, bytes);
    if (!copy || decodeText(copy.bytes) !== decodeText(bytes)) await writeEntry(cache, url, bytes, response.headers);
    return document;
  } catch (problem) {
    if (copy && isConnectionProblem(problem)) return JSON.parse(decodeText(copy.bytes));
    throw problem;
  }
}

/**
 * Caches what an event brought as the newest answer of an address, for a visit without the server.
 * @param {string} url
 * @param {string} text
 */
export async function cacheAnswer(url, text) {
  await writeEntry(await openCache(ownName(CATALOGUE)), url, new TextEncoder().encode(text).buffer);
}

/**
 * The entry of an asset as it was with a version.
 * @param {string} key
 * @param {number} version
 * @returns {Promise<AssetEntry>}
 * @throws {Problem} as `getJson`
 */
export const getVersion = (key, version) => getJson(`/v1/assets/${encodeURIComponent(key)}/versions/${version}`);

/**
 * Publishes a version again as the newest one.
 * @param {string} key
 * @param {number} version
 * @returns {Promise<{ version: number }>}
 * @throws {Problem} as `getJson`
 */
export const restoreVersion = (key, version) =>
  postJson(`/v1/assets/${encodeURIComponent(key)}/versions/${version}/restore`, {});

/**
 * POST a JSON document.
 * @template T
 * @param {string} url
 * @param {unknown} body
 * @param {Record<string, string>} [headers]
 * @returns {Promise<T>} what the caller declares
 * @throws {Problem} as `getJson`
 */
export const postJson = (url, body, headers = {}) => sendJson('POST', url, body, headers);

/**
 * PUT a JSON document.
 * @template T
 * @param {string} url
 * @param {unknown} body
 * @param {Record<string, string>} [headers]
 * @returns {Promise<T>} what the caller declares
 * @throws {Problem} as `getJson`
 */
export const putJson = (url, body, headers = {}) => sendJson('PUT', url, body, headers);

/**
 * PATCH a JSON document.
 * @template T
 * @param {string} url
 * @param {unknown} body
 * @returns {Promise<T>} what the caller declares
 * @throws {Problem} as `getJson`
 */
export const patchJson = (url, body) => sendJson('PATCH', url, body, {});

/**
 * @template T
 * @param {'POST' | 'PUT' | 'PATCH'} method
 * @param {string} url
 * @param {unknown} body
 * @param {Record<string, string>} headers
 * @returns {Promise<T>}
 */
async function sendJson(method, url, body, headers) {
  refuseForOtherTenant();
  const { response, bytes } = await fetchBytes(url, {
    method,
    headers: { 'Content-Type': 'application/json', ...headers },
    body: JSON.stringify(body),
  });
  return parseAnswer(response.status, decodeText(bytes));
}

/** Throws where a change would be one of another tenant's things; to log in is none. */
function refuseForOtherTenant() {
  if (hasOtherTenant() && !LOGIN_PAGES.includes(location.pathname)) throw otherLogin();
}

/**
 * DELETE what is at an address.
 * @param {string} url
 * @throws {Problem} as `getJson`
 */
export async function deleteAt(url) {
  refuseForOtherTenant();
  const { response, bytes } = await fetchBytes(url, { method: 'DELETE' });
  if (!response.ok) parseAnswer(response.status, decodeText(bytes));
}

/**
 * Outline the thing in a photo.
 * @param {File} photo
 * @param {MarkedBox | null} box the rectangle that the object lies in
 * @returns {Promise<PhotoOutline>}
 * @throws {Problem} as `getJson`
 */
export async function outlinePhoto(photo, box) {
  const form = new FormData();
  form.append('files', photo, photo.name);
  const { response, bytes } = await fetchBytes(captureAddress('/v1/outlines', { box, continues: '' }), {
    method: 'POST',
    body: form,
    silenceMs: UPLOAD_CHECK_MS,
  });
  return parseAnswer(response.status, decodeText(bytes));
}

/**
 * Upload files as one capture. XMLHttpRequest, because fetch tells nothing of an upload's progress.
 * @param {File[]} files
 * @param {string} name
 * @param {About} about
 * @param {(fraction: number) => void} onProgress
 * @returns {Promise<CaptureReceipt>}
 * @throws {Problem} OFFLINE, NO_ANSWER, and what the server says
 */
export function uploadCapture(files, name, about, onProgress) {
  const form = new FormData();
  form.append('name', name);
  for (const file of files) form.append('files', file, file.webkitRelativePath || file.name);
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    let timer = 0;
    const restart = (/** @type {number} */ limitMs) => {
      clearTimeout(timer);
      timer = setTimeout(() => request.abort(), limitMs);
    };
    request.upload.onprogress = (event) => {
      restart(NETWORK_SILENCE_MS);
      if (event.lengthComputable) onProgress(event.loaded / event.total);
    };
    request.upload.onload = () => restart(UPLOAD_CHECK_MS);
    request.onload = () => {
      try {
        resolve(parseAnswer(request.status, request.responseText));
      } catch (problem) {
        reject(problem);
      }
    };
    request.onabort = () => reject(noAnswer());
    request.onerror = () => reject(offline());
    request.onloadend = () => clearTimeout(timer);
    restart(NETWORK_SILENCE_MS);
    request.open('POST', captureAddress('/v1/captures', about));
    request.send(form);
  });
}

/**
 * Make the capture of an upload whose bytes are all there.
 * @param {string} upload its address
 * @param {About} about
 * @returns {Promise<CaptureReceipt>}
 * @throws {Problem} as `getJson`
 */
export async function finishUpload(upload, about) {
  const address = captureAddress(`${upload}/capture`, about);
  const { response, bytes } = await fetchBytes(address, { method: 'POST', silenceMs: UPLOAD_CHECK_MS });
  return parseAnswer(response.status, decodeText(bytes));
}

/**
 * @typedef {object} JobCallbacks
 * @property {(progress: JobProgress) => void} onProgress
 * @property {(anchors: AnchorPoints) => void} onAnchors is called when the points are there, before there is a mesh
 * @property {() => void} onChange is called when the job may have changed, and whenever the stream opens
 * @property {() => void} onLost is called when the stream was silent for too long or was closed; it is then opened again
 */

/**
 * Follow a job over server-sent events; events that were missed while the connection was lost are replayed.
 * @param {string} id
 * @param {JobCallbacks} callbacks
 * @returns {() => void} stops following
 */
export function followJob(id, { onProgress, onAnchors, onChange, onLost }) {
  return followEvents({
    address: (last) => `/v1/jobs/${id}/events?after=${last}`,
    events: {
      progress: (data) => onProgress(JSON.parse(data)),
      anchors: (data) => {
        /** @type {AnchorsEvent} */
        const { anchors } = JSON.parse(data);
        onAnchors(anchors);
      },
      published: onChange,
      state: onChange,
    },
    onOpen: onChange,
    onLost,
  });
}

/**
 * "My grandmother's dress!" -> "My-grandmother-s-dress": the characters that an asset key may have.
 * @param {string} name
 * @returns {string}
 */
export function keyFrom(name) {
  const plain = name.normalize('NFKD').replace(/[\u0300-\u036f]/g, '');
  return plain
    .replace(/[^A-Za-z0-9._-]+/g, '-')
    .replace(/^[^A-Za-z0-9]+|[-._]+$/g, '')
    .slice(0, 100);
}
