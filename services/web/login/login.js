// The login page (/login): an access key or ten digits for a session cookie; then back to the page that needed it.
import { getJson, postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { forgetAccounts } from '../shared/forget.js';
import { addressAfterLogin } from '../shared/login-redirect.js';
import { sentences, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Session } from '../shared/types.d.ts' */

const CODE_DIGITS = 10;

document.body.dataset.started = 'yes';
const page = {
  present: element('present', HTMLElement),
  said: element('said', HTMLElement),
  codeForm: element('code-form', HTMLFormElement),
  code: element('code', HTMLInputElement),
  keyForm: element('key-form', HTMLFormElement),
  key: element('key', HTMLInputElement),
};

/**
 * Logs in, and leaves for the page that needed it.
 * @param {string} url
 * @param {{ key: string } | { code: string }} body
 */
async function logIn(url, body) {
  if (document.body.dataset.state === 'sending') return; // a code works once: a second press would be told that it was used
  page.said.hidden = true;
  document.body.dataset.state = 'sending';
  try {
    /** @type {Session} */
    const { tenant } = await postJson(url, body);
    await forgetAccounts(tenant);
    Object.assign(document.body.dataset, { state: 'done', tenant });
    location.replace(addressAfterLogin(location.search));
  } catch (error) {
    Object.assign(document.body.dataset, { state: 'asking', code: toProblem(error).code });
    say(sentences(error));
  }
}

/** @param {string} sentence */
function say(sentence) {
  page.said.textContent = sentence;
  page.said.hidden = false;
}

/** @param {string} digits */
async function logInByCode(digits) {
  const code = digits.replace(/\D/g, '');
  if (code.length === CODE_DIGITS) {
    await logIn('/v1/pairings/claim', { code });
    return;
  }
  say(t('A code has ten digits.'));
  page.code.focus();
}

/** Says who is logged in already: logging in again takes that one's place. */
async function showPresent() {
  /** @type {Session | null} */
  const session = await getJson('/v1/session').catch(() => null);
  const isOpen = session?.via === 'open';
  if (!session || session.via === 'anonymous') return;
  page.present.textContent = isOpen
    ? t('This server asks nobody for a key.')
    : t('This browser is logged in as {tenant}.', { tenant: session.tenant });
  page.present.hidden = false;
}

/**
 * Listens to a form with one field; an empty field is asked for instead of sent.
 * @param {HTMLFormElement} form
 * @param {HTMLInputElement} field
 * @param {(text: string) => Promise<void>} send
 */
function listen(form, field, send) {
  form.addEventListener('submit', (event) => {
    event.preventDefault();
    const text = field.value.replace(/\s/g, '');
    if (text) send(text);
    else field.focus();
  });
}

listen(page.codeForm, page.code, logInByCode);
listen(page.keyForm, page.key, (key) => logIn('/v1/session', { key }));
showPresent();
