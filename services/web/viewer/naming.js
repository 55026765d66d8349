// The panel of the viewer's page for who manages a thing: its name, description and search words.
import { getJson, patchJson } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { element } from '../shared/dom.js';
import { joinWords, splitWords } from '../shared/search-words.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, AssetNames } from '../shared/types.d.ts' */

const panel = {
  form: element('names-form', HTMLFormElement),
  label: element('names-label', HTMLInputElement),
  description: element('names-description', HTMLTextAreaElement),
  words: element('names-words', HTMLInputElement),
  saved: element('names-saved', HTMLElement),
  trouble: element('names-trouble', HTMLElement),
};

/** What the fields said before the person changed them. */
let before = { label: '', description: '', words: '' };

/**
 * Shows the panel's content for an asset of one's own.
 * @param {string} key
 * @param {(names: AssetNames) => void} onChange is called with what was saved
 * @throws {Problem} as `getJson`
 */
export async function showNaming(key, onChange) {
  const path = `/v1/assets/${encodeURIComponent(key)}`;
  /** @type {AssetEntry} */
  const entry = await getJson(path);
  fill({ label: entry.label || key, description: entry.description ?? '', labels: entry.labels ?? [] });
  panel.form.addEventListener('submit', (event) => {
    event.preventDefault();
    attempt(
      panel.trouble,
      async () => {
        /** @type {AssetNames} */
        const names = await patchJson(path, changes());
        fill(names);
        onChange(names);
        panel.saved.textContent = t('Saved.');
      },
      panel.form,
    );
  });
  panel.form.addEventListener('input', () => (panel.saved.textContent = ''));
}

/** What the person has changed; the rest may have been changed elsewhere meanwhile. */
function changes() {
  /** @type {Partial<Pick<AssetNames, 'label' | 'description' | 'labels'>>} */
  const changed = {};
  if (panel.label.value !== before.label) changed.label = panel.label.value;
  if (panel.description.value !== before.description) changed.description = panel.description.value;
  if (panel.words.value !== before.words) changed.labels = splitWords(panel.words.value);
  return changed;
}

/** @param {Pick<AssetNames, 'label' | 'description' | 'labels'>} names */
function fill({ label, description, labels }) {
  panel.label.value = label;
  panel.description.value = description;
  panel.words.value = joinWords(labels);
  before = { label: panel.label.value, description: panel.description.value, words: panel.words.value }; // as the browser has them: on one line
}
