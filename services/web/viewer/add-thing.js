// The panel of the viewer's page that adds a thing of a collection to the scene: pictures to choose from, a search, pages of twelve.
import { ThingSearch } from '../scenes/find-things.js';
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
 * @throws {Problem} as `getJson`
 */
export async function showAdding(onChoose, collection) {
  const search = new ThingSearch();
  let timer = 0;
  const find = async (/** @type {string[] | null} */ pages) => {
    const found = await search.find(
      panel.collection.value.trim() || 'default',
      panel.search.value.trim(),
      pages ?? undefined,
    );
    if (!found) return; // somebody has typed on meanwhile
    panel.list.replaceChildren(...found.map((asset) => createChoice(asset, onChoose)));
    panel.said.textContent = found.length === 0 ? t('Nothing has that name or tag.') : '';
    panel.previous.disabled = search.previous === null;
    panel.next.disabled = search.next === null;
    document.body.dataset.choices = String(found.length);
  };
  const show = (/** @type {string[] | null} */ pages) => attempt(panel.trouble, () => find(pages));
  const searchSoon = () => {
    clearTimeout(timer);
    timer = setTimeout(() => show(null), TYPING_MS);
  };
  panel.collection.value = collection;
  await find(null);
  panel.form.addEventListener('input', searchSoon);
  panel.form.addEventListener('submit', (event) => {
    event.preventDefault();
    searchSoon();
  });
  panel.previous.addEventListener('click', () => show(search.previous));
  panel.next.addEventListener('click', () => show(search.next));
}

/**
 * @param {FoundAsset} asset
 * @param {(key: string) => void} onChoose
 */
function createChoice({ key, label, preview }, onChoose) {
  const item = create('li');
  const button = create('button', { type: 'button' });
  button.append(
    create('img', { alt: '', src: preview || '/web/shared/icon.svg', width: 72, height: 72, loading: 'lazy' }),
    create('span', { textContent: label, dir: 'auto' }),
  );
  button.addEventListener('click', () => onChoose(key));
  item.append(button);
  return item;
}
