// Fetch with a time limit on silence: a server that never answers, or stops in the middle of a body, is an error and no endless wait.
import { noAnswer, offline } from './problems.js';
import { NETWORK_SILENCE_MS } from './time-limits.js';

/**
 * Fetch the whole of an answer. A large body may take its time, as long as bytes keep coming.
 * @param {RequestInfo | URL} request
 * @param {RequestInit & {silenceMs?: number}} [options] silenceMs: longest time without a byte
 * @returns {Promise<{response: Response, bytes: ArrayBuffer}>} `response` without its body, which is in `bytes`
 * @throws {Problem} OFFLINE, NO_ANSWER
 */
export async function fetchBytes(request, { silenceMs = NETWORK_SILENCE_MS, ...init } = {}) {
  const controller = new AbortController();
  let timer = 0;
  const restart = () => {
    clearTimeout(timer);
    timer = setTimeout(() => controller.abort(), silenceMs);
  };
  restart();
  try {
    const response = await fetch(request, { ...init, signal: controller.signal });
    return { response, bytes: await readBody(response, restart) };
  } catch {
    throw controller.signal.aborted ? noAnswer() : offline();
  } finally {
    clearTimeout(timer);
  }
}

/**
 * @param {Response} response
 * @param {() => void} onBytes called for each part that arrives
 * @returns {Promise<ArrayBuffer>}
 */
async function readBody(response, onBytes) {
  onBytes();
  if (!response.body) return new ArrayBuffer(0);
  const parts = [];
  const reader = response.body.getReader();
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    parts.push(part.value);
    onBytes();
  }
  return new Blob(parts).arrayBuffer();
}
