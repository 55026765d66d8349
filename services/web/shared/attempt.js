// An action that the server may refuse, with a place on the page that says why.
import { sentences } from './problems.js';

/**
 * Does something, and says so where it fails.
 * @param {HTMLElement} trouble shows why; hidden otherwise
 * @param {() => Promise<unknown>} action
 */
export async function attempt(trouble, action) {
  trouble.hidden = true;
  try {
    await action();
  } catch (error) {
    trouble.textContent = sentences(error);
    trouble.hidden = false;
  }
}
