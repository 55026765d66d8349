// The worker that looks at photos, one at a time, so that a person can go on while it does.
import { lookAt } from './photo-quality.js';

let before = Promise.resolve(); // a decoded photo takes 50 MB: never two

addEventListener('message', ({ data: { number, file } }) => {
  before = before.then(async () => {
    const look = await lookAt(file, (width, height) => new OffscreenCanvas(width, height)).catch(() => null);
    postMessage({ number, look });
  });
});
