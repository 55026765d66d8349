// The service worker: pages, modules and catalogue entries as they were last, for when the server cannot be reached.
// The network comes first, so that nobody sees an old version while there is a new one; modules that name their version
// come from the device. Files of assets are not its business: verified-cache.js keeps them by their hash.
const NAME = 'shell-1';
const VERSIONED = /-\d+\.\d+\.\d+\./;
const ENTRY = /^\/v1\/(assets\/[^/]+|collections\/[^/]+|keys)$/;
const MANIFEST = /\/manifest\.[0-9a-f]{64}\.json$/;
// Every asset has the same page and so has every collection: who has seen one can open another one's without the server.
const PAGE = /^\/(view|browse)(\/[^/]+)?$/;

self.addEventListener('install', () => self.skipWaiting());
self.addEventListener('activate', (event) => event.waitUntil(self.clients.claim()));

self.addEventListener('fetch', (event) => {
  const { request } = event;
  const way = request.method === 'GET' && wayOf(request.url);
  if (way) event.respondWith(way(request));
});

// What a page loaded before this worker was there.
self.addEventListener('message', (event) => {
  const kept = (event.data.keep || []).map((url) => wayOf(url)?.(new Request(url)));
  event.waitUntil(Promise.allSettled(kept));
});

function wayOf(address) {
  const url = new URL(address);
  if (url.origin !== self.location.origin) return null;
  if (MANIFEST.test(url.pathname) || (url.pathname.startsWith('/web/') && VERSIONED.test(url.pathname))) return keptFirst;
  return url.pathname.startsWith('/web/') || PAGE.test(url.pathname) || ENTRY.test(url.pathname) ? networkFirst : null;
}

async function keptFirst(request) {
  const shell = await caches.open(NAME);
  return (await shell.match(placeOf(request))) || fetchedAndKept(shell, request);
}

async function networkFirst(request) {
  const shell = await caches.open(NAME);
  try {
    return await fetchedAndKept(shell, request);
  } catch (offline) {
    const kept = await shell.match(placeOf(request));
    if (kept) return kept;
    throw offline;
  }
}

async function fetchedAndKept(shell, request) {
  const answer = await fetch(request);
  if (answer.ok) await shell.put(placeOf(request), answer.clone()).catch(() => {}); // a full device answers all the same
  return answer;
}

function placeOf(request) {
  const [, page] = PAGE.exec(new URL(request.url).pathname) || [];
  return page ? `/${page}/` : request.url;
}
