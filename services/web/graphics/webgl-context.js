// A canvas's WebGL context in the size and with the settings that the stage wants, created before the 3D library is there.

const MOST_PIXELS = 2; // of the screen to one of the page, along a side: finer ones nobody sees, and they cost a phone's battery
/** @type {WebGLContextAttributes} */
const SETTINGS = { alpha: true, antialias: true, depth: true, stencil: false };

/** Pixels of the canvas to one of the page. */
export const pixelRatio = () => Math.min(window.devicePixelRatio, MOST_PIXELS);

/**
 * Creates a canvas's context. It takes a tenth of a second, and so does each later change of the canvas's size.
 * @param {HTMLCanvasElement} canvas
 * @returns {WebGL2RenderingContext | null} null where the browser has no WebGL
 */
export function createContext(canvas) {
  canvas.width = Math.floor(canvas.clientWidth * pixelRatio());
  canvas.height = Math.floor(canvas.clientHeight * pixelRatio());
  return canvas.getContext('webgl2', SETTINGS);
}
