// The camera's light, and its exposure and white balance, held as they are: buttons for what this camera can do.
import { element } from '../shared/dom.js';

/**
 * What TypeScript does not know of a camera yet (W3C MediaStream Image Capture).
 * @typedef {object} Abilities
 * @property {boolean} [torch]
 * @property {string[]} [exposureMode]
 * @property {string[]} [whiteBalanceMode]
 */
/** @typedef {{ torch?: boolean, exposureMode?: string, whiteBalanceMode?: string }} Wish */
/** @typedef {{ button: HTMLButtonElement, can: (abilities: Abilities) => boolean, on: (abilities: Abilities) => Wish, off: (abilities: Abilities) => Wish }} Option */

/** @param {string[]} [offered] modes of the exposure, or of the white balance */
const canHold = (offered) => Boolean(offered?.includes('manual') && offered.includes('continuous'));

/**
 * The wish for a mode of exposure and white balance, of each that this camera can hold.
 * @param {Abilities} abilities
 * @param {'manual' | 'continuous'} mode
 * @returns {Wish}
 */
function modes({ exposureMode, whiteBalanceMode }, mode) {
  return {
    ...(canHold(exposureMode) && { exposureMode: mode }),
    ...(canHold(whiteBalanceMode) && { whiteBalanceMode: mode }),
  };
}

/** @type {Option[]} */
const OPTIONS = [
  {
    button: element('torch', HTMLButtonElement),
    can: ({ torch }) => torch === true,
    on: () => ({ torch: true }),
    off: () => ({ torch: false }),
  },
  {
    button: element('lock', HTMLButtonElement),
    can: ({ exposureMode, whiteBalanceMode }) => canHold(exposureMode) || canHold(whiteBalanceMode),
    on: (abilities) => modes(abilities, 'manual'),
    off: (abilities) => modes(abilities, 'continuous'),
  },
];

/** @type {MediaStreamTrack | null} */
let track = null;

/**
 * Shows the buttons for what a camera can do, all of them off.
 * @param {MediaStreamTrack} opened
 */
export function showCameraOptions(opened) {
  track = opened;
  const abilities = abilitiesOf(opened);
  for (const { button, can } of OPTIONS) {
    button.hidden = !can(abilities);
    button.ariaPressed = 'false';
  }
}

/** @param {MediaStreamTrack} camera @returns {Abilities} */
const abilitiesOf = (camera) => /** @type {Abilities} */ (camera.getCapabilities?.() ?? {});

/**
 * Switches an option on or off; one that the camera refuses all the same is hidden.
 * @param {Option} option
 */
async function toggle({ button, on, off }) {
  if (!track) return;
  const next = button.ariaPressed !== 'true';
  const wish = (next ? on : off)(abilitiesOf(track));
  try {
    await track.applyConstraints({ advanced: [/** @type {MediaTrackConstraintSet} */ (wish)] });
    button.ariaPressed = String(next);
  } catch {
    button.hidden = true;
  }
}

for (const option of OPTIONS) option.button.addEventListener('click', () => toggle(option));
