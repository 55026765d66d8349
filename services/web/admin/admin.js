// The operator's page (/admin): the state of the service, anew every ten seconds; tenants, keys and changes.
import { fillTable, formatBytes, formatSeconds, formatTime } from './table.js';
import { listenToLimits, showChanges, showKeys, showTenants } from './tenants.js';
import { showAccount } from '../shared/account.js';
import { getJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { formatCount } from '../shared/format.js';
import { sentences, toProblem } from '../shared/problems.js';

/** @import { Service, WorkerState } from '../shared/types.d.ts' */

const PERIOD_MS = 10_000;
const PARTS = /** @type {Record<string, string>} */ ({
  store: 'Store',
  database: 'Database',
  disk: 'Disk space',
  workers: 'Workers',
});

document.body.dataset.started = 'yes';
const page = {
  said: element('said', HTMLElement),
  service: element('service', HTMLElement),
  waiting: element('waiting', HTMLElement),
};
let hasLists = false; // of tenants, keys and changes, which are shown once

/** @param {Service} service */
function show(service) {
  const state = service.ready ? 'ready' : 'not ready';
  page.said.textContent = `Version ${service.version}, ${state}${service.open ? '. Everybody is let in without a key' : ''}.`;
  page.service.hidden = false;
  fillTable(
    'checks',
    Object.entries(service.checks).map(([part, { ok, detail }]) => [
      PARTS[part] ?? part,
      ok ? 'good' : { bad: 'bad' },
      detail,
    ]),
  );
  page.waiting.textContent = service.waiting_s
    ? `The oldest job has waited for ${formatSeconds(service.waiting_s)}.`
    : 'No job waits.';
  fillTable(
    'queue',
    Object.entries(service.jobs).map(([name, count]) => [name.toLowerCase(), { number: formatCount(count) }]),
  );
  fillTable('workers', [...service.workers.map(workerRow), ...service.silent_workers.map(silentRow)]);
  fillTable(
    'disks',
    service.disks.map((disk) => [
      disk.holds,
      { number: formatBytes(disk.free_bytes) },
      { number: formatBytes(disk.total_bytes) },
    ]),
  );
  fillTable(
    'failures',
    service.failures.map((job) => [formatTime(job.at), job.tenant, job.asset_key, job.code, job.detail]),
  );
}

/** @param {WorkerState} worker */
function workerRow(worker) {
  const slots = { number: `${worker.free_slots} of ${worker.slots}` };
  const state = worker.draining ? 'stopping' : 'answers';
  return [
    worker.address,
    worker.compatible ? state : { bad: 'other version' },
    worker.version,
    worker.device,
    slots,
    { number: formatCount(worker.queued) },
  ];
}

/** @param {string} address */
const silentRow = (address) => [address, { bad: 'silent' }, '', '', { number: '' }, { number: '' }];

/** @param {unknown} error */
function showProblem(error) {
  Object.assign(document.body.dataset, { state: 'error', code: toProblem(error).code });
  page.said.textContent = sentences(error);
}

/** Loads the state of the service, and shows it; at the first time with tenants, keys and changes. */
async function refresh() {
  show(await getJson('/v1/service'));
  if (!hasLists) await Promise.all([showTenants(), showKeys(), showChanges()]);
  hasLists = true;
  document.body.dataset.state = 'complete';
  delete document.body.dataset.code;
}

/** Shows everything, anew again and again: also what could not be loaded at first. */
async function keepFresh() {
  await refresh().catch(showProblem);
  setTimeout(keepFresh, PERIOD_MS);
}

listenToLimits();
keepFresh();
showAccount();
