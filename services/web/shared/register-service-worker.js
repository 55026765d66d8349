// Registers the service worker, which caches the pages and their modules for visits without the server.

/**
 * Register the service worker. No part of a page waits for it: a browser may take as long as it likes to start it, or never do so.
 * `data-offline="ready"` on the body says that the pages are cached.
 */
export async function registerServiceWorker() {
  try {
    await navigator.serviceWorker.register('/web/shared/service-worker.js', { scope: '/', type: 'module' });
    await navigator.serviceWorker.ready;
    document.body.dataset.offline = 'ready';
  } catch {
    // Private windows, plain http, and browsers without modules in service workers: the pages need the server at every visit.
    document.body.dataset.offline = 'unavailable';
  }
}
