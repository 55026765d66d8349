// The panel of the viewer's page that saves, names and deletes the scene.
import { attempt } from '../shared/attempt.js';
import { element } from '../shared/dom.js';
import { onSecondPress } from '../shared/second-press.js';
import { t } from '../shared/texts.js';

/**
 * What the panel is about.
 * @typedef {object} SceneOffer
 * @property {() => string} id of the saved scene; '' for one that is not saved
 * @property {boolean} canShare whether there are accounts, so that there is somebody to share it with
 * @property {() => string} name
 * @property {(name: string) => Promise<void>} onSave
 * @property {() => Promise<void>} onDelete
 */

const panel = {
  form: element('scene-form', HTMLFormElement),
  name: element('scene-name', HTMLInputElement),
  said: element('scene-said', HTMLElement),
  trouble: element('scene-trouble', HTMLElement),
  delete: element('scene-delete', HTMLButtonElement),
};

/**
 * Shows the panel's content.
 * @param {SceneOffer} offer
 * @returns {() => void} to be called when it was saved for the first time, or deleted
 */
export function showScenePanel({ id, name, onSave, onDelete }) {
  const update = () => {
    panel.said.textContent = id()
      ? t('What you move is saved at once.')
      : t('Saved, it opens on other devices too, from its address.');
    panel.delete.hidden = !id();
  };
  update();
  panel.name.value ||= name(); // somebody may have begun to type while this module was loaded
  panel.form.addEventListener('submit', (event) => {
    event.preventDefault();
    attempt(
      panel.trouble,
      async () => {
        await onSave(panel.name.value.trim() || t('Scene'));
        panel.said.textContent = t('Saved.');
      },
      panel.form,
    );
  });
  onSecondPress(panel.delete, t('Tap again: it cannot be undone'), () =>
    attempt(panel.trouble, onDelete, panel.delete),
  );
  return update;
}
