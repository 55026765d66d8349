// Where the phone's camera looks, as far as the phone tells: only after a tap, and only over HTTPS.

const FRESH_MS = 700; // how long to wait for a word of the compass once the person is back from the camera
const LEVEL = 0.3; // least share of the view that is level: a camera that looks straight down looks nowhere
const EVENT = 'ondeviceorientationabsolute' in window ? 'deviceorientationabsolute' : 'deviceorientation';

/** Whether it is worth a button: a phone, on a page that may ask. */
export function mayHaveCompass() {
  return window.isSecureContext && 'DeviceOrientationEvent' in window && navigator.maxTouchPoints > 0;
}

/** Ask for it, in answer to a tap. Resolves to whether directions come. */
export async function startCompass() {
  const asked = await DeviceOrientationEvent.requestPermission?.().catch(() => 'denied'); // iOS asks, Android does not
  return asked !== 'denied' && (await heading()) !== null;
}

/** Degrees clockwise from where the compass begins, or null where none comes or the camera looks down. */
export function heading() {
  return new Promise((resolve) => {
    const done = (event) => {
      if (event?.alpha === null) return; // what a browser says first that has no sensor yet, or never will
      clearTimeout(timer);
      window.removeEventListener(EVENT, done);
      resolve(event ? headingOf(event) : null);
    };
    const timer = setTimeout(done, FRESH_MS);
    window.addEventListener(EVENT, done);
  });
}

/** Of the back of the device, which its camera looks out of (W3C Device Orientation, worked example). */
export function headingOf({ alpha, beta, gamma }) {
  const [a, b, g] = [alpha, beta, gamma].map((degrees) => (degrees * Math.PI) / 180);
  const east = -Math.cos(a) * Math.sin(g) - Math.sin(a) * Math.sin(b) * Math.cos(g);
  const north = -Math.sin(a) * Math.sin(g) + Math.cos(a) * Math.sin(b) * Math.cos(g);
  if (Math.hypot(east, north) < LEVEL) return null;
  return ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
}
