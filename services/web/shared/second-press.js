// Buttons whose action cannot be undone: the first press asks, the second one does it.

const ASKED_MS = 5_000; // for which the second press counts

/**
 * Calls an action when a button is pressed twice within five seconds. After the first press the button asks.
 * @param {HTMLButtonElement} button
 * @param {string} question
 * @param {() => unknown} action
 */
export function onSecondPress(button, question, action) {
  const { textContent: text } = button;
  let timer = 0;
  const reset = () => {
    clearTimeout(timer);
    timer = 0;
    button.textContent = text;
  };
  button.addEventListener('click', () => {
    if (timer) {
      reset();
      action();
      return;
    }
    button.textContent = question;
    timer = setTimeout(reset, ASKED_MS);
  });
}
