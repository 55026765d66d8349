// Tenants with what they use, their limits, access keys, and the audit log, on the operator's page.
import { addRows, fillTable, formatBytes, formatTime } from './table.js';
import { getJson, postJson, putJson } from '../shared/api.js';
import { attempt } from '../shared/attempt.js';
import { create, element } from '../shared/dom.js';
import { formatCount } from '../shared/format.js';
import { onSecondPress } from '../shared/second-press.js';

/** @import { AccessKey, AuditRecord, Limits, Tenant, Usage } from '../shared/types.d.ts' */
/** @import { Cell } from './table.js' */

const PAGE = 20;
const LIMIT_NAMES = /** @type {const} */ ({
  requests_per_minute: 'requests a minute',
  uploads_at_once: 'uploads at once',
  jobs_at_once: 'jobs at once',
  jobs_per_day: 'jobs a day',
  stored_bytes: 'stored',
  capture_bytes: 'a capture',
});

/**
 * Shows the first page of a list, and a button for the next one while there is one.
 * @template T
 * @param {string} table
 * @param {string} button
 * @param {(after: string) => Promise<{ rows: T[], next: string | null }>} load
 * @param {(row: T) => Cell[]} cells
 */
async function showPages(table, button, load, cells) {
  const more = element(button, HTMLButtonElement);
  const trouble = element(`${table}-trouble`, HTMLElement);
  const { rows, next } = await load('');
  fillTable(table, rows.map(cells));
  let after = next;
  more.hidden = after === null;
  more.onclick = () =>
    attempt(
      trouble,
      async () => {
        const page = await load(after ?? '');
        addRows(table, page.rows.map(cells));
        after = page.next;
        more.hidden = after === null;
      },
      more,
    );
}

/** Shows tenants with what they use, and lets their limits be set. */
export async function showTenants() {
  await showPages('tenants', 'more-tenants', loadTenants, ({ tenant, usage }) => [
    tenant.name,
    tenant.label,
    { number: formatCount(usage.jobs) },
    { number: formatCount(usage.jobs_today) },
    { number: formatBytes(usage.stored_bytes) },
    describeLimits(usage.limits),
  ]);
}

/** @param {string} after */
async function loadTenants(after) {
  /** @type {{ tenants: Tenant[], next: string | null }} */
  const { tenants, next } = await getJson(`/v1/tenants?limit=${PAGE}&after=${after}`);
  /** @type {Usage[]} */
  const usages = await Promise.all(tenants.map(({ name }) => getJson(`/v1/tenants/${name}/usage`)));
  const choice = element('limited', HTMLSelectElement);
  const known = new Set(Array.from(choice.options, ({ value }) => value));
  choice.append(...tenants.filter(({ name }) => !known.has(name)).map(({ name }) => new Option(name)));
  if (!known.size) fillLimits(usages[0]);
  return { rows: tenants.map((tenant, index) => ({ tenant, usage: /** @type {Usage} */ (usages[index]) })), next };
}

/** @param {Limits} limits */
function describeLimits(limits) {
  const names = /** @type {(keyof Limits)[]} */ (Object.keys(LIMIT_NAMES));
  const set = names.filter((name) => limits[name]);
  const figure = (/** @type {keyof Limits} */ name) =>
    name.endsWith('_bytes') ? formatBytes(limits[name]) : formatCount(limits[name]);
  return set.map((name) => `${figure(name)} ${LIMIT_NAMES[name]}`).join(', ') || 'none';
}

/**
 * Shows a tenant's own limits in the form. What is sent takes the place of all of them, so nothing can be typed before they are there.
 * @param {Usage | undefined} usage none while it is loaded
 */
function fillLimits(usage) {
  const form = element('limits', HTMLFormElement);
  form.dataset.tenant = usage?.tenant ?? '';
  for (const field of form.querySelectorAll('input')) {
    const name = /** @type {keyof Limits} */ (field.name);
    field.value = usage?.own_limits[name]?.toString() ?? '';
    field.disabled = !usage;
  }
}

async function loadLimits() {
  const choice = element('limited', HTMLSelectElement);
  fillLimits(undefined);
  /** @type {Usage} */
  const usage = await getJson(`/v1/tenants/${choice.value}/usage`);
  if (usage.tenant === choice.value) fillLimits(usage);
}

/** Lets the limits of a tenant be set, as the form has them. */
export function listenToLimits() {
  const [form, choice] = [element('limits', HTMLFormElement), element('limited', HTMLSelectElement)];
  const trouble = element('limits-trouble', HTMLElement);
  choice.addEventListener('change', () => attempt(trouble, loadLimits));
  form.addEventListener('submit', (event) => {
    event.preventDefault();
    const isLoaded = form.dataset.tenant === choice.value; // else the network failed: it is tried again
    attempt(trouble, () => (isLoaded ? setLimits(form) : loadLimits()), form);
  });
}

/** @param {HTMLFormElement} form */
async function setLimits(form) {
  const said = element('limits-said', HTMLElement);
  said.textContent = '';
  const filled = Array.from(new FormData(form)).filter(([, value]) => value !== '');
  const body = Object.fromEntries(filled.map(([name, value]) => [name, Number(value)]));
  const tenant = element('limited', HTMLSelectElement).value;
  /** @type {Limits} */
  const limits = await putJson(`/v1/tenants/${tenant}/limits`, body);
  const row = Array.from(element('tenants', HTMLTableElement).rows).find(
    ({ cells }) => cells[0].textContent === tenant,
  );
  if (row) row.cells[row.cells.length - 1].textContent = describeLimits(limits);
  said.textContent = `The limits of ${tenant}: ${describeLimits(limits)}.`;
}

/** Shows the access keys of all tenants, with a button that revokes each. */
export async function showKeys() {
  await showPages('keys', 'more-keys', loadKeys, (key) => [
    key.tenant,
    key.label || key.id,
    key.scopes.join(', '),
    formatTime(key.last_used),
    key.expires ? formatTime(key.expires) : 'no end',
    key.revoked ? { bad: `revoked ${formatTime(key.revoked)}` } : createRevoke(key),
  ]);
}

/** @param {string} after */
async function loadKeys(after) {
  /** @type {{ keys: AccessKey[], next: string | null }} */
  const { keys, next } = await getJson(`/v1/api-keys?tenant=*&limit=${PAGE}&after=${after}`);
  return { rows: keys, next };
}

/**
 * A button that revokes a key when it is pressed twice: the first press asks.
 * @param {AccessKey} key
 */
function createRevoke(key) {
  const button = create('button', { type: 'button', className: 'link', textContent: 'Revoke' });
  onSecondPress(button, 'Revoke for good?', () =>
    attempt(element('keys-trouble', HTMLElement), () => revoke(key, button), button),
  );
  return button;
}

/**
 * Revokes a key, and says so in the place of its button: the list stays as far as it was opened.
 * @param {AccessKey} key
 * @param {HTMLButtonElement} button
 */
async function revoke({ id }, button) {
  /** @type {AccessKey} */
  const { revoked } = await postJson(`/v1/api-keys/${id}/revoke`, {});
  const cell = button.parentElement;
  if (cell) {
    Object.assign(cell, { className: 'bad', textContent: `revoked ${formatTime(revoked)}`, tabIndex: -1 }).focus();
  }
}

/** Shows who changed what, the newest first. */
export async function showChanges() {
  await showPages('audit', 'more-changes', loadChanges, (row) => [
    formatTime(row.at),
    row.tenant,
    row.key || row.via,
    row.address,
    `${row.method} ${row.path}`,
    row.status < 400 ? { number: String(row.status) } : { bad: String(row.status) },
  ]);
}

/** @param {string} before */
async function loadChanges(before) {
  /** @type {{ records: AuditRecord[], next: number | null }} */
  const { records, next } = await getJson(`/v1/audit?tenant=*&limit=${PAGE}&before=${before || 0}`);
  return { rows: records, next: next === null ? null : String(next) };
}
