// Runs the stored capture again with a recipe, and follows the job until it has ended.
import { followJob, getJson, postJson } from '../shared/api.js';
import { element } from '../shared/dom.js';
import { showJobProgress, showProgressNote, startJobProgress } from '../shared/job-progress.js';
import { Problem, toProblem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Edits, Job, JobState } from '../shared/types.d.ts' */

/** @type {JobState[]} */
const FINAL = ['SUCCEEDED', 'FAILED', 'CANCELLED'];

const page = {
  tools: element('tools', HTMLElement),
  work: element('work', HTMLElement),
  lost: element('lost', HTMLElement),
  cancel: element('cancel', HTMLButtonElement),
};

/** The recipe whose order has no answer yet, and the order's key: sent again, as after a lost connection, it starts no second job. */
let unanswered = { recipe: '', key: '' };

/** @type {() => void} */
let cancel = () => {};
page.cancel.addEventListener('click', () => cancel());

/**
 * Starts a job like an earlier one with other edits, shows its progress in place of the tools, and waits for its end.
 * @param {Job} job the earlier one
 * @param {Edits} edits
 * @returns {Promise<Job>} the job when it has succeeded
 * @throws {Problem} why it could not be started, or has failed
 */
export async function runEdited(job, edits) {
  const recipe = `${job.id} ${JSON.stringify(edits)}`;
  if (unanswered.recipe !== recipe) unanswered = { recipe, key: crypto.randomUUID?.() ?? `${job.id}-${Date.now()}` };
  /** @type {Job} */
  const again = await postJson(job.links.again, { edits }, { 'Idempotency-Key': unanswered.key });
  unanswered = { recipe: '', key: '' };
  page.tools.hidden = true;
  page.work.hidden = false;
  startJobProgress();
  cancel = () => cancelJob(again.id);
  try {
    const ended = await end(again);
    if (ended.state === 'SUCCEEDED') return ended;
    throw new Problem(
      ended.error ?? {
        code: 'CANCELLED',
        detail: t('The job was cancelled.'),
        hints: [t('Your edits are still here.')],
      },
    );
  } finally {
    page.tools.hidden = false;
    page.work.hidden = true;
  }
}

/**
 * Follows a job to its end.
 * @param {Job} job
 * @returns {Promise<Job>}
 */
function end(job) {
  const address = `/v1/jobs/${job.id}`;
  return new Promise((resolve) => {
    let queue = Promise.resolve(); // one request after the other, so that an older answer never comes last
    const stop = followJob(job.id, {
      onProgress(progress) {
        page.lost.hidden = true;
        showJobProgress(progress);
      },
      onAnchors() {},
      onChange() {
        page.lost.hidden = true;
        queue = queue.then(async () => {
          /** @type {Job | null} */
          const now = await getJson(address).catch(() => null); // offline: asked again once the stream is open again
          if (!now || !FINAL.includes(now.state)) return;
          stop();
          resolve(now);
        });
      },
      onLost() {
        page.lost.hidden = false;
      },
    });
  });
}

/** @param {string} id of the job */
async function cancelJob(id) {
  page.cancel.disabled = true;
  try {
    await postJson(`/v1/jobs/${id}/cancel`, {});
  } catch (error) {
    showProgressNote(toProblem(error).message);
  }
  page.cancel.disabled = false;
}
