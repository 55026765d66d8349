// Follows the camera: sends small frames of its film to the worker that compares them, ten a second at most and one at a time.
import { frameSize } from './frame-motion.js';

/** @import { FrameMessage, KeepMessage, MotionAnswer } from './frame-motion.js' */

const FRAME_MS = 100; // between two frames that are compared

/**
 * @typedef {object} Follower
 * @property {(keep: KeepMessage['keep']) => void} tell the worker of a photo
 * @property {() => void} stop
 */

/**
 * Follows what a video shows.
 * @param {HTMLVideoElement} video
 * @param {(motion: MotionAnswer, ms: number) => void} onFrame is called with each comparison, and the time since the frame before
 * @param {() => void} onFailure is called in a browser without such a worker, or when it was not loaded
 * @returns {Follower}
 */
export function followFrames(video, onFrame, onFailure) {
  const worker = new Worker('/web/capture/frame-motion-worker.js', { type: 'module' });
  /** @type {CanvasRenderingContext2D | null} */
  let small = null;
  let timer = 0;
  let sent = 0; // ms: when the newest frame was sent
  let apart = 0; // ms: from the one before
  const send = () => {
    const frame = grab(video, (small = smallFor(video, small)));
    [apart, sent] = [performance.now() - sent, performance.now()];
    if (frame) worker.postMessage(frame, [frame.rgba.buffer]);
    else timer = setTimeout(send, FRAME_MS); // nothing to see yet
  };
  worker.addEventListener('message', (event) => {
    onFrame(/** @type {MotionAnswer} */ (event.data), apart);
    timer = setTimeout(send, Math.max(0, FRAME_MS - (performance.now() - sent)));
  });
  worker.addEventListener('error', onFailure);
  send();
  return {
    tell(keep) {
      /** @type {KeepMessage} */
      const message = { keep };
      worker.postMessage(message);
    },
    stop() {
      clearTimeout(timer);
      worker.terminate();
    },
  };
}

/**
 * A small canvas for a video's frames: the one that there is, where it fits.
 * @param {HTMLVideoElement} video
 * @param {CanvasRenderingContext2D | null} small
 */
function smallFor({ videoWidth, videoHeight }, small) {
  if (!videoWidth) return null;
  const [width, height] = frameSize(videoWidth, videoHeight);
  if (small?.canvas.width === width && small.canvas.height === height) return small;
  const made = Object.assign(document.createElement('canvas'), { width, height }).getContext('2d', {
    willReadFrequently: true,
  });
  if (made) made.imageSmoothingQuality = 'high';
  return made;
}

/**
 * The frame that a video shows.
 * @param {HTMLVideoElement} video
 * @param {CanvasRenderingContext2D | null} small
 * @returns {FrameMessage | null}
 */
function grab(video, small) {
  if (!small) return null;
  const { width, height } = small.canvas;
  small.drawImage(video, 0, 0, width, height);
  return { rgba: small.getImageData(0, 0, width, height).data, width, height };
}
