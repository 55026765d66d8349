// Drawing a closed line over a photo: with a finger or a mouse in one go, or corner by corner with the keys.
import { element } from '../shared/dom.js';

/** @typedef {[x: number, y: number]} Corner shares of the photo's width and height */

const MOST_CORNERS = 64; // of a recipe's line
const DIGITS = 1e4; // a recipe has four decimals
const FINEST = 0.002; // of the photo: a finger's line is thinned to this at first
const LEAST_SIDE = 0.01; // of the rectangle around a line: less is a tap
const [STEP, SMALL_STEP] = [0.02, 0.005]; // of the photo, for each press of an arrow key, and with Shift
/** @type {Record<string, Corner>} */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** @param {number} share */
const within = (share) => Math.round(DIGITS * Math.min(1, Math.max(0, share))) / DIGITS;

/**
 * Thins a line: corners that lie nearer than `distance` to the line without them go (Douglas and Peucker).
 * @param {Corner[]} line
 * @param {number} distance
 * @returns {Corner[]}
 */
function thin(line, distance) {
  if (line.length < 3) return line;
  const [first, last] = [line[0], line[line.length - 1]];
  let [farthest, most] = [0, 0];
  for (let at = 1; at < line.length - 1; at++) {
    const away = distanceTo(line[at], first, last);
    if (away > most) [farthest, most] = [at, away];
  }
  if (most <= distance) return [first, last];
  return [...thin(line.slice(0, farthest + 1), distance).slice(0, -1), ...thin(line.slice(farthest), distance)];
}

/**
 * The distance of a corner to the stretch between two others.
 * @param {Corner} corner
 * @param {Corner} start
 * @param {Corner} end
 */
function distanceTo([x, y], [x0, y0], [x1, y1]) {
  const [dx, dy] = [x1 - x0, y1 - y0];
  const along = Math.min(1, Math.max(0, ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(x - x0 - along * dx, y - y0 - along * dy);
}

/**
 * A line with as many corners as a recipe takes; null for one that goes round nothing.
 * @param {Corner[]} drawn
 * @returns {Corner[] | null}
 */
export function closedLine(drawn) {
  const half = Math.floor(drawn.length / 2); // the two halves are thinned, as the line ends where it began
  let line = drawn;
  for (let distance = FINEST; line.length > MOST_CORNERS || line === drawn; distance *= 1.5) {
    line =
      drawn.length < 8
        ? [...drawn]
        : [...thin(drawn.slice(0, half + 1), distance).slice(0, -1), ...thin(drawn.slice(half), distance)];
  }
  const sides = [0, 1].map(
    (axis) => Math.max(...line.map((corner) => corner[axis])) - Math.min(...line.map((corner) => corner[axis])),
  );
  return line.length >= 3 && Math.min(...sides) >= LEAST_SIDE ? line : null;
}

/** Draws a line over a photo, and tells when it is closed. */
export class LassoLine {
  /** @type {Corner[]} */
  #corners = [];
  /** @type {Corner} */
  #cross = [0.5, 0.5]; // where the next corner of the keys is put
  #isDrawn = false; // by a finger that is down
  #drawing = element('photo-lines', SVGSVGElement);
  #path = element('line-now', SVGPathElement);
  #mark = element('photo-cross', SVGPathElement);
  #onClose;
  #onCorners;

  /**
   * @param {object} callbacks
   * @param {(line: Corner[]) => void} callbacks.onClose is called with a line that goes round something
   * @param {(count: number) => void} callbacks.onCorners is called with the number of corners of a line that is not closed
   */
  constructor({ onClose, onCorners }) {
    this.#onClose = onClose;
    this.#onCorners = onCorners;
    const drawing = this.#drawing;
    drawing.addEventListener('pointerdown', (event) => this.#begin(event));
    drawing.addEventListener('pointermove', (event) => this.#goOn(event));
    drawing.addEventListener('pointerup', (event) => event.isPrimary && this.#isDrawn && this.close());
    drawing.addEventListener('pointercancel', () => this.#isDrawn && this.clear());
    drawing.addEventListener('keydown', (event) => this.#press(event));
    for (const kind of ['focus', 'blur']) drawing.addEventListener(kind, () => this.#draw());
  }

  /** Closes the line; one that goes round nothing is dropped. */
  close() {
    const line = closedLine(this.#corners);
    this.clear();
    if (line) this.#onClose(line);
  }

  /** Takes the last corner away. @returns {boolean} whether there was one */
  undo() {
    const had = this.#corners.pop() !== undefined;
    this.#draw();
    return had;
  }

  /** Begins anew. */
  clear() {
    this.#corners = [];
    this.#isDrawn = false;
    this.#draw();
  }

  /** @param {PointerEvent} event */
  #begin(event) {
    if (!event.isPrimary || event.button !== 0) return;
    this.#drawing.setPointerCapture(event.pointerId); // the finger may leave the photo
    this.#corners = [this.#placeOf(event)];
    this.#isDrawn = true;
    this.#draw();
  }

  /** @param {PointerEvent} event */
  #goOn(event) {
    if (!event.isPrimary || !this.#isDrawn) return;
    const place = this.#placeOf(event);
    const [x, y] = this.#corners[this.#corners.length - 1];
    if (Math.hypot(place[0] - x, place[1] - y) < FINEST) return;
    this.#corners.push(place);
    this.#draw();
  }

  /** @param {KeyboardEvent} event */
  #press(event) {
    const arrow = ARROWS[event.key];
    if (arrow) {
      const step = event.shiftKey ? SMALL_STEP : STEP;
      this.#cross = [within(this.#cross[0] + step * arrow[0]), within(this.#cross[1] + step * arrow[1])];
    } else if (event.key === ' ' && this.#corners.length < MOST_CORNERS) this.#corners.push(this.#cross);
    else if (event.key === 'Enter') this.close();
    else if (event.key === 'Backspace') this.undo();
    else if (event.key === 'Escape') this.clear();
    else return;
    event.preventDefault();
    this.#draw();
  }

  /**
   * @param {PointerEvent} event
   * @returns {Corner} in the photo; the nearest one for a finger beside it
   */
  #placeOf({ clientX, clientY }) {
    const { width, height } = this.#drawing.viewBox.baseVal;
    const place = new DOMPoint(clientX, clientY).matrixTransform(this.#drawing.getScreenCTM()?.inverse());
    return [within(place.x / width), within(place.y / height)];
  }

  #draw() {
    const { width, height } = this.#drawing.viewBox.baseVal;
    const [x, y] = [this.#cross[0] * width, this.#cross[1] * height];
    const arm = 0.03 * Math.max(width, height);
    this.#mark.setAttribute(
      'd',
      document.activeElement === this.#drawing && !this.#isDrawn
        ? `M${x - arm} ${y}H${x + arm}M${x} ${y - arm}V${y + arm}`
        : '',
    );
    this.#path.setAttribute('d', pathOf(this.#corners, width, height, false));
    this.#onCorners(this.#isDrawn ? 0 : this.#corners.length);
  }
}

/**
 * The path of a line in a drawing of this width and height.
 * @param {Corner[]} line
 * @param {number} width
 * @param {number} height
 * @param {boolean} isClosed
 */
export function pathOf(line, width, height, isClosed) {
  const corners = line.map(([x, y]) => `${x * width} ${y * height}`);
  return line.length ? `M${corners.join('L')}${isClosed ? 'Z' : ''}` : '';
}
