// The service worker: pages, modules and catalogue entries as they were last, for when the server cannot be reached.
// The network comes first, so that nobody sees an old version while there is a new one; modules that name their version
// come from the device. Files of assets are not its business: vault.js keeps them by their hash.
const NAME = 'shell-1';
const VERSIONED = /-\d+\.\d+\.\d+\./;
const ENTRY = /^\/v1\/(assets\/[^/]+|collections\/[^/]+|keys)$/;
const MANIFEST = /\/manifest\.[0-9a-f]{64}\.json$/;

self.addEventListener('install', () => self.skipWaiting());
self.addEventListener('activate', (event) => event.waitUntil(self.clients.claim()));

self.addEventListener('fetch', (event) => {
  const { request } = event;
  const url = new URL(request.url);
  if (request.method !== 'GET' || url.origin !== self.location.origin) return;
  if (MANIFEST.test(url.pathname) || (url.pathname.startsWith('/web/') && VERSIONED.test(url.pathname))) {
    event.respondWith(keptFirst(request));
  } else if (url.pathname.startsWith('/web/') || url.pathname.startsWith('/view/') || ENTRY.test(url.pathname)) {
    event.respondWith(networkFirst(request));
  }
});

async function keptFirst(request) {
  const shell = await caches.open(NAME);
  return (await shell.match(request.url)) || fetchedAndKept(shell, request);
}

async function networkFirst(request) {
  const shell = await caches.open(NAME);
  try {
    return await fetchedAndKept(shell, request);
  } catch (offline) {
    const kept = await shell.match(request.url);
    if (kept) return kept;
    throw offline;
  }
}

async function fetchedAndKept(shell, request) {
  const answer = await fetch(request);
  if (answer.ok) await shell.put(request.url, answer.clone()).catch(() => {}); // a full device answers all the same
  return answer;
}
