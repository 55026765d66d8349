// Painting the parts of a panel in the headset on its canvas: ground, buttons, tiles with a picture, lines of text.

/** @import { Rectangle, Zone } from './press-panel.js' */

const [RADIUS, PAD, LETTERS_PX, PICTURE_PX] = [16, 8, 28, 160];
const [GROUND, FIELD, CHOSEN] = ['rgba(22, 24, 28, 0.94)', '#31363f', '#2f6fde'];
/** The colour of letters. */
export const INK = '#eceef2';

/**
 * Paints the ground of a whole panel.
 * @param {CanvasRenderingContext2D} context
 * @param {[number, number]} pixels
 */
export function paintGround(context, [width, height]) {
  paintBox(context, [0, 0, width, height], GROUND, 2 * RADIUS);
  context.textBaseline = 'middle';
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Rectangle} at
 * @param {string} colour
 * @param {number} radius
 */
function paintBox(context, [x, y, width, height], colour, radius) {
  context.fillStyle = colour;
  context.beginPath();
  context.roundRect(x, y, width, height, radius);
  context.fill();
}

/**
 * Paints a button, and returns what can be pressed.
 * @param {CanvasRenderingContext2D} context
 * @param {Rectangle} at
 * @param {{ name: string, text: string, isChosen?: boolean, press: () => void }} button
 * @returns {Zone}
 */
export function paintButton(context, at, { name, text, isChosen = false, press }) {
  const [x, y, width, height] = at;
  paintBox(context, at, isChosen ? CHOSEN : FIELD, RADIUS);
  paintText(context, text, [x, y, width, height]);
  return { name, at, press };
}

/**
 * Paints a thing: its picture with its name below.
 * @param {CanvasRenderingContext2D} context
 * @param {Rectangle} at
 * @param {string} label
 * @param {ImageBitmap | undefined} picture
 */
export function paintTile(context, at, label, picture) {
  const [x, y, width, height] = at;
  paintBox(context, at, FIELD, RADIUS);
  if (picture) context.drawImage(picture, x + (width - PICTURE_PX) / 2, y + PAD, PICTURE_PX, PICTURE_PX);
  paintText(context, label, [x, y + PICTURE_PX + PAD, width, height - PICTURE_PX - PAD]);
}

/**
 * Paints one line in the middle of a rectangle, cut where it is too long: squeezed letters cannot be read.
 * @param {CanvasRenderingContext2D} context
 * @param {string} text
 * @param {Rectangle} at
 */
function paintText(context, text, [x, y, width, height]) {
  context.fillStyle = INK;
  context.font = `${LETTERS_PX}px system-ui, sans-serif`;
  context.textAlign = 'center';
  let shown = text;
  while (shown.length > 1 && context.measureText(shown).width > width - 2 * PAD) {
    shown = `${[...shown.replace(/…$/, '')].slice(0, -1).join('')}…`;
  }
  context.fillText(shown, x + width / 2, y + height / 2);
}
