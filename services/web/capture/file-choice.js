// The form's first two parts: which files to send, and the name of the object.
import { mayHaveCompass, readHeading, startCompass } from './compass.js';
import { guide, isPhoto, setHeading } from './guidance.js';
import { beginAnother, forgetPhoto, goOnWith, keepPhoto } from './keeping.js';
import { showKept } from './kept-list.js';
import { startLiveCamera } from './live-camera.js';
import { showPhotos } from './photo-box.js';
import { FEWEST } from './photo-set.js';
import { keyFrom } from '../shared/api.js';
import { element, fillList } from '../shared/dom.js';
import { formatNumber } from '../shared/format.js';
import { t } from '../shared/texts.js';

/** @import { KeptCapture } from '../shared/kept-captures.js' */

const LISTED = 6; // files named before "and N more"
const INPUTS = ['files', 'photos', 'film', 'folder'];
const ADDING = ['photos', 'film']; // inputs whose files are added to those that are chosen already; the others replace them

const page = {
  chosen: element('chosen', HTMLElement),
  notKept: element('not-kept', HTMLElement),
  list: element('list', HTMLElement),
  compass: element('compass', HTMLButtonElement),
  name: element('name', HTMLInputElement),
  key: element('key', HTMLElement),
  send: element('send', HTMLButtonElement),
};

/** @type {File[]} */
let files = [];
/** @type {WeakSet<File>} */
const taken = new WeakSet(); // by the camera in the page: their names say nothing of the thing
let isMore = false; // the files are added to what is stored
let useCompass = false; // whether the person allows the page to ask the phone where its camera looks

/** The files that are chosen now: another list after each change. */
export const chosenFiles = () => files;

/** Whether photos were taken that could not be kept on the device. */
export const hasUnkept = () => files.length > 0 && !page.notKept.hidden;

/** The name of the object as the person wrote it. */
export const chosenName = () => page.name.value.trim();

/**
 * Expects more photos of an object that is there already.
 * @param {string} name
 */
export function expectMore(name) {
  isMore = true;
  page.chosen.textContent = t(
    'Photos of the sides that were seen too little, each overlapping the others by two thirds.',
  );
  page.name.value = name;
  showKey();
}

/** Listens to the form's file inputs, its compass button, and its name. */
export function startFileChoice() {
  for (const id of INPUTS) {
    const input = element(id, HTMLInputElement);
    input.addEventListener('change', () => addFiles(id, input));
  }
  page.compass.hidden = !mayHaveCompass();
  page.compass.addEventListener('click', async () => {
    useCompass = await startCompass();
    page.compass.disabled = useCompass;
    page.compass.textContent = useCompass ? t('The compass is used') : t('There is no compass; try again');
  });
  page.name.addEventListener('input', showKey);
  startLiveCamera(addPhoto);
}

/**
 * Adds a photo that the camera in the page has taken.
 * @param {File} photo
 * @param {number | null} heading degrees clockwise
 */
function addPhoto(photo, heading) {
  taken.add(photo);
  keepTaken(photo, heading);
  files = [...files, photo];
  showFiles();
}

/**
 * Keeps a photo on the device that the person has just taken; says where that is impossible.
 * @param {File} photo
 * @param {number | null} heading
 */
async function keepTaken(photo, heading) {
  setHeading(photo, heading);
  const trouble = await keepPhoto(photo, heading);
  page.notKept.textContent = trouble;
  page.notKept.hidden = !trouble;
  document.body.dataset.onDevice = trouble ? 'no' : 'yes';
}

/**
 * Goes on with photos that were taken here earlier.
 * @param {KeptCapture} draft
 */
export async function goOn(draft) {
  const photos = await goOnWith(draft);
  for (const { file, heading } of photos) {
    setHeading(file, heading);
    taken.add(file);
  }
  files = photos.map(({ file }) => file);
  if (draft.name) page.name.value = draft.name;
  showFiles();
}

/**
 * Takes the files of an input.
 * @param {string} id
 * @param {HTMLInputElement} input
 */
async function addFiles(id, input) {
  const added = [...(input.files ?? [])];
  if (added.length === 0) return;
  input.value = ''; // so that the same file can be chosen again after it was removed
  const heading = id === 'photos' && useCompass && added.length === 1 ? await readHeading() : null;
  if (id === 'photos') for (const photo of added) keepTaken(photo, heading);
  const replaces = !ADDING.includes(id);
  files = replaces ? added : [...files, ...added];
  showFiles();
  if (replaces) await beginAnother().then(showKept);
}

/** Shows what is chosen: how many files and megabytes, guidance for photos, and the names of other files. */
function showFiles() {
  const bytes = files.reduce((sum, file) => sum + file.size, 0);
  const count = files.length === 1 ? t('1 file') : t('{count} files', { count: files.length });
  page.chosen.textContent = files.length
    ? `${count}, ${formatNumber((bytes / 1e6).toFixed(1))} MB`
    : t('Nothing chosen yet.');
  page.list.hidden = guide(files, { isMore, onRemove: removeFiles });
  showPhotos(isMore ? [] : photosToMark());
  const names = files.slice(0, LISTED).map((file) => file.webkitRelativePath || file.name);
  if (files.length > LISTED) names.push(t('… and {count} more', { count: files.length - LISTED }));
  fillList(page.list, names);
  if (!page.name.value && files.length && !taken.has(files[0])) page.name.value = nameFrom(files[0]);
  showKey();
}

/** The photos of which one can get a rectangle: the only file, or as many as can be reconstructed together. */
function photosToMark() {
  const photos = files.filter(isPhoto);
  return photos.length === files.length || photos.length >= FEWEST ? photos : [];
}

/** @param {File[]} unwanted */
function removeFiles(unwanted) {
  files = files.filter((file) => !unwanted.includes(file));
  for (const file of unwanted) forgetPhoto(file);
  showFiles();
}

/**
 * A name for the object from that of its folder, or of its file without the ending.
 * @param {File} file
 */
function nameFrom(file) {
  const path = (file.webkitRelativePath || file.name).split('/');
  return (path.length > 1 ? path[0] : path[0].replace(/\.[^.]+$/, '')).replace(/[_-]+/g, ' ');
}

/** Shows the key that the headset finds the object by, and allows sending once there are files and a name. */
function showKey() {
  const key = keyFrom(page.name.value);
  page.key.textContent = key || '…';
  page.send.disabled = !(key && files.length);
}
