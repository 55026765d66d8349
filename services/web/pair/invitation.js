// The operator's half of pairing: a QR code and ten digits, and whether a device has used them.
import { page, showState } from './page-state.js';
import { getJson, postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { leadToLogin } from '../shared/login-redirect.js';
import { isConnectionProblem, sentences, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { NewPairing, Pairing, Scope, Session } from '../shared/types.d.ts' */

const POLL_MS = 1000;
const TOO_MANY = 429;
const SERVER_ERRORS = 500;
const LOOPBACK = ['localhost', '127.0.0.1', '[::1]'];
/** @type {[text: string, scopes: Scope[]][]} */
const CHOICES = [
  [t('look at objects, and capture new ones'), ['read', 'capture']],
  [t('only look at objects'), ['read']],
  [t('only capture'), ['capture']],
  [t('also remove, share and pair'), ['read', 'capture', 'manage']],
];

const own = {
  qr: element('qr', HTMLImageElement),
  code: element('code', HTMLOutputElement),
  left: element('left', HTMLElement),
  address: element('login-address', HTMLElement),
  unreachable: element('unreachable', HTMLElement),
  may: element('may', HTMLSelectElement),
  label: element('label', HTMLInputElement),
};
/** @type {NewPairing | null} */
let shown = null; // the pairing that is being waited for; an older one is waited for no longer

/** Shows the first code at once, with what most devices need; whoever wants another one chooses. */
export async function invite() {
  /** @type {Session} */
  const session = await getJson('/v1/session');
  if (session.via === 'anonymous') {
    leadToLogin();
    return;
  }
  if (session.via === 'open') {
    showState('error', t('This server asks nobody for a key, so there is nothing to pair.'));
    return;
  }
  const choices = CHOICES.filter(([, scopes]) => scopes.every((scope) => session.scopes.includes(scope)));
  own.may.replaceChildren(...choices.map(([text, scopes]) => new Option(text, scopes.join(' '))));
  own.may.append(...(choices.length ? [] : [new Option(t('what you may'), session.scopes.join(' '))]));
  page.choice.addEventListener('submit', (event) => {
    event.preventDefault();
    start().catch(showProblem);
  });
  await start();
}

/** Creates a pairing, and shows it until it is used or has expired. */
async function start() {
  /** @type {NewPairing} */
  const pairing = await postJson('/v1/pairings', { scopes: own.may.value.split(' '), label: own.label.value.trim() });
  shown = pairing;
  own.qr.src = `data:image/svg+xml,${encodeURIComponent(pairing.qr)}`;
  own.code.textContent = [pairing.code.slice(0, 3), pairing.code.slice(3, 6), pairing.code.slice(6)].join(' ');
  const { hostname, origin } = new URL(pairing.url);
  own.address.textContent = `${origin}/login`;
  own.unreachable.hidden = !LOOPBACK.includes(hostname);
  showState('waiting', t('Waiting for the device.'));
  watch(pairing).catch(showProblem);
}

/** @param {NewPairing} pairing */
async function watch(pairing) {
  const ends = performance.now() + (Date.parse(pairing.expires) - Date.now());
  while (shown === pairing) {
    const seconds = Math.max(0, Math.round((ends - performance.now()) / 1000));
    own.left.textContent = t('For {time} minutes, and for one device.', {
      time: `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, '0')}`,
    });
    if (await isClaimed(pairing)) {
      showState('paired', t('{device} is paired.', { device: pairing.label }));
      return;
    }
    if (seconds === 0) {
      showState('expired', t('This code has expired.'));
      return;
    }
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
}

/**
 * Whether a device has used the pairing. Not known while the server does not answer, or a proxy or a limit in its place: asked again then.
 * @param {NewPairing} pairing
 */
async function isClaimed({ id }) {
  try {
    /** @type {Pairing} */
    const { claimed } = await getJson(`/v1/pairings/${id}`);
    return claimed;
  } catch (error) {
    const { status } = toProblem(error);
    if (isConnectionProblem(error) || status === TOO_MANY || status >= SERVER_ERRORS) return false;
    throw error;
  }
}

/** @param {unknown} error */
function showProblem(error) {
  showState('error', sentences(error));
  page.choice.hidden = false;
}
