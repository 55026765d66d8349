// The formats in which a thing can be downloaded for other programs, as a list of buttons. A file is made on the server when somebody first wants it.
import { getJson } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create } from '../shared/dom.js';
import { formatBytes } from '../shared/format.js';
import { fetchBytes } from '../shared/network.js';
import { parseAnswer } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { DOWNLOAD_ANSWER_MS } from '../shared/time-limits.js';

/** @import { Download, DownloadList } from '../shared/types.d.ts' */

/**
 * @typedef {object} Places where a list says what it does
 * @property {HTMLElement} said
 * @property {HTMLElement} trouble shows why something failed; hidden otherwise
 */

/**
 * Asks in which formats something can be downloaded.
 * @param {string} url of the list
 * @param {Places} places
 * @returns {Promise<{ download: Download, item: HTMLLIElement }[]>} each format with an item of a list: a button that downloads it, and what it is for
 * @throws {Problem} as `getJson`
 */
export async function loadDownloads(url, places) {
  /** @type {DownloadList} */
  const { downloads } = await getJson(url);
  return downloads.map((download) => ({ download, item: createItem(download, places) }));
}

/**
 * @param {Download} download
 * @param {Places} places
 */
function createItem(download, { said, trouble }) {
  const item = create('li');
  const size = download.bytes === null ? '' : `, ${formatBytes(download.bytes)}`;
  const button = create('button', { type: 'button', textContent: `${download.title}${size}` });
  const about = create('p', { className: 'quiet', textContent: download.about, id: `about-${download.file}` });
  button.setAttribute('aria-describedby', about.id);
  button.addEventListener('click', () => attempt(trouble, () => save(download, said), button));
  item.append(button, about);
  return item;
}

/**
 * Waits until the file has been made, and has the browser save it.
 * @param {Download} download
 * @param {HTMLElement} said
 */
async function save({ url, title, file }, said) {
  said.textContent = t('{title} is being made …', { title });
  try {
    await untilMade(url);
    said.textContent = t('{file} is being saved.', { file });
    create('a', { href: url, download: file }).click();
  } catch (error) {
    said.textContent = '';
    throw error;
  }
}

/**
 * Asks for a file until the server knows where it is.
 * @param {string} url
 */
export async function untilMade(url) {
  for (;;) {
    const { response, bytes } = await fetchBytes(url, {
      redirect: 'manual',
      cache: 'no-store',
      silenceMs: DOWNLOAD_ANSWER_MS,
    });
    if (response.type === 'opaqueredirect') return;
    if (response.status !== 202) {
      parseAnswer(response.status, new TextDecoder().decode(bytes));
      return;
    }
    await new Promise((resolve) => setTimeout(resolve, 1000 * Number(response.headers.get('Retry-After') ?? 2)));
  }
}
