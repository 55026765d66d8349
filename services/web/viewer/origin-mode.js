// The button that colours what is shown by where it comes from, and the legend beside it. It is there where not all was measured.
import { ORIGIN_COLOURS, hasOrigins, showOrigins } from '../graphics/origin-look.js';
import { create, element } from '../shared/dom.js';
import { t } from '../shared/texts.js';

/** @import { LoadedItem } from '../scenes/scene-item.js' */

const NAMES = [t('measured'), t('a guess'), t('filled in')];

/**
 * Lets the button show and hide it.
 * @param {() => LoadedItem[]} items that are shown
 * @param {() => void} onChange
 * @returns {() => void} to be called when other items are shown, or other levels of them
 */
export function startOriginMode(items, onChange) {
  const button = element('origin', HTMLButtonElement);
  const legend = element('origin-legend', HTMLUListElement);
  legend.append(
    ...NAMES.map((name, number) => {
      const sample = create('span', { className: 'sample' });
      sample.style.background = ORIGIN_COLOURS[number];
      const line = create('li');
      line.append(sample, ` ${name}`);
      return line;
    }),
  );

  /** @param {boolean} wanted */
  function set(wanted) {
    showOrigins(wanted);
    button.setAttribute('aria-pressed', String(wanted));
    legend.hidden = !wanted;
    onChange();
  }

  button.addEventListener('click', () => set(legend.hidden));
  return () => {
    button.hidden = !items().some(({ model }) => hasOrigins(model.object));
    if (button.hidden && !legend.hidden) set(false);
  };
}
