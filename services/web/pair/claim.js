// The phone's half of pairing: exchanges the token from the QR code for a session cookie.
import { page, showState } from './page-state.js';
import { getJson, postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { forgetAccounts } from '../shared/forget.js';
import { t } from '../shared/texts.js';

/** @import { Session } from '../shared/types.d.ts' */

/**
 * Logs this browser in by a pairing's token. Asks first where somebody is logged in: the link may have come from anybody.
 * @param {string} token
 */
export async function claim(token) {
  /** @type {Session | null} */
  const session = await getJson('/v1/session').catch(() => null);
  if (session?.via === 'session') await askToReplace(session);
  /** @type {Session} */
  const { tenant } = await postJson('/v1/pairings/claim', { token });
  await forgetAccounts(tenant);
  showState('done', t('This device is logged in as {tenant}.', { tenant }));
}

/**
 * Waits until the person wants to be logged in as somebody else.
 * @param {Session} session
 */
async function askToReplace({ tenant }) {
  element('present', HTMLElement).textContent = t(
    'This browser is logged in as {tenant}. The code logs it in anew, with what the other screen allows.',
    { tenant },
  );
  showState('asking', t('Log in with this code?'));
  const button = element('replace', HTMLButtonElement);
  await new Promise((resolve) => button.addEventListener('click', resolve, { once: true }));
  page.question.hidden = true;
}
