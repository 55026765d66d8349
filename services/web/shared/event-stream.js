// Server-sent events, as all pages follow them: a stream that falls silent or is refused is opened again.
import { EVENTS_SILENCE_MS } from './time-limits.js';

const RECONNECT_MS = 2000; // a gateway that restarts is back within seconds
const LONGEST_RECONNECT_MS = 16_000; // each refusal doubles the pause: there may be too many streams, or no right to this one

/**
 * @typedef {object} StreamCallbacks
 * @property {(last: number) => string} address of the stream that goes on behind an event, by its number; 0 means from the beginning
 * @property {Record<string, (data: string) => void>} events what is called with the data of each kind of event; of others only heartbeats are heard
 * @property {() => void} [onOpen] is called whenever the stream has opened
 * @property {() => void} [onBreak] is called when the connection broke; mostly the browser opens it again within a second
 * @property {() => void} onLost is called when the stream was silent for too long or was refused; it is then opened again
 */

/**
 * Follow server-sent events; those that were missed while the connection was lost are asked for again.
 * @param {StreamCallbacks} callbacks
 * @returns {() => void} stops following
 */
export function followEvents({ address, events, onOpen, onBreak, onLost }) {
  /** @type {EventSource | undefined} */
  let source;
  let reconnect = 0;
  let pause = RECONNECT_MS;
  let silence = 0;
  let last = 0; // number of the last event
  function restartSilence() {
    clearTimeout(silence);
    silence = setTimeout(lose, EVENTS_SILENCE_MS);
  }
  function lose() {
    stop();
    reconnect = setTimeout(connect, pause);
    pause = Math.min(2 * pause, LONGEST_RECONNECT_MS);
    onLost(); // last: it may stop all of it
  }
  function stop() {
    clearTimeout(reconnect);
    clearTimeout(silence);
    source?.close();
  }
  function connect() {
    const stream = new EventSource(address(last));
    source = stream;
    restartSilence();
    stream.onopen = () => {
      restartSilence();
      pause = RECONNECT_MS;
      onOpen?.();
    };
    stream.addEventListener('heartbeat', restartSilence);
    for (const [kind, hear] of Object.entries(events)) {
      stream.addEventListener(kind, ({ data, lastEventId }) => {
        restartSilence();
        last = Number(lastEventId) || last;
        hear(data);
      });
    }
    // A browser reconnects by itself where the connection breaks, but never after an error's answer (a proxy's 502).
    stream.onerror = () => {
      if (stream.readyState === EventSource.CLOSED) lose();
      else onBreak?.();
    };
  }
  connect();
  return stop;
}
