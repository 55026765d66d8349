// The stage's WebGL context, in a module of its own: it is created while the catalogue's answer is on its way, and before the 3D library has come.
import { createContext } from '../graphics/webgl-context.js';
import { element } from '../shared/dom.js';

/** Of the viewer's canvas; null where the browser has none. */
export const context = createContext(element('stage', HTMLCanvasElement));
