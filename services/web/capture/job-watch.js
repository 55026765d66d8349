// Watches a job until it has ended, and shows its progress, its result, or why it failed.
import { showJobProgress, showProgressNote, startJobProgress } from '../shared/job-progress.js';
import { showState, showTrouble } from './page-state.js';
import { FINAL, hideAnchors, showAnchors, showResult } from './result.js';
import { showQuestions } from './run-again.js';
import { followJob, getJson, postJson } from '../shared/api.js';
import { element, fillList } from '../shared/dom.js';
import { otherWarnings } from '../shared/grade.js';
import { Problem, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Job } from '../shared/types.d.ts' */

const page = {
  work: element('work', HTMLElement),
  lost: element('lost', HTMLElement),
  cancel: element('cancel', HTMLButtonElement),
  coming: element('coming', HTMLElement),
  warnings: element('warnings', HTMLElement),
};

/**
 * Shows a job and follows it until it has ended.
 * @param {Job} job as it is now
 */
export function watchJob(job) {
  const address = `/v1/jobs/${job.id}`;
  let ended = FINAL.includes(job.state);
  /** @type {Promise<void>} */
  let queue = Promise.resolve(); // one request after the other, so that an older answer never comes last
  startJobProgress();
  showState('working');
  page.cancel.addEventListener('click', () => cancelJob(address));
  showJob(job);
  if (ended) return;
  const stop = followJob(job.id, {
    onProgress(progress) {
      page.lost.hidden = true;
      showJobProgress(progress);
    },
    onAnchors: showAnchors,
    onChange() {
      page.lost.hidden = true;
      queue = queue.then(reload);
    },
    onLost() {
      page.lost.hidden = false; // the job goes on without this page, which connects again by itself
    },
  });

  async function reload() {
    if (ended) return;
    /** @type {Job | null} */
    const now = await getJson(address).catch(() => null); // offline: asked again once the stream is open again
    if (!now) return;
    showJob(now);
    ended = FINAL.includes(now.state);
    if (ended) stop();
  }
}

/** @param {Job} job */
function showJob(job) {
  const final = FINAL.includes(job.state);
  document.body.dataset.job = job.state;
  showJobProgress(job);
  page.cancel.hidden = final || job.state === 'CANCELLING';
  page.coming.hidden = final || Boolean(job.asset);
  const published = job.asset ?? job.preview;
  if (published) showResult(job, published);
  else if (final) hideAnchors();
  if (job.state === 'FAILED') showTrouble(new Problem(job.error ?? {}));
  if (job.state === 'CANCELLED') showTrouble(cancelled(job));
  if (job.state === 'SUCCEEDED') showSuccess(job);
}

/** @param {Job} job */
function cancelled({ preview }) {
  const hints = preview ? [t('Its preview stays.')] : [];
  return new Problem({ code: 'CANCELLED', detail: t('The job was cancelled.'), hints });
}

/** @param {Job} job */
function showSuccess(job) {
  const { asset, questions = [], warnings } = job;
  const asked = questions.map(({ text }) => text);
  page.work.hidden = true;
  fillList(
    page.warnings,
    otherWarnings(warnings, asset?.grade).filter((each) => !asked.includes(each)),
  );
  showQuestions(job);
  document.body.dataset.state = 'done';
}

/**
 * Asks the server to cancel the job. When that fails the job goes on, and so does the watching.
 * @param {string} address of the job
 */
async function cancelJob(address) {
  page.cancel.disabled = true;
  try {
    await postJson(`${address}/cancel`, {});
  } catch (error) {
    showProgressNote(toProblem(error).message);
  }
  page.cancel.disabled = false;
}
