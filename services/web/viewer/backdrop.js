// What is behind the things on the page: a light studio, a dark one, or the plain colour of the page. The choice stays on the device.
import { element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @typedef {'light' | 'dark' | 'plain'} Backdrop as style.css knows them */

const STORAGE_KEY = 'capture2vr:backdrop';
/** @type {Backdrop[]} */
const BACKDROPS = ['light', 'dark', 'plain'];
const NAMES = { light: t('light studio'), dark: t('dark studio'), plain: t('plain') };

/**
 * Shows the backdrop that was chosen last, else the studio that fits the device's colours, and lets a button change it.
 * @param {(text: string) => void} say is called with the choice, in words
 */
export function startBackdrop(say) {
  const button = element('backdrop', HTMLButtonElement);
  let shown = loadBackdrop() ?? (matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light');
  show(shown);
  button.addEventListener('click', () => {
    shown = BACKDROPS[(BACKDROPS.indexOf(shown) + 1) % BACKDROPS.length];
    show(shown);
    saveBackdrop(shown);
    say(t('Background: {which}.', { which: NAMES[shown] }));
  });
}

/** @param {Backdrop} backdrop */
function show(backdrop) {
  document.body.dataset.backdrop = backdrop;
}

/** @returns {Backdrop | undefined} */
function loadBackdrop() {
  try {
    const stored = localStorage.getItem(STORAGE_KEY);
    return BACKDROPS.find((each) => each === stored);
  } catch {
    return undefined; // storage is not allowed
  }
}

/** @param {Backdrop} backdrop */
function saveBackdrop(backdrop) {
  try {
    localStorage.setItem(STORAGE_KEY, backdrop);
  } catch {
    // The storage is full or not allowed: the choice lasts until the page is closed.
  }
}
