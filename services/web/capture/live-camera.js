// The camera in the page: follows how it moves, takes photos by itself or by hand, and takes those again that would do harm.
import { openCamera } from './camera.js';
import { followFrames } from './camera-motion.js';
import { showCameraOptions } from './camera-options.js';
import { allowCompass, followHeading, mayHaveCompass } from './compass.js';
import { faultOfNew } from './guidance.js';
import { afterFrame, afterPhoto, afterRefusal, isStill, newShutter } from './shutter.js';
import { element } from '../shared/dom.js';
import { sentences } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Camera } from './camera.js' */
/** @import { Follower } from './camera-motion.js' */
/** @import { MotionAnswer } from './frame-motion.js' */
/** @import { Cue } from './shutter.js' */

/** @type {Record<Cue, string>} */
const CUES = {
  plain: t('Too dark or too plain to see how you move. Use the button.'),
  move: t('Take a step to the side.'),
  hold: t('Hold still.'),
  wait: '',
  take: t('Hold still.'),
};
const SHAKEN = t('You moved while it was taken. Hold still until the picture flashes.');
const BY_HAND = t('Take a step to the side, and use the button.');

const page = {
  dialog: element('camera', HTMLDialogElement),
  video: element('viewfinder', HTMLVideoElement),
  cue: element('cue', HTMLElement),
  count: element('taken', HTMLElement),
  looking: element('looking', SVGElement),
  automatic: element('automatic', HTMLButtonElement),
  shoot: element('shoot', HTMLButtonElement),
  leave: element('leave', HTMLButtonElement),
  open: element('open-camera', HTMLButtonElement),
  trouble: element('no-camera', HTMLElement),
};

/** @type {(photo: File, heading: number | null) => void} */
let onPhoto = () => {};
/** @type {Camera | null} */
let camera = null;
/** @type {Follower | null} */
let follower = null;
let shutter = newShutter();
/** @type {number | null} */
let heading = null;
let stopCompass = () => {};
let automatic = true;
let shooting = false; // from the photo to the word whether it is good
let isOpen = false; // the shutter: the camera takes a photo, which can last a second
let shaken = false; // the phone moved meanwhile
let taken = 0;

/**
 * Listens to the camera's buttons.
 * @param {(photo: File, heading: number | null) => void} take is called with each photo that is good, and where the camera looked
 */
export function startLiveCamera(take) {
  onPhoto = take;
  page.open.addEventListener('click', open);
  page.leave.addEventListener('click', () => page.dialog.close());
  page.dialog.addEventListener('close', close);
  page.shoot.addEventListener('click', () => shoot(false));
  page.automatic.addEventListener('click', () => setAutomatic(!automatic));
  document.addEventListener('visibilitychange', () => camera && document.hidden && page.dialog.close()); // phones take the camera away
}

/** Opens the camera, or says why it cannot be. */
async function open() {
  page.open.disabled = true;
  page.trouble.hidden = true;
  const compass = mayHaveCompass() && allowCompass(); // at once: iOS asks only in answer to a tap
  try {
    const opened = await openCamera(page.video);
    camera = opened;
    page.dialog.showModal();
    await opened.start();
    if (camera === opened) start(opened); // not closed meanwhile
    if (await compass) useCompass();
  } catch (error) {
    page.dialog.close();
    showTrouble(sentences(error));
    document.body.dataset.camera = 'none';
  }
  page.open.disabled = false;
}

/** @param {Camera} opened */
function start(opened) {
  [shutter, taken, shooting] = [newShutter(), 0, false];
  opened.track.addEventListener('ended', () => {
    page.dialog.close();
    showTrouble(t('The camera has stopped. What it took is here; open it again to go on.'));
  });
  showCameraOptions(opened.track);
  setAutomatic(automatic);
  showCount();
  keepAwake();
  document.body.dataset.camera = 'open';
  follower = followFrames(page.video, follow, () => setAutomatic(false)); // then photos are taken by hand
}

/** @param {string} text */
function showTrouble(text) {
  page.trouble.textContent = text;
  page.trouble.hidden = false;
}

/** Keeps the screen on: a walk takes longer than a phone waits for a finger. Not every browser can. */
async function keepAwake() {
  const lock = await navigator.wakeLock?.request('screen').catch(() => null);
  page.dialog.addEventListener('close', () => lock?.release(), { once: true });
}

/** Closes the camera. */
function close() {
  follower?.stop();
  stopCompass();
  camera?.close();
  [camera, follower, heading] = [null, null, null];
  document.body.dataset.camera = 'closed';
  page.open.focus();
}

/** Shows where the camera looks, by the compass. */
function useCompass() {
  stopCompass();
  if (!camera) return; // closed meanwhile
  stopCompass = followHeading((degrees) => {
    heading = degrees;
    page.looking.toggleAttribute('hidden', degrees === null);
    if (degrees !== null) page.looking.setAttribute('transform', `rotate(${degrees} 40 40)`);
  });
}

// ---- movement -------------------------------------------------------------------------------------------------------

/**
 * Goes on with how the camera has moved: says what to do, or takes a photo.
 * @param {MotionAnswer} motion
 * @param {number} ms since the frame before
 */
function follow(motion, ms) {
  shutter = afterFrame(shutter, { ms, heading, motion });
  document.body.dataset.cue = shutter.cue;
  if (isOpen && !isStill(motion.since, ms)) shaken = true;
  if (!shooting) showCue(shutter.cue);
  if (automatic && !shooting && shutter.cue === 'take') shoot(true);
}

/** @param {Cue} cue */
function showCue(cue) {
  if (cue !== 'wait') say(automatic ? CUES[cue] : BY_HAND);
}

/** @param {string} text */
function say(text) {
  if (page.cue.textContent !== text) page.cue.textContent = text; // a screen reader reads what changes
}

// ---- photos ---------------------------------------------------------------------------------------------------------

/**
 * Takes a photo, and keeps it if it does no harm; otherwise says why, and it is taken again.
 * @param {boolean} byItself then the phone has to be still to the end; a person may know better
 */
async function shoot(byItself) {
  if (!camera || shooting) return;
  shooting = true;
  page.shoot.disabled = true;
  const at = heading;
  try {
    const photo = await expose(camera);
    const fault = byItself && shaken ? SHAKEN : await faultOfNew(photo);
    if (fault) refuse(fault);
    else accept(photo, at);
  } catch (error) {
    refuse(sentences(error));
  }
  shooting = false;
  page.shoot.disabled = false;
}

/**
 * Takes a photo, and notes whether the phone moves meanwhile.
 * @param {Camera} opened
 */
async function expose(opened) {
  follower?.tell('hold');
  [isOpen, shaken] = [true, false];
  try {
    const blob = await opened.takePhoto();
    return new File([blob], nameOf(blob), { type: blob.type, lastModified: Date.now() });
  } finally {
    isOpen = false;
  }
}

/**
 * @param {File} photo
 * @param {number | null} at
 */
function accept(photo, at) {
  taken += 1;
  follower?.tell('accept');
  shutter = afterPhoto({ ...shutter, heading: at });
  page.dialog.dataset.flash = String(taken % 2); // the other animation's name begins it anew
  navigator.vibrate?.(30);
  onPhoto(photo, at);
  showCount();
}

/** @param {string} fault */
function refuse(fault) {
  shutter = afterRefusal(shutter);
  say(t('Not kept. {fault}', { fault }));
  document.body.dataset.refused = fault;
}

function showCount() {
  page.count.textContent = taken === 1 ? t('1 photo') : t('{count} photos', { count: taken });
  document.body.dataset.taken = String(taken);
}

/** The name of a photo: when it was taken. @param {Blob} blob */
function nameOf(blob) {
  const time = new Date().toISOString().replace(/[-:]/g, '').replace('.', '_').slice(0, 19);
  return `photo_${time}.${blob.type === 'image/png' ? 'png' : 'jpg'}`;
}

/** @param {boolean} on */
function setAutomatic(on) {
  automatic = on;
  page.automatic.ariaPressed = String(on);
}
