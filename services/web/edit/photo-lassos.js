// Lassos: lines in the capture's photos around what is left out, or kept. The tab loads this once it is opened.
import { FilmFrames, keyFramesOf } from './film-frames.js';
import { LassoLine, pathOf } from './lasso-line.js';
import { loadCameras } from './photo-camera.js';
import { getJson } from '../shared/api.js';
import { create, element } from '../shared/dom.js';
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Picture } from './film-frames.js' */
/** @import { AssetFile, PhotoLasso } from '../shared/types.d.ts' */

const MOST = 30; // lassos of a recipe

/** The photos, the lines in them, and their list. */
export class PhotoLassos {
  /** @type {PhotoLasso[]} */
  #lassos = [];
  /** @type {Picture[]} */
  #pictures = [];
  #listed = ''; // capture and cameras whose pictures these are
  #films = new FilmFrames();
  #frame = ''; // URL of the film's frame that is shown
  #onChange;
  #page = {
    photo: element('photo', HTMLElement),
    image: element('photo-image', HTMLImageElement),
    drawing: element('photo-lines', SVGSVGElement),
    out: element('lines-out', SVGPathElement),
    keep: element('lines-keep', SVGPathElement),
    beyond: element('beyond-lines', SVGPathElement),
    choice: element('photo-choice', HTMLSelectElement),
    earlier: element('photo-earlier', HTMLButtonElement),
    later: element('photo-later', HTMLButtonElement),
    keeps: element('lasso-keeps', HTMLSelectElement),
    through: element('lasso-through', HTMLInputElement),
    close: element('lasso-close', HTMLButtonElement),
    undo: element('lasso-undo', HTMLButtonElement),
    said: element('lasso-said', HTMLElement),
    list: element('lassos', HTMLUListElement),
  };
  #line = new LassoLine({
    onClose: (line) => this.#add(line),
    onCorners: (count) => {
      this.#page.close.hidden = count < 3;
      this.#page.undo.disabled = count === 0 && this.#lassos.length === 0;
    },
  });

  /** @param {(lassos: PhotoLasso[]) => void} onChange */
  constructor(onChange) {
    this.#onChange = onChange;
    const { image, choice, earlier, later, close, undo } = this.#page;
    image.addEventListener('load', () => this.#fit());
    image.addEventListener('error', () => this.#say(t('This photo cannot be shown. Choose another one.')));
    choice.addEventListener('change', () => this.#showPhoto());
    earlier.addEventListener('click', () => this.#step(-1));
    later.addEventListener('click', () => this.#step(1));
    close.addEventListener('click', () => this.#line.close());
    undo.addEventListener('click', () => this.#undo());
  }

  /**
   * Shows the photos of a capture, and the key frames of its films.
   * @param {string} capture
   * @param {AssetFile | undefined} cameras of the photos, or key frames, that the version on the page was made from
   * @param {PhotoLasso[]} lassos that are drawn already
   * @param {() => boolean} isWanted whether the photos are still to be shown, once the server has answered
   * @throws {Problem} NO_PHOTOS, and what the server says
   */
  async open(capture, cameras, lassos, isWanted) {
    const wanted = `${capture} ${cameras?.sha256}`;
    if (wanted !== this.#listed) {
      /** @type {{ pictures: Picture[], films: { name: string, url: string }[] }} */
      const { pictures, films } = await getJson(`/v1/captures/${encodeURIComponent(capture)}/pictures`);
      const names = films.length ? (await loadCameras(cameras)).map(({ name }) => name) : [];
      [this.#listed, this.#pictures] = [wanted, [...pictures, ...keyFramesOf(names, films)]];
      this.#page.choice.replaceChildren(
        ...this.#pictures.map(({ name }) => create('option', { value: name, textContent: name })),
      );
    }
    if (!isWanted()) return;
    this.show(lassos);
    if (!this.#pictures.length) {
      throw new Problem({ code: 'NO_PHOTOS', detail: t('This capture has no photos that a line can be drawn in.') });
    }
    this.#page.photo.hidden = false;
    this.#showPhoto();
  }

  /** Hides the photo. */
  close() {
    this.#line.clear();
    this.#page.photo.hidden = true;
  }

  /** @param {boolean} isShown whether the thing on the page shows what the lines leave out */
  tellPreview(isShown) {
    this.#say(isShown ? '' : t('What these lines leave out is seen once it is saved.'));
  }

  /** @param {PhotoLasso[]} lassos of a recipe */
  show(lassos) {
    this.#lassos = lassos;
    this.#line.clear();
    this.#draw();
  }

  /** @param {[x: number, y: number][]} line */
  #add(line) {
    if (this.#lassos.length >= MOST) {
      return this.#say(t('A recipe takes {count} lines: remove one first.', { count: MOST }));
    }
    /** @type {PhotoLasso} */
    const lasso = { photo: this.#page.choice.value, line };
    if (this.#page.keeps.value === 'keep') lasso.keeps = true;
    if (this.#page.through.checked) lasso.through = true;
    this.#change([...this.#lassos, lasso]);
  }

  #undo() {
    if (!this.#line.undo()) this.#change(this.#lassos.slice(0, -1));
  }

  /** @param {PhotoLasso[]} lassos */
  #change(lassos) {
    this.#lassos = lassos;
    this.#draw();
    this.#onChange(lassos);
  }

  /** @param {number} by */
  #step(by) {
    const { choice } = this.#page;
    choice.selectedIndex = (choice.selectedIndex + by + this.#pictures.length) % this.#pictures.length;
    this.#showPhoto();
  }

  /** Shows the photo that is chosen. Until it has come, no line can be drawn in the one before, which would be recorded for this one. */
  #showPhoto() {
    const { image, drawing, choice } = this.#page;
    const picture = this.#pictures.find(({ name }) => name === choice.value);
    if (!picture) return;
    this.#line.clear();
    this.#say('');
    document.body.dataset.photo = '';
    image.alt = picture.name;
    image.removeAttribute('src');
    drawing.toggleAttribute('hidden', true);
    if (picture.seconds === undefined) image.src = picture.url;
    else void this.#showFrame(picture.name, picture.url, picture.seconds);
    this.#draw();
  }

  /**
   * @param {string} name
   * @param {string} url of the film
   * @param {number} seconds
   */
  async #showFrame(name, url, seconds) {
    const { image, choice } = this.#page;
    const isWanted = () => choice.value === name;
    try {
      const frame = await this.#films.at(url, seconds, isWanted);
      if (!frame || !isWanted()) return;
      URL.revokeObjectURL(this.#frame);
      this.#frame = URL.createObjectURL(frame);
      image.src = this.#frame;
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      if (isWanted()) this.#say(error.message);
    }
  }

  /** Shows the drawing over the photo that has come, in its shape. */
  #fit() {
    const { image, drawing } = this.#page;
    drawing.toggleAttribute('hidden', false);
    drawing.setAttribute('viewBox', `0 0 ${image.naturalWidth} ${image.naturalHeight}`);
    document.body.dataset.photo = this.#page.choice.value;
    this.#line.clear();
    this.#draw();
  }

  #draw() {
    const { drawing, out, keep, beyond, choice, list, undo } = this.#page;
    const { width, height } = drawing.viewBox.baseVal;
    const here = this.#lassos.filter(({ photo }) => photo === choice.value);
    const [left, kept] = [false, true].map((keeps) =>
      here
        .filter((lasso) => Boolean(lasso.keeps) === keeps)
        .map(({ line }) => pathOf(line, width, height, true))
        .join(''),
    );
    out.setAttribute('d', left);
    keep.setAttribute('d', kept);
    beyond.setAttribute('d', kept && `M0 0H${width}V${height}H0Z${kept}`);
    list.replaceChildren(...this.#lassos.map((lasso, number) => this.#row(lasso, number)));
    undo.disabled = this.#lassos.length === 0;
  }

  /**
   * @param {PhotoLasso} lasso
   * @param {number} place
   */
  #row(lasso, place) {
    const number = place + 1;
    const about = { number, photo: lasso.photo };
    const text = lasso.keeps
      ? t('Line {number} in {photo}: is kept', about)
      : t('Line {number} in {photo}: is left out', about);
    const show = create('button', {
      type: 'button',
      textContent: t('Show'),
      ariaLabel: t('Show line {number}', { number }),
    });
    show.disabled = !this.#pictures.some(({ name }) => name === lasso.photo);
    show.addEventListener('click', () => {
      this.#page.choice.value = lasso.photo;
      this.#showPhoto();
    });
    const remove = create('button', {
      type: 'button',
      textContent: t('Remove'),
      ariaLabel: t('Remove line {number}', { number }),
    });
    remove.addEventListener('click', () => this.#change(this.#lassos.filter((each) => each !== lasso)));
    const row = create('li');
    row.append(create('span', { textContent: text }), show, remove);
    return row;
  }

  /** @param {string} text */
  #say(text) {
    this.#page.said.textContent = text;
  }
}
