// Fetch with a time limit on silence: a server that never answers, or stops in the middle of a body, is an error and no endless wait.
import { noAnswer, offline } from './problems.js';
import { NETWORK_SILENCE_MS } from './time-limits.js';

/**
 * Fetch the whole of an answer. A large body may take its time, as long as bytes keep coming.
 * @param {RequestInfo | URL} request
 * @param {RequestInit & {silenceMs?: number, mostBytes?: number}} [options] silenceMs: longest time without a byte; mostBytes: once
 *   more of a success have come, the rest is not read
 * @returns {Promise<{response: Response, bytes: ArrayBuffer}>} `response` without its body, which is in `bytes`
 * @throws {Problem} OFFLINE, NO_ANSWER
 */
export async function fetchBytes(request, { silenceMs = NETWORK_SILENCE_MS, mostBytes = Infinity, ...init } = {}) {
  const controller = new AbortController();
  let timer = 0;
  const restart = () => {
    clearTimeout(timer);
    timer = setTimeout(() => controller.abort(), silenceMs);
  };
  restart();
  try {
    const response = await fetch(request, { ...init, signal: controller.signal });
    return { response, bytes: await readBody(response, restart, response.ok ? mostBytes : Infinity) };
  } catch {
    throw controller.signal.aborted ? noAnswer() : offline();
  } finally {
    clearTimeout(timer);
  }
}

/**
 * @param {Response} response
 * @param {() => void} onBytes called for each part that arrives
 * @param {number} mostBytes
 * @returns {Promise<ArrayBuffer>}
 */
async function readBody(response, onBytes, mostBytes) {
  onBytes();
  if (!response.body) return new ArrayBuffer(0);
  const parts = [];
  let size = 0;
  const reader = response.body.getReader();
  for (let part = await reader.read(); !part.done && size <= mostBytes; part = await reader.read()) {
    parts.push(part.value);
    size += part.value.byteLength;
    onBytes();
  }
  if (size > mostBytes) await reader.cancel();
  return new Blob(parts).arrayBuffer();
}
