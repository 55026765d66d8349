// The web worker that measures photos, one at a time, so that the page stays responsive.
import { measurePhoto } from './photo-quality.js';

/** @import { PhotoAnswer, PhotoRequest } from './photo-quality.js' */

/** @type {Promise<void>} */
let queue = Promise.resolve(); // a decoded photo takes 50 MB: never two at once

addEventListener('message', (event) => {
  const { number, file } = /** @type {PhotoRequest} */ (event.data);
  queue = queue.then(async () => {
    const quality = await measurePhoto(file, (width, height) => new OffscreenCanvas(width, height)).catch(() => null);
    /** @type {PhotoAnswer} */
    const answer = { number, quality };
    postMessage(answer);
  });
});
