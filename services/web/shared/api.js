// The gateway's HTTP API, as all pages use it.
import { deleteEntry, openCache, readEntry, writeEntry } from './cache-storage.js';
import { fetchBytes } from './network.js';
import { Problem, isConnectionProblem, noAnswer, offline } from './problems.js';
import { CACHED_COPY_MS, EVENTS_SILENCE_MS, NETWORK_SILENCE_MS, UPLOAD_CHECK_MS } from './time-limits.js';

export { Problem } from './problems.js';

const CATALOGUE = 'catalogue-1'; // the cache of answers that a visit without the server needs
const GATEWAY_ERRORS = [502, 503, 504]; // a proxy's word that the server behind it cannot be reached
const GONE = [404, 410];

/**
 * Parse the body of an answer.
 * @param {number} status
 * @param {string} text
 * @returns {any}
 * @throws {Problem} where the status or the body is an error
 */
function parseAnswer(status, text) {
  let body = {};
  try {
    body = JSON.parse(text);
  } catch {
    throw new Problem({ status, detail: `The server answered ${status}, with something that this page cannot read.`, hints: ['Try again later.'] });
  }
  if (status >= 200 && status < 300) return body;
  throw new Problem({ status, ...body });
}

/** @param {ArrayBuffer} bytes */
const decodeText = (bytes) => new TextDecoder().decode(bytes);

/**
 * GET a JSON document.
 * @param {string} url
 * @returns {Promise<any>}
 * @throws {Problem} OFFLINE, NO_ANSWER, and what the server says
 */
export async function getJson(url) {
  const { response, bytes } = await fetchBytes(url, { cache: 'no-cache' });
  return parseAnswer(response.status, decodeText(bytes));
}

/**
 * GET a JSON document, network first: the answer is cached, and shown again while the server cannot be reached.
 * @param {string} url
 * @returns {Promise<any>}
 * @throws {Problem} as `getJson`
 */
export async function getCachedJson(url) {
  const cache = await openCache(CATALOGUE);
  const copy = await readEntry(cache, url);
  const silenceMs = copy ? CACHED_COPY_MS : NETWORK_SILENCE_MS;
  try {
    const { response, bytes } = await fetchBytes(url, { cache: 'no-cache', silenceMs });
    if (GATEWAY_ERRORS.includes(response.status) && copy) throw offline();
    if (GONE.includes(response.status)) await deleteEntry(cache, url);
    const document = parseAnswer(response.status, decodeText(bytes));
    if (!copy || decodeText(copy.bytes) !== decodeText(bytes)) await writeEntry(cache, url, bytes, response.headers);
    return document;
  } catch (problem) {
    if (copy && isConnectionProblem(problem)) return JSON.parse(decodeText(copy.bytes));
    throw problem;
  }
}

/**
 * POST a JSON document.
 * @param {string} url
 * @param {unknown} body
 * @param {Record<string, string>} [headers]
 * @returns {Promise<any>}
 * @throws {Problem} as `getJson`
 */
export async function postJson(url, body, headers = {}) {
  const { response, bytes } = await fetchBytes(url, {
    method: 'POST',
    headers: { 'Content-Type': 'application/json', ...headers },
    body: JSON.stringify(body),
  });
  return parseAnswer(response.status, decodeText(bytes));
}

/**
 * Upload files as one capture. XMLHttpRequest, because fetch tells nothing of an upload's progress.
 * @param {File[]} files
 * @param {string} name
 * @param {(fraction: number) => void} onProgress
 * @returns {Promise<any>} the server's receipt
 * @throws {Problem} OFFLINE, NO_ANSWER, and what the server says
 */
export function uploadCapture(files, name, onProgress) {
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
    request.open('POST', '/v1/captures');
    request.send(form);
  });
}

const RECONNECT_MS = 2000; // a gateway that restarts is back within seconds

/**
 * Follow a job over server-sent events; events that were missed while the connection was lost are replayed.
 * @param {string} id
 * @param {(type: string, data: any) => void} onEvent gets every event, `open` whenever the stream (re)opens, and `lost` when it was silent
 * for too long or was closed; it is then opened again
 * @returns {() => void} stops following
 */
export function followJob(id, onEvent) {
  /** @type {EventSource | undefined} */
  let source;
  let reconnect = 0;
  let silence = 0;
  let last = 0; // number of the last event
  function heard() {
    clearTimeout(silence);
    silence = setTimeout(lose, EVENTS_SILENCE_MS);
  }
  function lose() {
    stop();
    onEvent('lost', {});
    reconnect = setTimeout(connect, RECONNECT_MS);
  }
  function stop() {
    clearTimeout(reconnect);
    clearTimeout(silence);
    source?.close();
  }
  function connect() {
    const stream = new EventSource(`/v1/jobs/${id}/events?after=${last}`);
    source = stream;
    heard();
    stream.onopen = () => {
      heard();
      onEvent('open', {});
    };
    stream.addEventListener('heartbeat', heard);
    for (const type of ['progress', 'published', 'state']) {
      stream.addEventListener(type, (event) => {
        heard();
        last = Number(event.lastEventId) || last;
        onEvent(type, JSON.parse(event.data));
      });
    }
    // A browser reconnects by itself where the connection breaks, but never after an error's answer (a proxy's 502).
    stream.onerror = () => {
      if (stream.readyState === EventSource.CLOSED) lose();
    };
  }
  connect();
  return stop;
}

/**
 * "My grandmother's dress!" -> "My-grandmother-s-dress": the characters that an asset key may have.
 * @param {string} name
 * @returns {string}
 */
export function keyFrom(name) {
  const plain = name.normalize('NFKD').replace(/[\u0300-\u036f]/g, '');
  return plain.replace(/[^A-Za-z0-9._-]+/g, '-').replace(/^[^A-Za-z0-9]+|[-._]+$/g, '').slice(0, 100);
}
