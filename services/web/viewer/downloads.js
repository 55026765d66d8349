// The panel of the viewer's page that downloads a thing for other programs. A file is made on the server when somebody first wants it.
import { getJson } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { formatBytes } from '../shared/format.js';
import { fetchBytes } from '../shared/network.js';
import { parseAnswer } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { DOWNLOAD_ANSWER_MS } from '../shared/time-limits.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { SceneItem } from './scene-item.js' */
/** @import { Download, DownloadList } from '../shared/types.d.ts' */

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
 */
export async function showDownloads(item, showSplats) {
  await attempt(panel.trouble, async () => {
    /** @type {DownloadList} */
    const { downloads } = await getJson(ofShownTenant(`/v1/assets/${encodeURIComponent(item.key)}/downloads`));
    const entries = downloads.map(createItem);
    const place = downloads.findIndex(({ format }) => format === SPLATS);
    if (place >= 0) entries[place].append(createSwitch(downloads[place], item, showSplats));
    panel.list.replaceChildren(...entries);
    document.body.dataset.downloads = String(downloads.length);
  });
}

/** @param {Download} download */
function createItem(download) {
  const item = create('li');
  const size = download.bytes === null ? '' : `, ${formatBytes(download.bytes)}`;
  const button = create('button', { type: 'button', textContent: `${download.title}${size}` });
  const about = create('p', { className: 'quiet', textContent: download.about, id: `download-${download.format}` });
  button.setAttribute('aria-describedby', about.id);
  button.addEventListener('click', () => attempt(panel.trouble, () => save(download, button)));
  item.append(button, about);
  return item;
}

/**
 * Waits until the file has been made, and has the browser save it.
 * @param {Download} download
 * @param {HTMLButtonElement} button stays disabled meanwhile
 */
async function save({ url, title, file }, button) {
  button.disabled = true;
  panel.said.textContent = t('{title} is being made …', { title });
  try {
    await untilMade(url);
    panel.said.textContent = t('{file} is being saved.', { file });
    create('a', { href: url, download: file }).click();
  } catch (error) {
    panel.said.textContent = '';
    throw error;
  } finally {
    button.disabled = false;
  }
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
  button.addEventListener('click', async () => {
    button.disabled = true;
    await attempt(panel.trouble, toggle);
    button.disabled = false;
  });
  return button;
}

/**
 * Asks for a file until the server knows where it is.
 * @param {string} url
 */
async function untilMade(url) {
  for (;;) {
    const { response, bytes } = await fetchBytes(url, { redirect: 'manual', cache: 'no-store', silenceMs: DOWNLOAD_ANSWER_MS });
    if (response.type === 'opaqueredirect') return;
    if (response.status !== 202) {
      parseAnswer(response.status, new TextDecoder().decode(bytes));
      return;
    }
    await new Promise((resolve) => setTimeout(resolve, 1000 * Number(response.headers.get('Retry-After') ?? 2)));
  }
}

