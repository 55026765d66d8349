// The page of a share link (/s/TOKEN): exchanges the link for a cookie, asks for a password where there is one, and leads to what is shared.
import { postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { isConnectionProblem, sentences, toProblem } from '../shared/problems.js';

/** @import { OpenedShare } from '../shared/types.d.ts' */

const PASSWORD_PROBLEMS = ['SHARE_PASSWORD_MISSING', 'SHARE_PASSWORD_WRONG', 'PASSWORD_GUESSES_LIMITED'];

document.body.dataset.started = 'yes';
const page = {
  said: element('said', HTMLElement),
  form: element('form', HTMLFormElement),
  password: element('password', HTMLInputElement),
  again: element('again', HTMLButtonElement),
};
const token = decodeURIComponent(location.pathname.split('/')[2] ?? '');

/** @param {string} password '' where none was typed yet */
async function open(password) {
  if (document.body.dataset.state === 'sending') return; // a password may be tried a few times a minute only
  document.body.dataset.state = 'sending';
  page.again.hidden = true;
  try {
    /** @type {OpenedShare} */
    const { view } = await postJson('/v1/shares/open', { token, password });
    document.body.dataset.state = 'done';
    location.replace(view);
  } catch (error) {
    showProblem(error);
  }
}

/** @param {unknown} error */
function showProblem(error) {
  const { code } = toProblem(error);
  const asks = PASSWORD_PROBLEMS.includes(code);
  Object.assign(document.body.dataset, { state: asks ? 'asking' : 'error', code });
  page.said.textContent = sentences(error);
  page.form.hidden = !asks;
  page.again.hidden = !isConnectionProblem(error);
  if (asks) page.password.focus();
}

page.form.addEventListener('submit', (event) => {
  event.preventDefault();
  open(page.password.value);
});
page.again.addEventListener('click', () => location.reload());
open('');
