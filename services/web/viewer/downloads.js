// The panel of the viewer's page that downloads a thing for other programs, or shows its splats.
import { loadDownloads, untilMade } from '../catalogue/download-list.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { fetchBytes } from '../shared/network.js';
import { t } from '../shared/texts.js';
import { DOWNLOAD_ANSWER_MS } from '../shared/time-limits.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { SceneItem } from '../scenes/scene-item.js' */
/** @import { Download } from '../shared/types.d.ts' */

/** @typedef {(bytes: ArrayBuffer) => Promise<void>} ShowSplats shows the splats of a file on this page */

const SPLATS = 'splats-spz'; // the format that the page itself can show

const panel = {
  list: element('downloads-list', HTMLElement),
  said: element('downloads-said', HTMLElement),
  trouble: element('downloads-trouble', HTMLElement),
};

/**
 * Lists the formats that an asset can have, each with a button that downloads it; behind that of splats, one that shows them here.
 * @param {SceneItem} item
 * @param {ShowSplats} showSplats
 * @throws {Problem} as `getJson`
 */
export async function showDownloads(item, showSplats) {
  const entries = await loadDownloads(ofShownTenant(`/v1/assets/${encodeURIComponent(item.key)}/downloads`), panel);
  const splats = entries.find(({ download }) => download.format === SPLATS);
  splats?.item.append(createSwitch(splats.download, item, showSplats));
  panel.list.replaceChildren(...entries.map((entry) => entry.item));
  document.body.dataset.downloads = String(entries.length);
}

/**
 * Creates the button that shows splats in place of the mesh, or the mesh again.
 * @param {Download} download
 * @param {SceneItem} item
 * @param {ShowSplats} showSplats
 */
function createSwitch({ url, title }, item, showSplats) {
  const button = create('button', { type: 'button', textContent: t('Show them here') });
  button.setAttribute('aria-pressed', 'false');
  const toggle = async () => {
    if (item.splats) {
      item.splats.dispose();
    } else {
      panel.said.textContent = t('{title} is being made …', { title });
      await untilMade(url);
      await showSplats((await fetchBytes(url, { silenceMs: DOWNLOAD_ANSWER_MS })).bytes);
    }
    panel.said.textContent = '';
    button.setAttribute('aria-pressed', String(item.splats !== null));
    document.body.dataset.splats = item.splats ? 'shown' : 'hidden';
  };
  button.addEventListener('click', () => attempt(panel.trouble, toggle, button));
  return button;
}
