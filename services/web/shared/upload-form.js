// The form that an upload of files is: multipart/form-data as one blob, of which nothing is read before it is sent.

const UNSAFE = /[^\w .,()+@=\u0080-\u{10ffff}-]/gu; // in the server's files

/** @typedef {{ path: string, body: Blob }} Part a file, by its name or its path in the folder that was chosen */
/** @typedef {[left: number, top: number, right: number, bottom: number, photo?: string]} MarkedBox shares of the upright photo's sides */

/**
 * What an upload says of its capture.
 * @typedef {object} About
 * @property {MarkedBox | null} box the rectangle that the object lies in, and of several photos the name of the one it is drawn in
 * @property {string} continues id of the stored capture that the photos are added to; '' for none
 */

/**
 * The address of a route that makes a capture.
 * @param {string} path
 * @param {About} about
 */
export function captureAddress(path, { box, continues }) {
  const query = [box && `box=${boxText(box)}`, continues && `continues=${encodeURIComponent(continues)}`].filter(
    Boolean,
  );
  return query.length ? `${path}?${query.join('&')}` : path;
}

/** A rectangle as an address has it. @param {MarkedBox} box */
function boxText([left, top, right, bottom, photo]) {
  return [left, top, right, bottom, ...(photo ? [`photo=${encodeURIComponent(photo)}`] : [])].join(',');
}

/**
 * The name that the server gives a file among those that are sent with it: without its folder, and with a number where
 * others before it have the same, as phones' cameras call every picture `image.jpg`.
 * @param {File} file
 * @param {File[]} files in the order in which they are sent
 */
export function storedName(file, files) {
  const path = pathOf(file).toLowerCase();
  const earlier = files.slice(0, files.indexOf(file)).filter((each) => pathOf(each).toLowerCase() === path).length;
  const name = file.name.normalize('NFC').replace(UNSAFE, '_');
  return earlier ? name.replace(/(\.[^.]*)?$/, (ending) => `-${earlier + 1}${ending}`) : name;
}

/**
 * The form of these files.
 * @param {Part[]} parts
 * @param {string} filetype its media type, which names the boundary
 * @returns {Blob}
 */
export function formOf(parts, filetype) {
  const line = `--${filetype.split('boundary=')[1]}`;
  const pieces = parts.flatMap(({ path, body }) => [
    `${line}\r\nContent-Disposition: form-data; name="files"; filename="${escaped(path)}"\r\n\r\n`,
    body,
    '\r\n',
  ]);
  return new Blob([...pieces, `${line}--\r\n`]);
}

/** A media type with a boundary that stands in no file. */
export const newFiletype = () => `multipart/form-data; boundary=${randomKey()}`;

/** A file as a part of a form. @param {File} file @returns {Part} */
export const partOf = (file) => ({ path: pathOf(file), body: file });

/** A file's path in the folder that was chosen, or its name. @param {File} file */
export const pathOf = (file) => file.webkitRelativePath || file.name;

/** A random key of 32 hexadecimal digits. Not crypto.randomUUID, which needs HTTPS: at home a phone may use plain HTTP. */
export function randomKey() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

/** A name as the HTML standard writes it into a form. @param {string} name */
const escaped = (name) => name.replace(/["\r\n]/g, encodeURIComponent);
