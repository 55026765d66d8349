// An action that the server may refuse, with a place on the page that says why.
import { child } from './dom.js';
import { sentences } from './problems.js';

/**
 * Does something, and says so where it fails. What is pressed for it cannot be pressed again until it is done.
 * @param {HTMLElement} trouble shows why; hidden otherwise
 * @param {() => Promise<unknown>} action
 * @param {HTMLButtonElement | HTMLFormElement} [pressed] the button, or the form with the button that sends it
 */
export async function attempt(trouble, action, pressed) {
  const button = pressed instanceof HTMLFormElement ? child(pressed, '[type=submit]', HTMLButtonElement) : pressed;
  if (button?.getAttribute('aria-disabled') === 'true') return;
  button?.setAttribute('aria-disabled', 'true'); // not `disabled`, which would take the focus from it
  trouble.hidden = true;
  try {
    await action();
  } catch (error) {
    trouble.textContent = sentences(error);
    trouble.hidden = false;
  } finally {
    button?.removeAttribute('aria-disabled');
  }
}
