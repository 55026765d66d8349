// The poster: the asset's thumbnail, in the middle of the page until the first level of detail is there.
import { loadFile } from '../catalogue/verified-cache.js';
import { element } from '../shared/dom.js';

/** @import { AssetEntry } from '../shared/types.d.ts' */

const THUMBNAIL = 'thumbnail.webp';

/**
 * Shows the thumbnail of an asset, unless its mesh was faster. Nothing where there is none, or where it does not come.
 * @param {AssetEntry} entry
 * @param {() => boolean} isNeeded whether there is still nothing else to see
 */
export async function showPoster({ files = [] }, isNeeded) {
  const thumbnail = files.find(({ file }) => file === THUMBNAIL);
  if (!thumbnail) return;
  const bytes = await loadFile(thumbnail).catch(() => null);
  if (!bytes || !isNeeded()) return;
  const image = element('poster', HTMLImageElement);
  image.src = URL.createObjectURL(new Blob([bytes], { type: 'image/webp' }));
  image.hidden = false;
  document.body.dataset.poster = 'yes';
  await image.decode().catch(() => {}); // it may be taken away meanwhile
}

/** Takes the poster away. */
export function hidePoster() {
  const image = element('poster', HTMLImageElement);
  if (image.hidden) return;
  image.hidden = true;
  URL.revokeObjectURL(image.src);
  image.removeAttribute('src');
  delete document.body.dataset.poster;
}
