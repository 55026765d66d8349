// The panel of the viewer's page for who manages a thing: who may see it, and its share links with QR codes, to be revoked.
import { deleteAt, getJson, postJson, putJson } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, Share, SharePage } from '../shared/types.d.ts' */

const panel = {
  visibility: element('visibility', HTMLSelectElement),
  form: element('share-form', HTMLFormElement),
  mode: element('share-mode', HTMLSelectElement),
  days: element('share-days', HTMLSelectElement),
  password: element('share-password', HTMLInputElement),
  links: element('links', HTMLElement),
  trouble: element('share-trouble', HTMLElement),
  ofAsset: element('share-asset', HTMLElement),
};

/** @typedef {{ asset: string } | { scene: string }} SharedThing what a link opens */

/**
 * Shows the panel's content for a scene of one's own, which only its links open to others.
 * @param {string} scene its id
 * @throws {Problem} as `getJson`
 */
export async function showSharingOfScene(scene) {
  panel.ofAsset.hidden = true;
  await showLinks({ scene });
  listen({ scene });
}

/**
 * Shows the panel's content for an asset of one's own.
 * @param {string} key
 * @throws {Problem} as `getJson`
 */
export async function showSharing(key) {
  const path = `/v1/assets/${encodeURIComponent(key)}`;
  /** @type {AssetEntry} */
  const { visibility } = await getJson(path);
  panel.visibility.value = visibility ?? '';
  await showLinks({ asset: key });
  panel.visibility.addEventListener('change', () =>
    attempt(panel.trouble, () => putJson(`${path}/visibility`, { visibility: panel.visibility.value || null })),
  );
  listen({ asset: key });
}

/** @param {SharedThing} thing */
function listen(thing) {
  panel.form.addEventListener('submit', (event) => {
    event.preventDefault();
    attempt(panel.trouble, () => createLink(thing), panel.form);
  });
}

/** @param {SharedThing} thing */
async function createLink(thing) {
  const days = Number(panel.days.value);
  const body = { ...thing, mode: panel.mode.value, expires_days: days || null, password: panel.password.value };
  await postJson('/v1/shares', body);
  panel.password.value = '';
  await showLinks(thing);
}

/**
 * Lists the links that work, the newest first.
 * @param {SharedThing} thing
 */
async function showLinks(thing) {
  /** @type {Share[]} */
  const shares = [];
  for (let after = /** @type {string | null} */ (''); after !== null;) {
    /** @type {SharePage} */
    const found = await getJson(`/v1/shares?${new URLSearchParams({ ...thing, limit: '200', after })}`);
    shares.push(...found.shares.filter(({ ended }) => !ended));
    after = found.next;
  }
  panel.links.replaceChildren(...shares.reverse().map((share) => createItem(share, thing)));
  document.body.dataset.links = String(shares.length);
}

/**
 * @param {Share} share
 * @param {SharedThing} thing
 */
function createItem(share, thing) {
  const item = create('li');
  const code = create('img', {
    alt: t('QR code of the link'),
    width: 180,
    height: 180,
    src: `/v1/shares/${share.id}/qr.svg`,
  });
  const link = create('a', { href: share.url, textContent: share.url });
  const facts = create('p', { className: 'quiet', textContent: factsOf(share) });
  const revoke = create('button', { type: 'button', textContent: t('Revoke') });
  revoke.addEventListener('click', () =>
    attempt(
      panel.trouble,
      async () => {
        await deleteAt(`/v1/shares/${share.id}`);
        await showLinks(thing);
      },
      revoke,
    ),
  );
  item.append(code, link, facts, revoke);
  return item;
}

/** @param {Share} share */
function factsOf({ mode, expires, has_password: hasPassword, opened }) {
  const end = expires ? t('until {date}', { date: new Date(expires).toLocaleDateString() }) : t('until it is revoked');
  const may = mode === 'place' ? t('look and move') : t('look');
  return [
    may,
    end,
    hasPassword ? t('with a password') : '',
    opened === 1 ? t('opened 1 time') : t('opened {count} times', { count: opened }),
  ]
    .filter(Boolean)
    .join(' · ');
}
