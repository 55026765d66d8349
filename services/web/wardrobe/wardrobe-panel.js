// The controls of the wardrobe on the page: which garments, the one before and the next one by buttons and arrow keys, and whether they change by themselves.
import { SEASONS } from '../catalogue/garments.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';
import { ofShownTenant } from '../shared/whose.js';

/** @import { Choice, Season } from '../catalogue/garments.js' */

/**
 * What the page and the board in the headset show.
 * @typedef {object} WardrobeState
 * @property {Choice} choice
 * @property {string[]} labels of the collection that name no season
 * @property {number} place from 0, of the garment that is shown or on its way
 * @property {number} count
 * @property {string} said name of the garment, or why there is none
 * @property {boolean} rotates whether the garments change by themselves
 * @property {boolean} turns whether it turns in a headset
 */

/**
 * What a person does with the wardrobe.
 * @typedef {object} WardrobeActions
 * @property {(choice: Choice) => void} onChoose
 * @property {(by: number) => void} onStep 1: the next garment, -1: the one before
 * @property {() => void} onRotate lets the garments change by themselves, or no longer
 * @property {() => void} onTurn lets the dummy turn in a headset, or no longer
 * @property {() => void} onResetView
 */

/** @type {Record<Season, string>} */
const SEASON_NAMES = { spring: t('Spring'), summer: t('Summer'), autumn: t('Autumn'), winter: t('Winter') };
/** @type {Map<string, number>} */
const STEPS = new Map([
  ['ArrowLeft', -1],
  ['ArrowRight', 1],
]);

const panel = {
  whole: element('wardrobe', HTMLElement),
  choice: element('wardrobe-choice', HTMLSelectElement),
  previous: element('wardrobe-previous', HTMLButtonElement),
  next: element('wardrobe-next', HTMLButtonElement),
  count: element('wardrobe-count', HTMLElement),
  rotate: element('wardrobe-rotate', HTMLButtonElement),
  alone: element('wardrobe-alone', HTMLAnchorElement),
  spoken: element('view', HTMLElement),
};

/** @param {Season} season */
export const seasonName = (season) => SEASON_NAMES[season];

/** @param {WardrobeState} state */
export const countText = ({ place, count }) =>
  count > 0 ? t('{number} of {count}', { number: place + 1, count }) : '';

/** The controls of the page. */
export class WardrobePanel {
  #actions;
  #labels = ''; // as the list of choices has them

  /** @param {WardrobeActions} actions */
  constructor(actions) {
    this.#actions = actions;
    panel.whole.hidden = false;
    panel.choice.addEventListener('change', () => actions.onChoose(/** @type {Choice} */ (panel.choice.value)));
    panel.previous.addEventListener('click', () => actions.onStep(-1));
    panel.next.addEventListener('click', () => actions.onStep(1));
    panel.rotate.addEventListener('click', actions.onRotate);
    document.addEventListener('keydown', (event) => this.#step(event), true); // before the camera's keys
    element('keys', HTMLElement).textContent = t(
      'Left and right arrow keys show the garment before and the next one; with Shift they turn it. Drag to turn, pinch or scroll to come closer, plus and minus too. Home shows all of it, T turns it by itself, F fills the screen.',
    );
  }

  /**
   * @param {WardrobeState} state
   * @param {string} key of the garment that is shown or on its way; '' without one
   */
  show(state, key) {
    const { choice, labels, count, rotates } = state;
    this.#fillChoices(choice.startsWith('label:') ? [...labels, choice.slice('label:'.length)] : labels);
    panel.choice.value = choice;
    panel.previous.disabled = panel.next.disabled = count < 2;
    panel.count.textContent = countText(state);
    const spoken = [state.said, countText(state)].filter(Boolean).join(', ');
    if (panel.spoken.textContent !== spoken) panel.spoken.textContent = spoken; // a screen reader would say it again
    panel.rotate.setAttribute('aria-pressed', String(rotates));
    panel.alone.hidden = !key;
    panel.alone.href = ofShownTenant(`/view/${encodeURIComponent(key)}`);
  }

  /** @param {string[]} labels */
  #fillChoices(labels) {
    const each = [...new Set(labels)];
    if (this.#labels === JSON.stringify(each)) return; // a list that is open in the browser would close
    this.#labels = JSON.stringify(each);
    const group = create('optgroup', { label: t('Tags') });
    group.append(...each.map((label) => create('option', { value: `label:${label}`, textContent: label })));
    const seasons = SEASONS.map((season) => create('option', { value: season, textContent: seasonName(season) }));
    panel.choice.replaceChildren(
      ...seasons,
      create('option', { value: 'all', textContent: t('All garments') }),
      ...(each.length > 0 ? [group] : []),
    );
  }

  /** @param {KeyboardEvent} event */
  #step(event) {
    const by = STEPS.get(event.key);
    const isField = event.target instanceof HTMLElement && event.target.matches('input, select, textarea');
    if (!by || isField || event.altKey || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    event.stopPropagation();
    this.#actions.onStep(by);
  }
}
