// The gateway's HTTP API, as both pages use it.

/** @import { CaptureReceipt, JobProgress } from './types.d.ts' */

/** A problem document (RFC 9457) as an exception: `message` is for people, `code` for programs. */
export class Problem extends Error {
  constructor(document) {
    super(document.detail || document.title || 'Something went wrong.');
    this.code = document.code || 'UNKNOWN';
    this.file = document.file || '';
    this.hints = document.hints || [];
    this.status = document.status || 0;
  }
}

const OFFLINE = { code: 'OFFLINE', detail: 'The server cannot be reached.', hints: ['Check the connection and try again.'] };

/** Parse an answer's body, or throw it as a Problem. */
function opened(status, text) {
  let body = {};
  try {
    body = JSON.parse(text);
  } catch {
    body = { detail: `The server answered ${status}.` };
  }
  if (status >= 200 && status < 300) return body;
  throw new Problem({ status, ...body });
}

/**
 * @template T
 * @param {string} url
 * @returns {Promise<T>}
 */
export async function getJson(url) {
  const answer = await fetch(url, { cache: 'no-cache' }).catch(() => {
    throw new Problem(OFFLINE);
  });
  return opened(answer.status, await answer.text());
}

/**
 * @template T
 * @param {string} url
 * @param {object} body
 * @param {Record<string, string>} [headers]
 * @returns {Promise<T>}
 */
export async function postJson(url, body, headers = {}) {
  const answer = await fetch(url, {
    method: 'POST',
    headers: { 'Content-Type': 'application/json', ...headers },
    body: JSON.stringify(body),
  }).catch(() => {
    throw new Problem(OFFLINE);
  });
  return opened(answer.status, await answer.text());
}

/**
 * Upload files as one capture. XMLHttpRequest, because fetch tells nothing of an upload's progress.
 * @param {File[]} files
 * @param {string} name
 * @param {(fraction: number) => void} onProgress
 * @returns {Promise<CaptureReceipt>}
 */
export function uploadCapture(files, name, onProgress) {
  const form = new FormData();
  form.append('name', name);
  for (const file of files) form.append('files', file, file.webkitRelativePath || file.name);
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.upload.onprogress = (event) => event.lengthComputable && onProgress(event.loaded / event.total);
    request.onload = () => {
      try {
        resolve(opened(request.status, request.responseText));
      } catch (problem) {
        reject(problem);
      }
    };
    request.onerror = () => reject(new Problem(OFFLINE));
    request.open('POST', '/v1/captures');
    request.send(form);
  });
}

const RECONNECT_MS = 2000; // a gateway that restarts is back within seconds

/**
 * Follow a job over server-sent events; what was missed while the connection was away is replayed.
 * `onEvent(type, data)` hears every event, and `open` whenever the stream (re)opens; returns a function that stops.
 * @param {string} id
 * @param {(type: string, data: JobProgress) => void} onEvent
 */
export function followJob(id, onEvent) {
  let source = null;
  let timer = 0;
  let seen = 0;
  function connect() {
    source = new EventSource(`/v1/jobs/${id}/events?after=${seen}`);
    source.onopen = () => onEvent('open', {});
    for (const type of ['progress', 'published', 'state']) {
      source.addEventListener(type, (event) => {
        seen = Number(event.lastEventId) || seen;
        onEvent(type, JSON.parse(event.data));
      });
    }
    // A browser reconnects by itself where the connection breaks, but never after an error's answer (a proxy's 502).
    source.onerror = () => {
      if (source.readyState === EventSource.CLOSED) timer = setTimeout(connect, RECONNECT_MS);
    };
  }
  connect();
  return () => {
    clearTimeout(timer);
    source.close();
  };
}

/** "My grandmother's dress!" -> "My-grandmother-s-dress": the characters that an asset key may have. */
export function keyFrom(name) {
  const plain = name.normalize('NFKD').replace(/[\u0300-\u036f]/g, '');
  return plain.replace(/[^A-Za-z0-9._-]+/g, '-').replace(/^[^A-Za-z0-9]+|[-._]+$/g, '').slice(0, 100);
}

/**
 * Any error as a Problem, so that a page can show its message and its hints.
 * @param {unknown} error
 * @returns {Problem}
 */
export function toProblem(error) {
  if (error instanceof Problem) return error;
  return new Problem({ detail: error instanceof Error ? error.message : '' });
}
