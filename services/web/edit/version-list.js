// The list of versions: edit from one, compare it with the one that is shown, restore it, download it for another program.
import { loadDownloads } from '../catalogue/download-list.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { stateText } from '../shared/format.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, VersionRecord } from '../shared/types.d.ts' */

/**
 * @typedef {object} VersionCallbacks
 * @property {VersionAction} onShow
 * @property {VersionAction} onCompare
 * @property {VersionAction} onRestore
 */

/** @typedef {(version: number, pressed: HTMLButtonElement) => void} VersionAction */

/**
 * Shows the versions, the newest first.
 * @param {AssetEntry} entry
 * @param {number} shown the version that is edited
 * @param {boolean} manages whether this person may restore one
 * @param {VersionCallbacks} callbacks
 */
export function showVersions(
  { key, version: newest, versions = [] },
  shown,
  manages,
  { onShow, onCompare, onRestore },
) {
  const rows = [...versions].reverse().map((record) => {
    const row = create('li');
    row.append(create('span', { textContent: describe(record, newest) }));
    const { version } = record;
    if (version === shown) row.ariaCurrent = 'true';
    else row.append(button(t('Edit from it'), version, onShow), button(t('Compare'), version, onCompare));
    const action = record.held ? t('Keep it anyway') : t('Restore');
    if ((version !== newest || record.held) && manages) row.append(button(action, version, onRestore));
    row.append(createDownloads(key, version));
    return row;
  });
  element('versions', HTMLUListElement).replaceChildren(...rows);
}

/**
 * Creates what opens into the formats of a version; they are asked for then.
 * @param {string} key
 * @param {number} version
 */
function createDownloads(key, version) {
  const places = { said: element('download-said', HTMLElement), trouble: element('trouble', HTMLElement) };
  const action = t('Download');
  const list = create('ul', { className: 'formats', role: 'list', ariaLabel: t('Formats for other programs') });
  const part = create('details');
  part.append(
    create('summary', {
      className: 'button',
      textContent: action,
      ariaLabel: t('{action}: version {version}', { action, version }),
    }),
    list,
  );
  const fill = async () => {
    const entries = await loadDownloads(`/v1/assets/${encodeURIComponent(key)}/downloads?version=${version}`, places);
    list.replaceChildren(...entries.map(({ item }) => item));
  };
  part.addEventListener('toggle', () => part.open && !list.children.length && attempt(places.trouble, fill));
  return part;
}

/**
 * @param {VersionRecord} record
 * @param {number} newest
 */
function describe({ version, state, created, restored, held }, newest) {
  const when = new Date(created).toLocaleString(undefined, { dateStyle: 'medium', timeStyle: 'short' });
  const what = restored ? t('version {version} restored', { version: restored }) : stateText(state);
  if (held) return t('Version {version}, held back: {what}, {when}', { version, what, when });
  return version === newest
    ? t('Version {version}, the newest: {what}, {when}', { version, what, when })
    : t('Version {version}: {what}, {when}', { version, what, when });
}

/**
 * @param {string} text
 * @param {number} version
 * @param {VersionAction} onClick
 */
function button(text, version, onClick) {
  const made = create('button', {
    type: 'button',
    textContent: text,
    ariaLabel: t('{action}: version {version}', { action: text, version }),
  });
  made.addEventListener('click', () => onClick(version, made));
  return made;
}
