// The list of saved scenes on the collection page, for whoever is logged in.
import { getJson } from '../shared/api.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { ScenePage, Session } from '../shared/types.d.ts' */

/**
 * Lists the scenes, the newest first. Nothing where there is none, or where they cannot be read now.
 * @param {Session | null} session
 */
export async function listScenes(session) {
  if (!session?.scopes.includes('read')) return;
  const scenes = await loadScenes().catch(() => []);
  element('scenes', HTMLDetailsElement).hidden = scenes.length === 0;
  element('scenes-list', HTMLElement).replaceChildren(
    ...scenes.reverse().map(({ name, things, view }) => {
      const item = create('li');
      item.append(
        create('a', { href: view, textContent: name, dir: 'auto' }),
        ` ${things === 1 ? t('1 object') : t('{count} objects', { count: things })}`,
      );
      return item;
    }),
  );
}

async function loadScenes() {
  const scenes = [];
  for (let after = /** @type {string | null} */ (''); after !== null;) {
    /** @type {ScenePage} */
    const found = await getJson(`/v1/scenes?${new URLSearchParams({ limit: '200', after })}`);
    scenes.push(...found.scenes);
    after = found.next;
  }
  return scenes;
}
