// Key frames of a capture's films, decoded by the browser: it fetches only the parts of a film that it needs.
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

const LONGEST_PX = 1024; // as photos are sent
const ROUNDING_S = 0.005; // a key frame's name has two decimals: the frame itself may begin so much later
const QUALITY = 0.9;
const PATIENCE_MS = 30_000; // a film without an index is searched from its beginning
const PRESENTED_MS = 3_000; // a page that is hidden is presented no frame

/** @typedef {{ name: string, url: string, seconds?: number }} Picture a photo, or with `seconds` a frame of the film at `url` */

/**
 * The key frames among the photos that a version's cameras took, by film and time.
 * @param {string[]} names of cameras
 * @param {{ name: string, url: string }[]} films
 * @returns {Picture[]}
 */
export function keyFramesOf(names, films) {
  return films.flatMap(({ name: film, url }) =>
    names
      .filter((name) => name.startsWith(`${film} at `) && /^\d+\.\d\d s$/.test(name.slice(film.length + 4)))
      .map((name) => ({ name, url, seconds: parseFloat(name.slice(film.length + 4)) }))
      .toSorted((a, b) => a.seconds - b.seconds),
  );
}

/** A film, of which one frame at a time is shown. */
export class FilmFrames {
  #video = Object.assign(document.createElement('video'), { muted: true, playsInline: true, preload: 'metadata' });
  #canvas = document.createElement('canvas');
  #url = '';
  /** @type {Promise<unknown>} */
  #before = Promise.resolve();

  /**
   * A frame as a picture, upright as the browser shows the film; null where another one has been asked for since.
   * @param {string} url of the film
   * @param {number} seconds since its first frame
   * @param {() => boolean} isWanted
   * @returns {Promise<Blob | null>}
   * @throws {Problem} FILM_UNREADABLE
   */
  async at(url, seconds, isWanted) {
    const mine = this.#before.catch(() => null).then(() => (isWanted() ? this.#decode(url, seconds) : null));
    this.#before = mine;
    return mine;
  }

  /**
   * @param {string} url
   * @param {number} seconds
   */
  async #decode(url, seconds) {
    const video = this.#video;
    if (url !== this.#url) {
      this.#url = url;
      video.src = url;
      await this.#until('loadedmetadata');
    }
    const presented = this.#presented();
    video.currentTime = seconds + ROUNDING_S;
    await this.#until('seeked');
    await presented;
    const scale = Math.min(1, LONGEST_PX / Math.max(video.videoWidth, video.videoHeight));
    [this.#canvas.width, this.#canvas.height] = [
      Math.round(scale * video.videoWidth),
      Math.round(scale * video.videoHeight),
    ];
    this.#canvas.getContext('2d')?.drawImage(video, 0, 0, this.#canvas.width, this.#canvas.height);
    /** @type {Blob | null} */
    const picture = await new Promise((resolve) => this.#canvas.toBlob(resolve, 'image/jpeg', QUALITY));
    if (!picture) throw this.#unreadable();
    return picture;
  }

  /** The next frame is what is drawn from now on: on a busy phone `seeked` comes earlier, while the frame before it is still drawn. */
  async #presented() {
    if (!('requestVideoFrameCallback' in this.#video)) return;
    await new Promise((resolve) => {
      this.#video.requestVideoFrameCallback(resolve);
      setTimeout(resolve, PRESENTED_MS);
    });
  }

  /** @param {'loadedmetadata' | 'seeked'} event */
  async #until(event) {
    const done = new AbortController();
    const { signal } = done;
    try {
      await new Promise((resolve, reject) => {
        this.#video.addEventListener(event, resolve, { signal });
        this.#video.addEventListener('error', reject, { signal });
        const timer = setTimeout(reject, PATIENCE_MS);
        signal.addEventListener('abort', () => clearTimeout(timer));
      });
    } catch {
      throw this.#unreadable();
    } finally {
      done.abort();
    }
  }

  #unreadable() {
    this.#url = '';
    const detail = t(
      'This browser cannot show the video that this picture is from. Try another browser, such as that of the phone that took it.',
    );
    return new Problem({ code: 'FILM_UNREADABLE', detail });
  }
}
