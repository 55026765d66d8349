// Which parts of the pairing page are shown.
import { element } from '../shared/dom.js';

/** @typedef {'loading' | 'waiting' | 'paired' | 'expired' | 'asking' | 'done' | 'error'} PairingState */

export const page = {
  said: element('said', HTMLElement),
  invitation: element('invitation', HTMLElement),
  choice: element('choice', HTMLFormElement),
  question: element('question', HTMLElement),
  paired: element('paired', HTMLElement),
  other: element('other', HTMLElement),
};

/**
 * Shows the parts of the page that belong to a state, and a sentence about it.
 * @param {PairingState} state
 * @param {string} sentence
 */
export function showState(state, sentence) {
  document.body.dataset.state = state;
  page.said.textContent = sentence;
  page.invitation.hidden = state !== 'waiting';
  page.choice.hidden = !['waiting', 'paired', 'expired'].includes(state);
  page.question.hidden = state !== 'asking';
  page.paired.hidden = state !== 'done';
}
