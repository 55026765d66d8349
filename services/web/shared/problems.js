// Problems as exceptions, and the sentences of those that arise on the device. Modules that a worker loads need them too, which has no page.
import { t } from './texts.js';

/** @import { ProblemDocument } from './types.d.ts' */

/** A problem document as an exception: `message` is for people, `code` for programs. */
export class Problem extends Error {
  /** @param {ProblemDocument} document */
  constructor(document) {
    super(document.detail || document.title || t('Something went wrong.'));
    this.code = document.code || 'UNKNOWN';
    this.file = document.file || '';
    this.hints = document.hints || [];
    this.status = document.status || 0;
  }
}

const CHECK_CONNECTION = [t('Check the connection and try again.')];

/** The server cannot be reached. */
export const offline = () =>
  new Problem({ code: 'OFFLINE', detail: t('The server cannot be reached.'), hints: CHECK_CONNECTION });

/** The server was silent for too long. */
export const noAnswer = () =>
  new Problem({ code: 'NO_ANSWER', detail: t('The server does not answer.'), hints: CHECK_CONNECTION });

/** Somebody else has logged in meanwhile: what a page shows is not theirs, and what it would change is. */
export const otherLogin = () =>
  new Problem({
    code: 'OTHER_LOGIN',
    detail: t('Nothing was changed: in another tab of this browser, somebody else has logged in.'),
    hints: [t('Log in again, or load this page anew.')],
  });

const NO_CONTENT = 204;

/** A file was loaded, but cannot be decoded. */
export const undecodable = () =>
  new Problem({
    code: 'NOT_DECODED',
    detail: t('The 3D file was loaded, but this browser could not open it.'),
    hints: [t('Try again, or open this address in another browser.')],
  });

/**
 * Parse the body of an answer.
 * @template T
 * @param {number} status
 * @param {string} text
 * @returns {T} what the caller declares: the server's document is trusted to have that shape; undefined for an answer that has none
 * @throws {Problem} where the status or the body is an error
 */
export function parseAnswer(status, text) {
  if (status === NO_CONTENT) return /** @type {T} */ (undefined);
  /** @type {T} */
  let body;
  try {
    body = JSON.parse(text);
  } catch {
    throw new Problem({
      status,
      detail: t('The server answered {status}, with something that this page cannot read.', { status }),
      hints: [t('Try again later.')],
    });
  }
  if (status >= 200 && status < 300) return body;
  throw new Problem({ status, ...body });
}

/**
 * Whether a problem lies between here and the server, so that a copy on the device may be shown instead.
 * @param {unknown} error
 * @returns {boolean}
 */
export const isConnectionProblem = (error) => error instanceof Problem && ['OFFLINE', 'NO_ANSWER'].includes(error.code);

const AGAIN = [408, 409, 423, 425, 429, 500, 502, 503, 504]; // answers after which the same may succeed

/**
 * Whether the same request may succeed in a while.
 * @param {unknown} error
 * @returns {boolean}
 */
export const isTemporary = (error) =>
  isConnectionProblem(error) || (error instanceof Problem && AGAIN.includes(error.status));

/**
 * Any error as a problem that people can read. One that is no problem is a fault of the page: people only read that there is one.
 * @param {unknown} error
 * @returns {Problem}
 */
export function toProblem(error) {
  if (error instanceof Problem) return error;
  console.error(error);
  return new Problem({ detail: t('Something in this page went wrong.'), hints: [t('Try again.')] });
}

/**
 * The sentences of an error that people can read.
 * @param {unknown} error
 * @returns {string}
 */
export function sentences(error) {
  const { message, hints } = toProblem(error);
  return [message, ...hints].map(asSentence).join(' ');
}

/**
 * A text with a capital letter and a full stop: the server's are parts of sentences.
 * @param {string} text
 */
const asSentence = (text) => text.charAt(0).toUpperCase() + text.slice(1) + (/[.!?…]$/.test(text) ? '' : '.');
