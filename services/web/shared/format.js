// Numbers as people read them.

/**
 * 1234567 as 1,234,567. The browser's own way would load tables for a twentieth of a second first.
 * @param {number} count
 */
export const formatCount = (count) => String(count).replace(/\B(?=(\d{3})+$)/g, ',');

const UNITS = ['bytes', 'KB', 'MB', 'GB'];

/**
 * 1234567 as 1.2 MB.
 * @param {number} bytes
 */
export function formatBytes(bytes) {
  const power = Math.min(UNITS.length - 1, Math.floor(Math.log10(Math.max(bytes, 1)) / 3));
  const size = bytes / 1000 ** power;
  return `${size < 10 && power ? size.toFixed(1) : Math.round(size)} ${UNITS[power]}`;
}
