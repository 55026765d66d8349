// The web worker that follows the camera: how much each frame differs from the one before, and from the last photo that was good.
import { frameOf, isPlain, motionBetween } from './frame-motion.js';
import { FAR } from './shutter.js';

/** @import { Frame, FrameMessage, KeepMessage, MotionAnswer } from './frame-motion.js' */

/** @type {Frame | null} */
let newest = null;
/** @type {Frame | null} */
let held = null; // while its photo is being looked at
/** @type {Frame | null} */
let photo = null;

addEventListener('message', (event) => {
  const message = /** @type {FrameMessage | KeepMessage} */ (event.data);
  if ('keep' in message) {
    if (message.keep === 'hold') held = newest;
    else photo = held;
    return;
  }
  const frame = frameOf(message.rgba, message.width, message.height);
  const before = newest?.width === frame.width && newest.height === frame.height ? newest : null; // a phone that is turned
  const last = photo?.width === frame.width && photo.height === frame.height ? photo : null;
  newest = frame;
  /** @type {MotionAnswer} */
  const answer = {
    since: before && motionBetween(before, frame, FAR),
    fromPhoto: last && motionBetween(last, frame, FAR),
    plain: isPlain(frame),
  };
  postMessage(answer);
});
