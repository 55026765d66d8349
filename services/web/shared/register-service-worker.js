// The service worker, and what it keeps of the very first visit, of which it saw nothing because it came later.

const SETTLED_MS = 1500; // by then what the page needs to begin with has been asked for

export async function keepShell() {
  if (!navigator.serviceWorker) return;
  const first = !navigator.serviceWorker.controller;
  try {
    await navigator.serviceWorker.register('/web/shared/service-worker.js', { scope: '/' });
    const { active } = await navigator.serviceWorker.ready;
    if (!first) return;
    await new Promise((resolve) => setTimeout(resolve, SETTLED_MS));
    const loaded = performance.getEntriesByType('resource').map(({ name }) => name);
    active.postMessage({ keep: [location.href, ...new Set(loaded)] });
  } catch {
    // A private window does without.
  }
}
