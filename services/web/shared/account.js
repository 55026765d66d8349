// The corner of every page that says who is logged in, with links to pair a device and to sign out.
import { deleteAt, getSession } from './api.js';
import { create, element } from './dom.js';
import { forgetAccounts } from './forget.js';
import { leadToLogin } from './login-redirect.js';
import { t } from './texts.js';

/** @import { Session } from './types.d.ts' */

/**
 * Shows who is logged in. Shows nothing where no keys are asked for, and without the server.
 * @returns {Promise<Session | null>} null without the server
 */
export async function showAccount() {
  const corner = element('account', HTMLElement);
  const session = await getSession().catch(() => null);
  if (!session || session.via === 'open') return session;
  corner.replaceChildren(...(session.via === 'anonymous' ? [createLogin()] : createAccount(session)));
  corner.hidden = false;
  document.body.dataset.tenant = session.via === 'anonymous' ? '' : session.tenant;
  return session;
}

/** Signs out, and forgets what this browser keeps of the account. */
async function signOut() {
  await deleteAt('/v1/session');
  await forgetAccounts();
  location.assign('/login');
}

function createLogin() {
  const login = create('button', { type: 'button', className: 'link', textContent: t('Log in') });
  login.addEventListener('click', leadToLogin);
  return login;
}

/** @param {Session} session */
function createAccount({ tenant }) {
  const leave = create('button', { type: 'button', className: 'link', textContent: t('Sign out') });
  leave.addEventListener('click', () =>
    signOut().catch(() => (leave.textContent = t('The server does not answer. Try again'))),
  );
  const name = create('span', { textContent: tenant, title: t('Who is logged in') });
  return [name, create('a', { href: '/pair', textContent: t('Pair a device') }), leave];
}
