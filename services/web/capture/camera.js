// The phone's camera, as pages get it: opened, photographed with, and closed; and why it cannot be.
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';
import { PHOTO_MS, withTimeLimit } from '../shared/time-limits.js';

const OTHERWISE = t('Take the photos with the phone’s own camera instead: “Take photos” or “Choose files”.');
const SHARPEST = { width: { ideal: 3840 }, height: { ideal: 2160 } }; // where frames of the film become the photos
const PREVIEW = { width: { ideal: 1920 }, height: { ideal: 1080 } }; // where the camera itself takes photos, in full resolution
const JPEG_QUALITY = 0.92;

/** @type {Record<string, string>} by the name of the browser's error */
const REASONS = {
  NotAllowedError: t(
    'This page is not allowed to use the camera. You can allow it in the browser, beside the page’s address.',
  ),
  NotFoundError: t('No camera was found.'),
  NotReadableError: t('The camera does not start; another program may be using it.'),
};

/** A camera that is open. `photographs`: whether it takes photos by itself, or frames of its film become the photos. */
export class Camera {
  /**
   * @param {MediaStream} stream
   * @param {HTMLVideoElement} video shows it
   */
  constructor(stream, video) {
    this.video = video;
    this.track = stream.getVideoTracks()[0];
    /** @type {ImageCapture | null} */
    this.photographer = typeof ImageCapture === 'undefined' ? null : new ImageCapture(this.track);
  }

  /**
   * Starts to show what the camera sees; the video has to be in view, or phones do not play it.
   * @throws {Problem} NO_CAMERA
   */
  async start() {
    try {
      await withTimeLimit(this.video.play(), PHOTO_MS);
    } catch {
      throw noCamera(t('The camera does not start.'));
    }
  }

  /**
   * Takes a photo. A camera that takes none, or takes too long, gives a frame of its film from then on.
   * @returns {Promise<Blob>}
   */
  async takePhoto() {
    if (this.photographer) {
      try {
        return await withTimeLimit(this.photographer.takePhoto(), PHOTO_MS);
      } catch {
        this.photographer = null;
        await this.track.applyConstraints(SHARPEST).catch(() => {}); // the film's frames are the photos now
      }
    }
    return frameOfFilm(this.video);
  }

  /** Closes the camera: its light goes out. */
  close() {
    this.track.stop();
    this.video.srcObject = null;
  }
}

/**
 * Opens the camera at the phone's back, for a video to show.
 * @param {HTMLVideoElement} video
 * @returns {Promise<Camera>}
 * @throws {Problem} NO_CAMERA, with the reason and what to do instead
 */
export async function openCamera(video) {
  if (!navigator.mediaDevices?.getUserMedia) {
    throw noCamera(
      window.isSecureContext
        ? t('This browser has no camera for pages.')
        : t('Browsers open the camera only for pages with an https address.'),
    );
  }
  const size = typeof ImageCapture === 'undefined' ? SHARPEST : PREVIEW;
  /** @type {MediaStream} */
  let stream;
  try {
    stream = await navigator.mediaDevices.getUserMedia({
      video: { facingMode: { ideal: 'environment' }, ...size },
      audio: false,
    });
  } catch (error) {
    const name = error instanceof DOMException ? error.name : '';
    throw noCamera(REASONS[name] ?? t('The camera does not start.'));
  }
  video.srcObject = stream;
  return new Camera(stream, video);
}

/** @param {string} reason */
const noCamera = (reason) => new Problem({ code: 'NO_CAMERA', detail: reason, hints: [OTHERWISE] });

/**
 * The frame that a video shows, as a JPEG.
 * @param {HTMLVideoElement} video
 * @returns {Promise<Blob>}
 */
function frameOfFilm(video) {
  const canvas = Object.assign(document.createElement('canvas'), {
    width: video.videoWidth,
    height: video.videoHeight,
  });
  canvas.getContext('2d')?.drawImage(video, 0, 0);
  return new Promise((resolve, reject) => {
    canvas.toBlob(
      (blob) => (blob ? resolve(blob) : reject(noCamera(t('The camera gives no picture.')))),
      'image/jpeg',
      JPEG_QUALITY,
    );
  });
}
