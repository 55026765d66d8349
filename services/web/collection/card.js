// One thing on the page of a collection: its picture, name, labels and state, and a box to choose it by.
import { isConnectionProblem } from '../shared/problems.js';
import { manifestOf } from '../shared/signed-catalogue.js';
import { loadFile } from '../shared/verified-cache.js';

const PICTURES = ['thumbnail.webp', 'preview.png']; // the first that there is
const TURNING = 'turning.webp';
const TYPES = { webp: 'image/webp', png: 'image/png' }; // of a file by its ending: no other kind is shown
const STATES = { preview: 'preview', refined: 'refined' };
const SHOWN_LABELS = 6;

/**
 * A list item for a row of the collection. `onLabel(label)` hears of clicks, `onChoose(yes)` answers whether it is chosen, `onLost()` hears of
 * a picture that the server did not serve.
 * Its `look()` loads the picture, to be called once it comes into view; `leave()` frees it.
 */
export function cardOf(collection, row, { chosen, onLabel, onChoose, onLost }) {
  const item = document.createElement('li');
  item.dataset.key = row.key;
  const link = made('a', { href: `/view/${encodeURIComponent(row.key)}` });
  const picture = made('img', { alt: '', width: 256, height: 256, decoding: 'async' });
  link.append(picture, made('span', { className: 'name', dir: 'auto', textContent: row.label }));
  const facts = made('p', { className: 'facts', textContent: STATES[row.state] || '' });
  const box = made('input', { type: 'checkbox', checked: chosen });
  box.setAttribute('aria-label', `Choose ${row.label}`);
  box.addEventListener('change', () => (box.checked = onChoose(box.checked)));
  const check = made('label', { className: 'check' });
  check.append(box, 'Choose');
  item.append(link, facts, ...labelsOf(row, onLabel), check);
  return Object.assign(item, animated(item, picture, looker(collection, row, { item, picture, facts, onLost })));
}

function labelsOf({ labels }, onLabel) {
  if (labels.length === 0) return [];
  const line = made('p', { className: 'labels' });
  for (const label of labels.slice(0, SHOWN_LABELS)) {
    const button = made('button', { type: 'button', dir: 'auto', textContent: label, title: `Everything labelled ${label}` });
    button.addEventListener('click', () => onLabel(label));
    line.append(button);
  }
  return [line];
}

/** {look, leave, turning}: the still picture's life, and the address of the moving one, loaded when it is first asked for. */
function looker(collection, row, { item, picture, facts, onLost }) {
  const addresses = [];
  let manifest = null;
  let gone = false;
  let moving = null;

  async function addressOf(file) {
    const bytes = await loadFile(file);
    const address = URL.createObjectURL(new Blob([bytes], { type: TYPES[file.file.split('.').pop()] }));
    if (gone) URL.revokeObjectURL(address);
    else addresses.push(address);
    return address;
  }

  const fileNamed = (name) => manifest?.files.find(({ file }) => file === name);

  return {
    async look() {
      try {
        manifest = await manifestOf(collection, row);
        if (manifest.origin === 'guess') facts.textContent = 'a guess from one photo';
        const file = PICTURES.map(fileNamed).find(Boolean);
        if (file) picture.src = await addressOf(file);
        item.dataset.picture = file ? file.file : 'none';
      } catch (problem) {
        item.dataset.picture = problem.code || 'none';
        facts.textContent = problem.code === 'ASSET_TAMPERED' ? problem.message : 'Its picture could not be loaded.';
        if (isConnectionProblem(problem)) onLost();
      }
    },
    turning: () => {
      const file = fileNamed(TURNING);
      if (!file) return null;
      moving ??= addressOf(file).catch(() => null);
      return moving;
    },
    leave() {
      gone = true;
      addresses.forEach((address) => URL.revokeObjectURL(address));
    },
  };
}

/** While pointed at or focused, the thing turns, unless the person has asked their device for less motion. */
function animated(item, picture, { look, leave, turning }) {
  let still = null;
  async function start() {
    if (still !== null || matchMedia('(prefers-reduced-motion: reduce)').matches) return;
    still = picture.src;
    const address = await turning();
    if (address && still !== null) picture.src = address;
  }
  function stop() {
    if (still) picture.src = still;
    still = null;
  }
  for (const kind of ['pointerenter', 'focusin']) item.addEventListener(kind, start);
  for (const kind of ['pointerleave', 'focusout']) item.addEventListener(kind, stop);
  return { look, leave };
}

function made(kind, facts) {
  return Object.assign(document.createElement(kind), facts);
}
