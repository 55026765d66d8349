// Runs the job again on the stored capture, without an upload: with the other cut, or with the answer to a question that it left open.
import { showTrouble } from './page-state.js';
import { postJson } from '../shared/api.js';
import { create, element } from '../shared/dom.js';
import { stored } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';

/** @import { CaptureSummary, Cut, Job, Question, SentenceCode } from '../shared/types.d.ts' */

/** @typedef {{ taken: Record<string, number>, numbers: number[], rows: string[][] }} TableHead numbers from 1 */

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
const BESIDE = [['r', 'g', 'b'], ['nx', 'ny', 'nz'], ['i']];

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
function questionBox(job, { text, text_i18n, answers }) {
  const box = create('div', {});
  box.append(create('p', { textContent: text }));
  for (const answer of answers) {
    const button = create('button', { type: 'button', textContent: answer.text });
    if (answer.options.columns === '') box.append(...columnsPicker(job, button, tableOf(text_i18n)));
    else button.addEventListener('click', () => repeatJob(job, answer.options, button));
    box.append(button);
  }
  return box;
}

/**
 * The first rows of the table that a question is about, and what each column was taken for; empty where it tells none.
 * @param {SentenceCode} [coded]
 * @returns {TableHead}
 */
function tableOf(coded) {
  const { columns = '', numbers = [], rows = [] } = coded?.values ?? {};
  const pairs = String(columns).split(',').filter(Boolean);
  return {
    taken: Object.fromEntries(pairs.map((pair) => [pair.split('=')[0], Number(pair.split('=')[1])])),
    numbers: Array.isArray(numbers) ? numbers.map(Number) : [],
    rows: Array.isArray(rows) ? rows.filter(Array.isArray).map((row) => row.map(String)) : [],
  };
}

/**
 * The table's first rows, and three numbers of columns, which the button sends. What they say is marked in the rows.
 * @param {Job} job
 * @param {HTMLButtonElement} button
 * @param {TableHead} table
 */
function columnsPicker(job, button, table) {
  const fields = AXES.map((axis, place) =>
    create('input', {
      type: 'number',
      min: '1',
      max: '9999',
      required: true,
      value: String(table.taken[axis] ?? place + 2),
    }),
  );
  const shown = create('div', { className: 'table-head', tabIndex: 0, role: 'region' });
  shown.ariaLabel = t('The first rows of the table');
  const chosen = () => columnsOf(fields, table.taken);
  const show = () => shown.replaceChildren(tableHead(table, chosen()));
  button.addEventListener('click', () => {
    const columns = Object.entries(chosen()).map(([name, number]) => `${name}=${number}`);
    if (fields.every((field) => field.reportValidity())) repeatJob(job, { columns: columns.join(',') }, button);
  });
  const picker = create('div', { className: 'columns' });
  fields.forEach((field, place) => {
    const label = create('label', { textContent: t('Column of {axis}', { axis: AXES[place] }) });
    label.append(field);
    picker.append(label);
    field.addEventListener('input', show);
  });
  show();
  return table.rows.length ? [shown, picker] : [picker];
}

/**
 * The columns by what they are: those of the fields, and colours, normals and intensity as taken where no field has them.
 * @param {HTMLInputElement[]} fields
 * @param {Record<string, number>} taken
 * @returns {Record<string, number>}
 */
function columnsOf(fields, taken) {
  const numbers = fields.map((field) => Number(field.value));
  const others = BESIDE.filter((names) => names.every((name) => name in taken && !numbers.includes(taken[name])));
  return Object.fromEntries([
    ...AXES.map((axis, place) => [axis, numbers[place]]),
    ...others.flat().map((name) => [name, taken[name]]),
  ]);
}

/**
 * @param {TableHead} table
 * @param {Record<string, number>} columns
 */
function tableHead({ numbers, rows }, columns) {
  const names = numbers.map((number) => Object.keys(columns).filter((name) => columns[name] === number));
  const head = create('tr');
  numbers.forEach((number, place) => {
    const cell = marked(create('th', { scope: 'col', textContent: String(number) }), names[place]);
    cell.append(create('b', { textContent: names[place].join(' ') }));
    head.append(cell);
  });
  const body = rows.map((row) => {
    const line = create('tr');
    line.append(...row.map((cell, place) => marked(create('td', { textContent: cell }), names[place] ?? [])));
    return line;
  });
  const table = create('table');
  table.append(head, ...body);
  return table;
}

/**
 * @template {HTMLElement} E
 * @param {E} cell
 * @param {string[]} names of what its column is
 */
function marked(cell, names) {
  if (names.length) cell.dataset.is = names[0];
  return cell;
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
