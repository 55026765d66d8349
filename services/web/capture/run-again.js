// Runs the job again on the stored capture, without an upload: with the other cut, or with the answer to a question that it left open.
import { showTrouble } from './page-state.js';
import { postJson } from '../shared/api.js';
import { create, element } from '../shared/dom.js';
import { stored } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';

/** @import { CaptureSummary, Cut, Job, Question } from '../shared/types.d.ts' */

const page = {
  section: element('other-cut', HTMLElement),
  kept: element('kept', HTMLElement),
  button: element('recut', HTMLButtonElement),
  questions: element('questions', HTMLElement),
};

/** @type {{ kept: string, name: string, other: Cut, offer: string }[]} */
const CUTS = [
  { kept: 'object', name: t('the object in the middle'), other: 'scene', offer: t('Keep everything that was seen') },
  {
    kept: 'scene',
    name: t('everything that was seen'),
    other: 'object',
    offer: t('Keep only the object in the middle'),
  },
];

const AXES = ['x', 'y', 'z'];

/** @type {() => void} */
let recut = () => {};

/**
 * Shows what was kept of a job's capture, with a button for the other choice; nothing where there was no choice.
 * @param {Job} job
 * @param {CaptureSummary | undefined} capture
 */
export function showCut(job, capture) {
  const cut = capture?.cut;
  const choice = CUTS.find(({ kept }) => kept === cut?.kept);
  page.section.hidden = !cut || !choice;
  if (!cut || !choice) return;
  page.kept.textContent = t('What was kept: {what}; {because}.', {
    what: choice.name,
    because: stored(cut.because, cut.because_i18n),
  }); // a doubt stands among the warnings
  page.button.textContent = choice.offer;
  recut = () => repeatJob(job, { cut: choice.other }, page.button);
}

/**
 * Shows a job's questions, each with a button for every answer.
 * @param {Job} job
 */
export function showQuestions(job) {
  const { questions = [] } = job; // a gateway of an earlier version asks none
  page.questions.hidden = !questions.length;
  page.questions.replaceChildren(...questions.map((question) => questionBox(job, question)));
}

/**
 * @param {Job} job
 * @param {Question} question
 */
function questionBox(job, { text, answers }) {
  const box = create('div', {});
  box.append(create('p', { textContent: text }));
  for (const answer of answers) {
    const button = create('button', { type: 'button', textContent: answer.text });
    if (answer.options.columns === '') box.append(columnsPicker(job, button));
    else button.addEventListener('click', () => repeatJob(job, answer.options, button));
    box.append(button);
  }
  return box;
}

/**
 * Three numbers of columns, which the button sends.
 * @param {Job} job
 * @param {HTMLButtonElement} button
 */
function columnsPicker(job, button) {
  const fields = AXES.map((_, number) =>
    create('input', { type: 'number', min: '1', max: '9999', required: true, value: String(number + 2) }),
  );
  button.addEventListener('click', () => {
    const columns = AXES.map((axis, number) => `${axis}=${fields[number].value}`).join(',');
    if (fields.every((field) => field.reportValidity())) repeatJob(job, { columns }, button);
  });
  const picker = create('div');
  fields.forEach((field, number) => {
    const label = create('label', { textContent: t('Column of {axis}', { axis: AXES[number] }) });
    label.append(field);
    picker.append(label);
  });
  return picker;
}

/**
 * Starts a job again with other options, and watches it.
 * @param {Job} job
 * @param {Record<string, string>} options
 * @param {HTMLButtonElement} button
 */
async function repeatJob(job, options, button) {
  button.disabled = true; // one tap, one job; so does the key
  try {
    const key = `${job.id}-${Object.values(options).join('-')}`.replace(/[^\w-]/g, '-');
    /** @type {Job} */
    const again = await postJson(job.links.again, options, { 'Idempotency-Key': key });
    location.hash = `job=${again.id}`;
    location.reload();
  } catch (error) {
    button.disabled = false;
    showTrouble(error);
  }
}

page.button.addEventListener('click', () => recut());
