// The compass: in which direction the phone's camera looks. Works only after a tap, and only over HTTPS.

const TIMEOUT_MS = 700; // how long to wait for the compass once the person is back from the camera
const LEVEL = 0.3; // least share of the view that is level: a camera that looks straight down has no direction
const ABSOLUTE_EVENT = 'ondeviceorientationabsolute' in window;

/** @typedef {Pick<DeviceOrientationEvent, 'alpha' | 'beta' | 'gamma'>} Orientation angles of the device in degrees */

/** Whether to offer the compass: on a phone, on a page that is allowed to ask for it. */
export function mayHaveCompass() {
  return window.isSecureContext && 'DeviceOrientationEvent' in window && navigator.maxTouchPoints > 0;
}

/**
 * Asks the person for permission to use the compass, in answer to a tap.
 * @returns {Promise<boolean>} whether it may be used
 */
export async function allowCompass() {
  // iOS asks, Android does not; TypeScript does not know the method of iOS.
  const events = /** @type {{ requestPermission?: () => Promise<string> }} */ (DeviceOrientationEvent);
  return (await events.requestPermission?.().catch(() => 'denied')) !== 'denied';
}

/**
 * Asks for permission, in answer to a tap, and reads the compass.
 * @returns {Promise<boolean>} whether the compass works
 */
export const startCompass = async () => (await allowCompass()) && (await readHeading()) !== null;

/**
 * Reads the compass once.
 * @returns {Promise<number | null>} degrees clockwise from north, or from where a compass without north begins; null
 *   without an answer, or where the camera looks down
 */
export function readHeading() {
  return new Promise((resolve) => {
    /** @param {DeviceOrientationEvent} event */
    const read = (event) => {
      if (event.alpha !== null) finish(headingOf(event)); // a browser without a sensor, or without one yet, sends null
    };
    /** @param {number | null} heading */
    const finish = (heading) => {
      clearTimeout(timer);
      stopListening();
      resolve(heading);
    };
    const timer = setTimeout(() => finish(null), TIMEOUT_MS);
    const stopListening = listen(read);
  });
}

/**
 * Follows the compass, once it is allowed.
 * @param {(heading: number | null) => void} listener is called with degrees as of `readHeading`
 * @returns {() => void} a function that stops it
 */
export const followHeading = (listener) => listen((event) => listener(event.alpha === null ? null : headingOf(event)));

/**
 * Listens to the compass.
 * @param {(event: DeviceOrientationEvent) => void} listener
 * @returns {() => void} a function that stops it
 */
function listen(listener) {
  if (ABSOLUTE_EVENT) {
    window.addEventListener('deviceorientationabsolute', listener);
    return () => window.removeEventListener('deviceorientationabsolute', listener);
  }
  window.addEventListener('deviceorientation', listener);
  return () => window.removeEventListener('deviceorientation', listener);
}

/**
 * Computes the direction of the back of the device, where its camera is (W3C Device Orientation, worked example).
 * @param {Orientation} orientation
 * @returns {number | null} degrees clockwise, 0 to 360; null where the camera looks up or down
 */
export function headingOf({ alpha, beta, gamma }) {
  const [a, b, g] = [alpha, beta, gamma].map((degrees) => ((degrees ?? 0) * Math.PI) / 180);
  const east = -Math.cos(a) * Math.sin(g) - Math.sin(a) * Math.sin(b) * Math.cos(g);
  const north = -Math.sin(a) * Math.sin(g) + Math.cos(a) * Math.sin(b) * Math.cos(g);
  if (Math.hypot(east, north) < LEVEL) return null;
  return ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
}
