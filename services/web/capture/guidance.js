// Guidance while photos are chosen: how many there are, which would do harm, and how far around the object they go.
import { child, create, element } from '../shared/dom.js';
import { drawRings } from './coverage-ring.js';
import { differenceOf } from './photo-quality.js';
import { queuePhoto } from './photo-quality-queue.js';
import { ADVISED, FEW, FEWEST, coverageOf, findFaults, isMeasured } from './photo-set.js';
import { t } from '../shared/texts.js';

/** @import { MeasuredPhoto, Photo } from './photo-set.js' */
/** @typedef {{ item: HTMLLIElement, file: File, sentence: string }} FaultItem an item of the list of photos that would do harm */

const REDRAW_MS = 100; // results of several photos are drawn together

const page = {
  guide: element('guide', HTMLElement),
  count: element('count', HTMLElement),
  advice: element('advice', HTMLElement),
  ring: element('ring', SVGElement),
  coverage: element('seen', HTMLElement),
  faults: element('faulty', HTMLElement),
  faultCount: element('faulty-count', HTMLElement),
  faultList: element('faults', HTMLUListElement),
  removeAll: element('remove-all', HTMLButtonElement),
};

/** @type {Map<File, Photo>} */
const photos = new Map();
/** @type {WeakMap<File, number | null>} */
const headings = new WeakMap(); // degrees clockwise
/** @type {File[]} */
let files = [];
/** @type {FaultItem[]} */
let faultItems = [];
/** @type {(files: File[]) => void} */
let removeFiles = () => {};
let isMore = false; // the photos are added to others
let redrawTimer = 0;

/** @param {File} file */
export const isPhoto = (file) =>
  file.type.startsWith('image/') || /\.(jpe?g|png|webp|heic|heif|avif|tiff?)$/i.test(file.name);
/** @param {File} file */
const isFilm = (file) => file.type.startsWith('video/') || /\.(mp4|mov|m4v|webm|mkv)$/i.test(file.name);

/**
 * Stores the direction in which a photo was taken; to be called before `guide` gets the photo.
 * @param {File} file
 * @param {number | null} degrees clockwise, or null where the compass gave none
 */
export function setHeading(file, degrees) {
  headings.set(file, degrees);
}

/**
 * Shows guidance for these files, where all of them are photos and films.
 * @param {File[]} chosen
 * @param {{ isMore: boolean, onRemove: (files: File[]) => void }} about `isMore`: they are added to photos that are stored; `onRemove` is
 *   called with files that the person wants to remove
 * @returns {boolean} whether guidance is shown
 */
export function guide(chosen, about) {
  [files, removeFiles, isMore] = [chosen, about.onRemove, about.isMore];
  for (const photo of photos.values()) if (!files.includes(photo.file)) forget(photo);
  const guided = files.length > 0 && files.every((file) => isPhoto(file) || isFilm(file));
  page.guide.hidden = !guided;
  if (!guided) return false;
  for (const file of files.filter(isPhoto)) if (!photos.has(file)) measure(file);
  draw();
  return true;
}

/** The address of a photo's small picture; '' until it is measured. @param {File} file */
export const thumbnailOf = (file) => photos.get(file)?.thumbnailUrl ?? '';

/**
 * Says why a new photo would do harm beside those that are chosen; '' where it would not, or where this browser cannot decode it.
 * @param {File} file
 * @returns {Promise<string>}
 */
export async function faultOfNew(file) {
  const quality = await queuePhoto(file);
  if (!quality) return '';
  const others = [...photos.values()].filter(isMeasured);
  const differences = new Map(others.map((other) => [other.file, differenceOf(quality, other.quality)]));
  /** @type {MeasuredPhoto} */
  const photo = { file, quality, differences, thumbnailUrl: '', heading: null };
  return findFaults([...others, photo]).get(file) ?? '';
}

/**
 * Measures a photo, and compares it with those that are measured already.
 * @param {File} file
 */
async function measure(file) {
  /** @type {Photo} */
  const photo = { file, differences: new Map(), thumbnailUrl: '', heading: headings.get(file) ?? null };
  photos.set(file, photo);
  const quality = await queuePhoto(file);
  if (photos.get(file) !== photo) return; // removed meanwhile
  photo.quality = quality;
  if (quality) {
    photo.thumbnailUrl = URL.createObjectURL(quality.thumbnail);
    for (const other of [...photos.values()].filter(isMeasured)) {
      if (other.file === file) continue;
      const difference = differenceOf(quality, other.quality);
      photo.differences.set(other.file, difference);
      other.differences.set(file, difference);
    }
  }
  clearTimeout(redrawTimer);
  redrawTimer = setTimeout(draw, REDRAW_MS);
}

/** @param {Photo} photo */
function forget({ file, thumbnailUrl }) {
  URL.revokeObjectURL(thumbnailUrl);
  photos.delete(file);
  for (const { differences } of photos.values()) differences.delete(file);
}

// ---- drawing --------------------------------------------------------------------------------------------------------

/** Shows the guidance for the files as far as they are measured. */
function draw() {
  const chosen = files.flatMap((file) => photos.get(file) ?? []);
  const films = files.filter(isFilm).length;
  const measured = chosen.filter(isMeasured);
  const faults = findFaults(measured);
  page.ring.toggleAttribute('hidden', measured.length === 0); // an SVG has no such property
  page.coverage.hidden = measured.length === 0;
  page.count.textContent = countText(chosen.length, films);
  page.advice.textContent = adviceFor(chosen, films);
  const coverage = coverageOf(measured.filter(({ file }) => !faults.has(file)));
  page.coverage.textContent = coverage.sentence(drawRings(coverage));
  drawFaults(faults);
  document.body.dataset.looked = chosen.every(({ quality }) => quality !== undefined) ? String(chosen.length) : '';
}

/**
 * @param {number} photoCount
 * @param {number} filmCount
 */
function countText(photoCount, filmCount) {
  const photoText = photoCount === 1 ? t('1 photo') : t('{count} photos', { count: photoCount });
  const filmText = filmCount === 1 ? t('1 video') : t('{count} videos', { count: filmCount });
  return photoCount && filmCount
    ? t('{photos} and {films}', { photos: photoText, films: filmText })
    : filmCount
      ? filmText
      : photoText;
}

/**
 * @param {Photo[]} chosen
 * @param {number} films
 */
function adviceFor(chosen, films) {
  const unknown = chosen.filter(({ quality }) => quality === null).length;
  const rest = unknown
    ? ` ${t('{count} cannot be looked at in this browser; the server will.', { count: unknown })}`
    : '';
  const count = chosen.length;
  const [least, most] = ADVISED;
  if (isMore) return t('They are added to the photos that are stored.') + rest;
  if (films && count < FEWEST) {
    return t('Its best pictures are chosen for you.') + (films > 1 ? ` ${t('Only the largest video is used.')}` : '');
  }
  if (films) return t('There are photos enough, so the video is not used.') + rest;
  if (count <= FEW) {
    return (
      t(
        'What no photo shows will be a guess: {more} more from around, where the ring is empty, make it measured. {least} to {most} are best.',
        { more: FEW + 1 - count, least, most },
      ) + rest
    );
  }
  if (count < least) {
    return (
      t('{least} to {most} are best: {count} more, from where there is none yet.', {
        least,
        most,
        count: least - count,
      }) + rest
    );
  }
  if (count <= most) return t('A good number.') + rest;
  return t('More than {most} take longer and seldom show more.', { most }) + rest;
}

/**
 * Lists the photos that would do harm. Items that stay the same are not replaced, so that the keyboard's focus stays.
 * @param {Map<File, string>} faults
 */
function drawFaults(faults) {
  const wanted = files
    .flatMap((file) => ({ file, sentence: faults.get(file) ?? '' }))
    .filter(({ sentence }) => sentence);
  page.faults.hidden = wanted.length === 0;
  page.faultCount.textContent =
    wanted.length === 1 ? t('1 photo may do harm') : t('{count} photos may do harm', { count: wanted.length });
  page.removeAll.hidden = wanted.length < 2;
  const items = wanted.map(({ file, sentence }) => {
    const shown = faultItems.find((each) => each.file === file && each.sentence === sentence);
    return shown ?? createFaultItem(file, sentence);
  });
  if (items.length === faultItems.length && items.every((item, place) => item === faultItems[place])) return;
  faultItems = items;
  const focus = document.activeElement; // moving an item takes its focus away
  page.faultList.replaceChildren(...items.map(({ item }) => item));
  if (focus instanceof HTMLElement && page.faultList.contains(focus)) focus.focus();
}

/**
 * @param {File} file
 * @param {string} sentence
 * @returns {FaultItem}
 */
function createFaultItem(file, sentence) {
  const item = create('li');
  const picture = create('img', { src: thumbnailOf(file), alt: '', width: 64, height: 64 });
  const text = create('p');
  text.append(create('strong', { textContent: file.name }), ` ${sentence}`);
  const button = create('button', {
    type: 'button',
    textContent: t('Remove'),
    ariaLabel: t('Remove {name}', { name: file.name }),
  });
  button.addEventListener('click', () => remove([file], item.nextElementSibling ?? item.previousElementSibling));
  item.append(picture, text, button);
  return { item, file, sentence };
}

/**
 * Removes files. The keyboard's focus goes to the item `next`, or to the guidance where that is gone too.
 * @param {File[]} unwanted
 * @param {Element | null} next
 */
function remove(unwanted, next) {
  const follower = faultItems.find(({ item }) => item === next)?.file;
  removeFiles(unwanted);
  const shown = faultItems.find(({ file }) => file === follower);
  if (shown) child(shown.item, 'button', HTMLButtonElement).focus();
  else page.guide.focus();
}

page.removeAll.addEventListener('click', () =>
  remove(
    faultItems.map(({ file }) => file),
    null,
  ),
);
