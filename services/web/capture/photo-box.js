// The mark of the object: a tap on it, or a rectangle around it. Of one photo, shows which part of it would be
// reconstructed; of several, lets the person choose one to mark it in.
import { outlinePhoto } from '../shared/api.js';
import { thumbnailOf } from './guidance.js';
import { create, element } from '../shared/dom.js';
import { isTemporary, sentences } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { storedName } from '../shared/upload-form.js';

/** @import { MarkedBox } from '../shared/upload-form.js' */

/** @typedef {[left: number, top: number, right: number, bottom: number]} PhotoBox shares of the upright photo's sides; a tap is one
 * without extent */
/** @typedef {{ x: number, y: number }} Place in the photo, as shares of its sides */

const RETRY_MS = 10_000; // until the next look, where the workers are busy: each sends the photo again
const LEAST_SIDE = 0.02; // of the photo: less is a tap on the object
const TAP_PX = 6; // from a tap to the sides of the square that shows it
const KEY_STEP = 0.02; // of the photo, for each press of an arrow key
const LATER = t('The outline cannot be shown now. The server looks for the object later, where you mark it if you do.');
/** @type {PhotoBox} */
const FIRST_BOX = [0.25, 0.25, 0.75, 0.75]; // where a rectangle begins that is moved by keys
/** @type {Record<string, [across: number, down: number]>} */
const ARROWS = {
  ArrowLeft: [-KEY_STEP, 0],
  ArrowRight: [KEY_STEP, 0],
  ArrowUp: [0, -KEY_STEP],
  ArrowDown: [0, KEY_STEP],
};

const page = {
  mark: element('mark', HTMLDetailsElement),
  marks: element('mark-photos', HTMLUListElement),
  section: element('which', HTMLElement),
  photo: element('which-photo', HTMLImageElement),
  drawing: element('which-drawing', SVGSVGElement),
  outline: element('which-outline', SVGPathElement),
  shade: element('which-shade', SVGPathElement),
  rectangle: element('which-box', SVGRectElement),
  note: element('which-note', HTMLElement),
  clear: element('which-clear', HTMLButtonElement),
};

/** @type {File[]} */
let several = []; // of which one can be chosen; [] for a single one
/** @type {File | null} */
let file = null; // that is shown
/** @type {PhotoBox | null} */
let box = null;
/** @type {Place | null} */
let start = null; // where the finger went down
let lastRequest = 0; // answers to earlier ones are out of date

/**
 * The rectangle that was drawn, and of several photos the name that the server gives the one that it is drawn in.
 * @param {File[]} files that are sent
 * @returns {MarkedBox | null}
 */
export function chosenBox(files) {
  if (!file || !box) return null;
  return several.length ? [...box, storedName(file, files)] : box;
}

/**
 * Shows a single photo and the outline of the object in it; several ones to choose from.
 * @param {File[]} photos
 */
export function showPhotos(photos) {
  const before = several;
  several = photos.length > 1 ? photos : [];
  page.mark.hidden = !several.length;
  listPhotos();
  if (file && before.length && several.includes(file)) return; // the rectangle stays
  showPhoto(photos.length === 1 ? photos[0] : null);
}

/** Lists several photos, where the person wants to see them: each shows itself when it is pressed. */
function listPhotos() {
  if (!page.mark.open) return;
  const items = several.map((photo) => {
    const button = create('button', {
      type: 'button',
      ariaLabel: t('Mark the object in {name}', { name: photo.name }),
    });
    button.ariaPressed = String(photo === file);
    button.append(create('img', { src: thumbnailOf(photo), alt: photo.name }));
    button.addEventListener('click', () => {
      showPhoto(photo);
      for (const each of page.marks.querySelectorAll('button')) each.ariaPressed = String(each === button);
    });
    const item = create('li');
    item.append(button);
    return item;
  });
  page.marks.replaceChildren(...items);
}

/**
 * Shows a photo, to draw in it. Hides all of it without a photo, or where the browser cannot show it.
 * @param {File | null} photo
 */
function showPhoto(photo) {
  if (photo === file) return;
  lastRequest += 1;
  URL.revokeObjectURL(page.photo.src);
  page.section.hidden = true;
  [file, box] = [photo, null];
  drawBox();
  if (!photo) return;
  page.photo.onload = () => {
    page.section.hidden = false;
    lookAgain();
  };
  page.photo.src = URL.createObjectURL(photo);
}

/** Asks the server for the outline of the object in the rectangle, or in the whole photo, and shows it. Of several photos the surface
 * tells it later. */
async function lookAgain() {
  if (!file) return;
  lastRequest += 1;
  const request = lastRequest;
  drawOutline([]);
  if (several.length && !isTap(box)) {
    page.note.textContent = box
      ? t('The object in the rectangle is made into a mesh, without what stands around it.')
      : t('Tap on the object in the photo, or draw a rectangle around it.');
    return;
  }
  document.body.dataset.outlined = '';
  page.note.textContent = t('Looking for the object …');
  const text = await findOutline(file, request).catch((error) => (isTemporary(error) ? '' : sentences(error)));
  if (request !== lastRequest) return;
  page.note.textContent = text || LATER;
  if (text) document.body.dataset.outlined = String(request);
  else setTimeout(() => request === lastRequest && document.body.dataset.state === 'choosing' && lookAgain(), RETRY_MS);
}

/**
 * Draws the outline, unless a newer request has been made meanwhile. The photo itself is sent: the outline in a smaller
 * copy may be another.
 * @param {File} photo
 * @param {number} request
 * @returns {Promise<string>} what to tell the person; empty while no worker can look, and while others' photos are before this one
 */
async function findOutline(photo, request) {
  const { outline } = await outlinePhoto(photo, box);
  if (request === lastRequest) drawOutline(outline);
  return box
    ? t('This will be made into a mesh.')
    : t('This will be made into a mesh. Is it not the object? Tap on it in the photo, or draw a rectangle around it.');
}

/** Whether a mark is a place on the object. @param {PhotoBox | null} mark */
const isTap = (mark) => Boolean(mark && mark[0] === mark[2] && mark[1] === mark[3]);

// ---- drawing --------------------------------------------------------------------------------------------------------

/** @param {[x: number, y: number][][]} lines closed, of corners */
function drawOutline(lines) {
  const path = lines.map((line) => `M${line.map((corner) => corner.join(' ')).join('L')}Z`).join('');
  page.outline.setAttribute('d', path);
  page.shade.setAttribute('d', path && `M0 0H1V1H0Z${path}`);
}

function drawBox() {
  page.rectangle.toggleAttribute('hidden', !box); // an SVG has no such property
  page.clear.hidden = !box;
  const [left, top, right, bottom] = isTap(box) && box ? around(box) : (box ?? [0, 0, 0, 0]);
  for (const [name, value] of Object.entries({ x: left, y: top, width: right - left, height: bottom - top })) {
    page.rectangle.setAttribute(name, String(value));
  }
}

/** A small square around a tap, to see it by. @param {PhotoBox} tap @returns {PhotoBox} */
function around([x, y]) {
  const { width, height } = page.drawing.getBoundingClientRect();
  const [across, down] = [TAP_PX / width, TAP_PX / height];
  return [x - across, y - down, x + across, y + down];
}

// ---- the rectangle --------------------------------------------------------------------------------------------------

/** @param {number} value */
const within = (value) => Math.round(1e4 * Math.min(1, Math.max(0, value))) / 1e4; // finer than a pixel of a screen

/**
 * @param {PointerEvent} event
 * @returns {Place} in the photo; the nearest one for a finger beside it
 */
function placeOf(event) {
  const area = page.drawing.getBoundingClientRect();
  return { x: within((event.clientX - area.left) / area.width), y: within((event.clientY - area.top) / area.height) };
}

/** @param {PointerEvent} event */
function startDrawing(event) {
  if (!event.isPrimary || event.button !== 0) return;
  page.drawing.setPointerCapture(event.pointerId); // the finger may leave the photo
  start = placeOf(event);
  box = null; // a new mark takes the place of the one before
}

/** @param {PointerEvent} event */
function goOnDrawing(event) {
  if (!start || !event.isPrimary) return;
  const end = placeOf(event);
  box = [Math.min(start.x, end.x), Math.min(start.y, end.y), Math.max(start.x, end.x), Math.max(start.y, end.y)];
  drawOutline([]);
  drawBox();
}

/** @param {PointerEvent} event */
function endDrawing(event) {
  if (!start || !event.isPrimary) return;
  const drawn = box && !isTap(box) && Math.min(box[2] - box[0], box[3] - box[1]) >= LEAST_SIDE;
  setBox(drawn ? box : [start.x, start.y, start.x, start.y]);
  start = null;
}

/** @param {PhotoBox | null} next */
function setBox(next) {
  box = next;
  drawBox();
  lookAgain();
}

/**
 * Arrow keys move the rectangle; with Shift they move its right bottom corner. Enter puts a tap in its middle, Delete takes
 * the mark away.
 * @param {KeyboardEvent} event
 */
function changeByKey(event) {
  if (event.key === 'Delete' || event.key === 'Backspace') setBox(null);
  const [left, top, right, bottom] = (isTap(box) ? null : box) ?? FIRST_BOX;
  const middle = { x: within((left + right) / 2), y: within((top + bottom) / 2) };
  if (event.key === 'Enter') setBox([middle.x, middle.y, middle.x, middle.y]);
  if (!(event.key in ARROWS)) return;
  event.preventDefault();
  const [across, down] = ARROWS[event.key];
  /** @type {PhotoBox} */
  const moved = event.shiftKey
    ? [left, top, right + across, bottom + down]
    : [left + across, top + down, right + across, bottom + down];
  const fits =
    Math.min(...moved) >= 0 &&
    Math.max(...moved) <= 1 &&
    moved[2] - moved[0] >= LEAST_SIDE &&
    moved[3] - moved[1] >= LEAST_SIDE;
  setBox(fits ? moved : [left, top, right, bottom]);
}

page.photo.addEventListener('error', () => {
  page.section.hidden = true; // such as HEIC; the server can read it
});
page.drawing.addEventListener('pointerdown', startDrawing);
page.drawing.addEventListener('pointermove', goOnDrawing);
page.drawing.addEventListener('pointerup', endDrawing);
page.drawing.addEventListener('pointercancel', endDrawing);
page.drawing.addEventListener('keydown', changeByKey);
page.clear.addEventListener('click', () => setBox(null));
page.mark.addEventListener('toggle', listPhotos);
