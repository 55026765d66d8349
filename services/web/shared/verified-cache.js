// Files of assets, kept on the device under their hash: what was loaded once needs no network again, and what has
// rotted or was tampered with is never shown.
import { Problem } from './api.js';

const NAME = 'assets-1';

/** The bytes of a catalogue's file ({url, sha256, file}) as an ArrayBuffer. Throws Problem ASSET_TAMPERED, ASSET_ABSENT. */
export async function bytesOf(file) {
  const vault = await opened();
  const place = `/vault/${file.sha256}`;
  const kept = await vault?.match(place);
  if (kept) {
    const bytes = await kept.arrayBuffer();
    if (await means(bytes, file.sha256)) return bytes;
    await vault.delete(place);
  }
  const bytes = await fetched(file);
  await keep(vault, place, bytes);
  return bytes;
}

async function fetched(file) {
  // The browser's own cache may have rotted too: what is wrong once is asked for again, from the server.
  for (const cache of ['default', 'reload']) {
    const answer = await fetch(file.url, { cache });
    if (!answer.ok) {
      throw new Problem({ code: 'ASSET_ABSENT', status: answer.status, detail: `${file.file} is not where the catalogue says.` });
    }
    const bytes = await answer.arrayBuffer();
    if (await means(bytes, file.sha256)) return bytes;
  }
  const hints = ['It was changed on its way or at its place. Tell whoever runs this server.'];
  throw new Problem({ code: 'ASSET_TAMPERED', detail: `${file.file} is not what the catalogue promises, so it is not shown.`, hints });
}

/** Whether bytes have the hash. Only where the browser lets pages compute one: over https, or on this machine. */
async function means(bytes, sha256) {
  if (!crypto.subtle) return true;
  const digest = new Uint8Array(await crypto.subtle.digest('SHA-256', bytes));
  return Array.from(digest, (value) => value.toString(16).padStart(2, '0')).join('') === sha256;
}

async function opened() {
  try {
    return await caches.open(NAME);
  } catch {
    return null; // not over plain http, and not in every private window
  }
}

/** Kept for the next visit; where the device is full, everything kept makes place once. */
async function keep(vault, place, bytes) {
  const copy = () => new Response(bytes.slice(0), { headers: { 'Content-Type': 'application/octet-stream' } });
  try {
    await vault?.put(place, copy());
  } catch {
    await caches.delete(NAME);
    await (await opened())?.put(place, copy()).catch(() => {}); // it was shown; the next visit fetches it again
  }
}
