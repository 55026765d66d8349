// The panel of the viewer's page that adds a thing of a collection to the scene: pictures to choose from, a search, pages of twelve.
import { findThings } from './find-things.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { FoundAsset } from '../shared/types.d.ts' */

const TYPING_MS = 250; // between two letters of one word

const panel = {
  form: element('add-form', HTMLFormElement),
  search: element('add-search', HTMLInputElement),
  collection: element('add-collection', HTMLInputElement),
  list: element('add-list', HTMLElement),
  said: element('add-said', HTMLElement),
  trouble: element('add-trouble', HTMLElement),
  previous: element('add-previous', HTMLButtonElement),
  next: element('add-next', HTMLButtonElement),
};

/**
 * Shows the panel's content.
 * @param {(key: string) => void} onChoose is called with the asset that was chosen
 * @param {string} collection
 */
export function showAdding(onChoose, collection) {
  /** @type {string[]} */
  let before = []; // the beginnings of the pages up to this one
  let following = /** @type {string | null} */ (null);
  let timer = 0;
  let asked = 0;
  const show = (/** @type {string[]} */ pages) => attempt(panel.trouble, async () => {
    const mine = ++asked;
    const found = await findThings(panel.collection.value.trim() || 'default', panel.search.value.trim(), pages.at(-1) ?? '');
    if (mine !== asked) return; // somebody has typed on meanwhile, and this answer came later than the newer one
    before = pages;
    following = found.next;
    panel.list.replaceChildren(...found.assets.map((asset) => createChoice(asset, onChoose)));
    panel.said.textContent = found.assets.length === 0 ? t('Nothing has that name or label.') : '';
    panel.previous.disabled = before.length === 0;
    panel.next.disabled = following === null;
    document.body.dataset.choices = String(found.assets.length);
  });
  const searchSoon = () => {
    clearTimeout(timer);
    timer = setTimeout(() => show([]), TYPING_MS);
  };
  panel.collection.value = collection;
  panel.form.addEventListener('input', searchSoon);
  panel.form.addEventListener('submit', (event) => {
    event.preventDefault();
    searchSoon();
  });
  panel.previous.addEventListener('click', () => show(before.slice(0, -1)));
  panel.next.addEventListener('click', () => following !== null && show([...before, following]));
  show([]);
}

/**
 * @param {FoundAsset} asset
 * @param {(key: string) => void} onChoose
 */
function createChoice({ key, label, preview }, onChoose) {
  const item = create('li');
  const button = create('button', { type: 'button' });
  button.append(create('img', { alt: '', src: preview || '/web/shared/icon.svg', width: 72, height: 72, loading: 'lazy' }), create('span', { textContent: label, dir: 'auto' }));
  button.addEventListener('click', () => onChoose(key));
  item.append(button);
  return item;
}
