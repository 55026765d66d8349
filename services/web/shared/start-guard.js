// Watches over the page until its own script has started: a module that does not come, or that stops the page with an error, is said in a
// sentence with a button. The gateway puts this text into the page itself, because a file of its own might not come either,
// ahead of the style sheet, which scripts behind it wait for.
(() => {
  const silenceMs = Number(/** @type {HTMLScriptElement} */ (document.currentScript).dataset.silenceMs);
  let timer = setTimeout(fail, silenceMs);
  const watch = new PerformanceObserver(() => {
    clearTimeout(timer); // something has come: the line is slow, not silent
    timer = setTimeout(fail, silenceMs);
  });
  watch.observe({ type: 'resource', buffered: true });
  window.addEventListener('error', onError, true); // capturing: a script that does not come does not bubble

  /** @param {Event} event of a script that did not come, or of an error in a script */
  function onError(event) {
    if (event.target instanceof HTMLScriptElement || event instanceof ErrorEvent) fail();
  }

  /** Whether the style sheets are there: until then a browser draws nothing, though scripts may run. */
  function hasStyle() {
    return [...document.querySelectorAll('link[rel=stylesheet]')].every(
      (link) => /** @type {HTMLLinkElement} */ (link).sheet,
    );
  }

  /**
   * Translates a sentence as texts.js does, which might not come.
   * @param {string} text
   */
  function t(text) {
    return JSON.parse(document.getElementById('texts')?.textContent || '{}')[text] ?? text;
  }

  function fail() {
    clearTimeout(timer);
    watch.disconnect();
    window.removeEventListener('error', onError, true);
    if (document.body?.dataset.started && hasStyle()) return;
    window.stop(); // a style sheet that does not come keeps the browser from drawing anything
    const body = document.body ?? document.documentElement.appendChild(document.createElement('body'));
    Object.assign(body.dataset, { state: 'error', code: 'NOT_STARTED' });
    body.append(panel());
  }

  /** The sentence and the button, over all of the page; with its own style, because the style sheet may be what did not come. */
  function panel() {
    const made = document.createElement('section');
    made.setAttribute('role', 'alert');
    made.style.cssText =
      'position:fixed;inset:0;z-index:9;display:flex;flex-direction:column;gap:1rem;align-items:center;justify-content:center;' +
      'padding:1.5rem;text-align:center;color-scheme:light dark;background:Canvas;color:CanvasText;font:17px/1.45 system-ui,sans-serif';
    const text = document.createElement('p');
    text.textContent = t('This page could not be loaded completely. Check the connection and try again.');
    text.style.cssText = 'margin:0;max-width:24rem';
    const button = document.createElement('button');
    button.textContent = t('Try again');
    button.style.cssText = 'min-height:48px;padding:0 1.2rem;font:inherit;font-weight:600';
    button.addEventListener('click', () => location.reload());
    made.append(text, button);
    return made;
  }
})();
