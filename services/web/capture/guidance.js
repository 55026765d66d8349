// Guidance while photos are chosen: how many, which would do harm, and how far round the thing they go.
import { change, isCopy } from './photo-quality.js';
import { look } from './photo-quality-queue.js';

const ADVISED = [15, 30]; // photos
const FEWEST = 3; // that anything can be made of
const BLURRED = 0.4; // sharpness, of the median of the set
const MOST_BLURRED = 0.3; // of the photos: the others say what is sharp here
const MOST_WHITE = 0.5; // of a photo's pixels
const STEP = 360 / ADVISED[0]; // degrees that one photo adds at most
const NEW = 0.6; // change against the most similar photo that counts as a whole step; 2 degrees make 0.25
const COMPASS_SHARE = 0.5; // of the photos that must have a direction before the compass is believed
const REDRAW_MS = 100;

const at = (id) => document.getElementById(id);
const known = new Map(); // file → { look: null where it cannot be seen, changes: Map of other files, url, heading }
let files = [];
let removeFiles = () => {};
let timer = 0;

const isPhoto = (file) => file.type.startsWith('image/') || /\.(jpe?g|png|webp|heic|heif|avif|tiff?)$/i.test(file.name);
const isFilm = (file) => file.type.startsWith('video/') || /\.(mp4|mov|m4v|webm|mkv)$/i.test(file.name);

/** Tell a photo's direction, in degrees clockwise, before it is shown. */
export function noteHeading(file, degrees) {
  known.set(file, { ...known.get(file), heading: degrees });
}

/** Guide through these files, if they are photos and films alone, and tell whether; `onRemove(files)` takes some away. */
export function guide(chosen, onRemove) {
  [files, removeFiles] = [chosen, onRemove];
  for (const file of known.keys()) if (!files.includes(file)) forget(file);
  const guided = files.length > 0 && files.every((file) => isPhoto(file) || isFilm(file));
  at('guide').hidden = !guided;
  if (!guided) return false;
  for (const file of files.filter(isPhoto)) if (!('look' in (known.get(file) ?? {}))) see(file);
  draw();
  return true;
}

async function see(file) {
  const seen = { heading: null, ...known.get(file), look: undefined, changes: new Map() };
  known.set(file, seen);
  seen.look = await look(file);
  if (known.get(file) !== seen) return; // removed meanwhile
  if (seen.look) seen.url = URL.createObjectURL(seen.look.thumbnail);
  for (const [other, { look: theirs, changes }] of known) {
    if (!theirs || !seen.look || other === file) continue;
    const changed = change(seen.look, theirs);
    seen.changes.set(other, changed);
    changes.set(file, changed);
  }
  clearTimeout(timer);
  timer = setTimeout(draw, REDRAW_MS);
}

function forget(file) {
  URL.revokeObjectURL(known.get(file).url);
  known.delete(file);
  for (const { changes } of known.values()) changes?.delete(file);
}

// ---- judging --------------------------------------------------------------------------------------------------------

/** File → a sentence, for those that would do harm. */
function faults(photos) {
  const seen = photos.filter((file) => known.get(file)?.look);
  const found = new Map();
  for (const [place, file] of seen.entries()) {
    const { look: mine, changes } = known.get(file);
    const original = seen.slice(0, place).find((other) => !found.has(other) && isCopy(mine, known.get(other).look, changes.get(other)));
    if (mine.dark) found.set(file, 'Almost black. Take it again with more light.');
    else if (mine.white > MOST_WHITE) found.set(file, 'More than half of it is plain white. Use less light, or tap on the thing before you take it.');
    else if (original) found.set(file, `Shows the same as ${original.name}. Take a step to the side between photos.`);
  }
  for (const file of blurred(seen.filter((each) => !found.has(each)))) found.set(file, 'Blurred, next to the others. Hold still, or use more light.');
  return found;
}

function blurred(photos) {
  const judged = photos.filter((file) => known.get(file).look.sharpness);
  if (judged.length === 0) return [];
  const sharpness = judged.map((file) => known.get(file).look.sharpness);
  const usual = [0, 1, 2, 3].map((step) => median(sharpness.map((each) => each[step])));
  const shares = sharpness.map((each) => Math.min(...each.map((value, step) => value / usual[step])));
  const worst = judged.map((file, place) => [shares[place], file]).sort(([one], [other]) => one - other);
  return worst.slice(0, Math.floor(MOST_BLURRED * photos.length)).filter(([share]) => share < BLURRED).map(([, file]) => file);
}

function median(values) {
  const sorted = [...values].sort((one, other) => one - other);
  return (sorted[Math.floor((sorted.length - 1) / 2)] + sorted[Math.floor(sorted.length / 2)]) / 2;
}

/** How far round they go: arcs of degrees, their sum, and how that is known. */
function spread(photos) {
  const directed = photos.map((file) => known.get(file)?.heading).filter((degrees) => typeof degrees === 'number');
  if (directed.length >= FEWEST && directed.length >= COMPASS_SHARE * photos.length) {
    const arcs = merged(directed.map((degrees) => [degrees - STEP / 2, degrees + STEP / 2]));
    const left = photos.length - directed.length;
    return { arcs, about: 'About', how: `, by the compass${left ? `; ${left} without a direction ${left === 1 ? 'is' : 'are'} not counted` : ''}` };
  }
  const steps = photos.map((file, place) => {
    const nearest = Math.min(...photos.slice(0, place).map((other) => known.get(file).changes.get(other) ?? Infinity));
    return STEP * Math.min(1, nearest / NEW);
  });
  const sum = Math.min(360, steps.reduce((total, step) => total + step, 0));
  return { arcs: [[0, sum]], about: 'Up to about', how: ': a guess from how much the photos change, for this page cannot see where you stood' };
}

/** Arcs [from, to] of a circle as arcs that do not overlap, within 0 to 360. */
function merged(arcs) {
  const flat = arcs.flatMap(([from, to]) => [[from, to], [from + 360, to + 360], [from - 360, to - 360]]);
  const within = flat.map(([from, to]) => [Math.max(0, from), Math.min(360, to)]).filter(([from, to]) => from < to);
  const done = [];
  for (const [from, to] of within.sort(([one], [other]) => one - other)) {
    const last = done.at(-1);
    if (last && from <= last[1]) last[1] = Math.max(last[1], to);
    else done.push([from, to]);
  }
  return done;
}

// ---- showing --------------------------------------------------------------------------------------------------------

function draw() {
  const photos = files.filter(isPhoto);
  const films = files.filter(isFilm);
  const seen = photos.filter((file) => known.get(file)?.look);
  at('ring').toggleAttribute('hidden', seen.length === 0); // an SVG has no such property
  at('seen').hidden = seen.length === 0;
  at('count').textContent = counted(photos.length, films.length);
  at('advice').textContent = advice(photos, films);
  const found = faults(photos);
  drawRing(spread(seen.filter((file) => !found.has(file))));
  drawFaults(found);
  document.body.dataset.looked = photos.every((file) => known.get(file)?.look !== undefined) ? photos.length : '';
}

function counted(photos, films) {
  const said = [photos === 1 ? '1 photo' : photos && `${photos} photos`, films === 1 ? '1 film' : films && `${films} films`];
  return said.filter(Boolean).join(' and ');
}

function advice(photos, films) {
  const unseen = photos.filter((file) => known.get(file)?.look === null).length;
  const left = unseen ? ` ${unseen} cannot be looked at in this browser; the server will.` : '';
  if (films.length && photos.length < FEWEST) return `Its best pictures are chosen for you.${films.length > 1 ? ' Only the largest film is used.' : ''}`;
  if (films.length) return `There are photos enough, so the film is not used.${left}`;
  if (photos.length < FEWEST) return `At least ${FEWEST} are needed; ${ADVISED.join(' to ')} from all around are best.${left}`;
  if (photos.length < ADVISED[0]) return `${ADVISED.join(' to ')} are best: ${ADVISED[0] - photos.length} more, from where there is none yet.${left}`;
  if (photos.length <= ADVISED[1]) return `A good number.${left}`;
  return `More than ${ADVISED[1]} take longer and seldom show more.${left}`;
}

function drawRing({ arcs, about, how }) {
  const seen = arcs.reduce((sum, [from, to]) => sum + to - from, 0);
  at('arcs').replaceChildren(...arcs.map(([from, to]) => arc(from, to)));
  at('turn').textContent = `${Math.round(seen / 10) * 10}°`;
  at('seen').textContent = `${about} ${Math.round(seen / 10) * 10}° seen${how}.`;
}

function arc(from, to) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', 'circle');
  const drawn = { cx: 40, cy: 40, r: 34, pathLength: 360, 'stroke-dasharray': `${to - from} 360`, 'stroke-dashoffset': -from };
  for (const [name, value] of Object.entries(drawn)) made.setAttribute(name, value);
  return made;
}

function drawFaults(found) {
  const wanted = files.filter((file) => found.has(file));
  at('faulty').hidden = wanted.length === 0;
  at('faulty-count').textContent = wanted.length === 1 ? '1 photo may do harm' : `${wanted.length} photos may do harm`;
  at('remove-all').hidden = wanted.length < 2;
  const shown = new Map([...at('faults').children].map((item) => [item.file, item]));
  const items = wanted.map((file) => (shown.get(file)?.sentence === found.get(file) ? shown.get(file) : fault(file, found.get(file))));
  if (items.length === shown.size && items.every((item, place) => item === at('faults').children[place])) return;
  const focused = document.activeElement; // moving an item takes its focus away
  at('faults').replaceChildren(...items);
  if (at('faults').contains(focused)) focused.focus();
}

function fault(file, sentence) {
  const item = document.createElement('li');
  Object.assign(item, { file, sentence });
  const picture = Object.assign(document.createElement('img'), { src: known.get(file).url, alt: '', width: 64, height: 64 });
  const words = document.createElement('p');
  words.append(Object.assign(document.createElement('strong'), { textContent: file.name }), ` ${sentence}`);
  const button = Object.assign(document.createElement('button'), { type: 'button', textContent: 'Remove', ariaLabel: `Remove ${file.name}` });
  button.addEventListener('click', () => remove([file], item.nextElementSibling ?? item.previousElementSibling));
  item.append(picture, words, button);
  return item;
}

/** Take files away; the keyboard goes on at `next`, the item of another one. */
function remove(gone, next) {
  const follower = next?.file;
  removeFiles(gone);
  const item = [...at('faults').children].find((each) => each.file === follower);
  (item?.querySelector('button') ?? at('guide')).focus();
}

at('remove-all').addEventListener('click', () => remove([...at('faults').children].map((item) => item.file)));
