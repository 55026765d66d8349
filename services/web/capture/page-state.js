// Which part of the capture page is shown: the form, the job's progress, or an error.
import { element, fillList } from '../shared/dom.js';
import { isConnectionProblem, toProblem } from '../shared/problems.js';

/** @typedef {'choosing' | 'sending' | 'working' | 'trouble' | 'done'} PageState */

const page = {
  form: element('form', HTMLFormElement),
  work: element('work', HTMLElement),
  trouble: element('trouble', HTMLElement),
  reason: element('reason', HTMLElement),
  hints: element('hints', HTMLElement),
  retry: element('retry', HTMLButtonElement),
  change: element('change', HTMLButtonElement),
};

/**
 * Shows the parts of the page that belong to a state.
 * @param {PageState} state
 */
export function showState(state) {
  document.body.dataset.state = state;
  page.form.hidden = state !== 'choosing';
  page.work.hidden = state !== 'sending' && state !== 'working';
  page.trouble.hidden = state !== 'trouble';
}

/**
 * Shows an error: what happened, to which file, and what to do.
 * @param {unknown} error
 * @param {{ more?: string, canChange?: boolean }} [about] `more`: a sentence that follows; `canChange`: the form has what was to be sent
 */
export function showTrouble(error, { more = '', canChange = false } = {}) {
  const { code, file, message, hints } = toProblem(error);
  document.body.dataset.code = code;
  page.reason.textContent = file && !message.includes(file) ? `${file}: ${message}` : message;
  fillList(page.hints, more ? [...hints, more] : hints);
  page.retry.hidden = !isConnectionProblem(error);
  page.change.hidden = !canChange;
  showState('trouble');
}
