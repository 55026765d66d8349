// The tabs of the tools: one panel is shown; arrow keys go from tab to tab.
import { element } from '../shared/dom.js';

/**
 * Lets the tabs choose among their panels.
 * @param {(name: string) => void} onChange is called with "box", "planes", ...
 */
export function startTabs(onChange) {
  const tabs = [...document.querySelectorAll('[role=tab]')].filter((tab) => tab instanceof HTMLButtonElement);

  /** @param {HTMLButtonElement} chosen */
  function choose(chosen) {
    for (const tab of tabs) {
      tab.setAttribute('aria-selected', String(tab === chosen));
      tab.tabIndex = tab === chosen ? 0 : -1;
      element(tab.getAttribute('aria-controls') ?? '', HTMLElement).hidden = tab !== chosen;
    }
    onChange(chosen.id.replace('tab-', ''));
  }

  tabs.forEach((tab, place) => {
    tab.addEventListener('click', () => choose(tab));
    tab.addEventListener('keydown', ({ key }) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[key];
      if (!step) return;
      const next = tabs[(place + step + tabs.length) % tabs.length];
      next.focus();
      choose(next);
    });
  });
}
