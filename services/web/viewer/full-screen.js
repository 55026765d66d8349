// The button that shows the page on all of the screen, where the browser can.
import { element } from '../shared/dom.js';

/** Offers the full screen. */
export function startFullScreen() {
  const button = element('full-screen', HTMLButtonElement);
  button.hidden = !document.fullscreenEnabled;
  button.addEventListener('click', () => {
    const done = document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen();
    done.catch(() => (button.hidden = true)); // the device refused: it will again
  });
  document.addEventListener('fullscreenchange', () =>
    button.setAttribute('aria-pressed', String(Boolean(document.fullscreenElement))),
  );
}
