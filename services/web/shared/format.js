// Numbers and states as people read them. The browser's own way would load tables for a twentieth of a second first.
import { language, t } from './texts.js';

/** @import { AssetState } from './types.d.ts' */

const [GROUPS, DECIMALS] = language === 'de' ? ['.', ','] : [',', '.'];

/**
 * 1234567 as 1,234,567.
 * @param {number} count
 */
export const formatCount = (count) => String(count).replace(/\B(?=(\d{3})+$)/g, GROUPS);

/**
 * 1.50 as 1.5, or 1,5 in a German page.
 * @param {number | string} number a string keeps its zeros, as those of toFixed
 */
export const formatNumber = (number) => String(number).replace('.', DECIMALS);

/**
 * 1234.5 as 1230, and 0.12345 as 0.123: as much as a measurement by hand is worth.
 * @param {number} value
 */
export const formatRounded = (value) => formatNumber(Number(value.toPrecision(3)));

/** @type {Record<AssetState | 'removed', string>} */
const STATES = { preview: t('preview'), refined: t('refined'), removed: t('removed') };

/**
 * The word for the state of an asset.
 * @param {string} state
 */
export const stateText = (state) => STATES[/** @type {AssetState} */ (state)] ?? state;

const UNITS = ['bytes', 'KB', 'MB', 'GB'];

/**
 * 1234567 as 1.2 MB.
 * @param {number} bytes
 */
export function formatBytes(bytes) {
  const power = Math.min(UNITS.length - 1, Math.floor(Math.log10(Math.max(bytes, 1)) / 3));
  const size = bytes / 1000 ** power;
  return `${size < 10 && power ? formatNumber(size.toFixed(1)) : Math.round(size)} ${UNITS[power]}`;
}

/** @typedef {[least: number, size: number, name: string]} Unit from which value on it is used, and what it is of the unit of all */

/** @type {Unit[]} */
const LENGTHS = [
  [1, 1, 'm'],
  [0.01, 0.01, 'cm'],
  [0, 0.001, 'mm'],
];
/** @type {Unit[]} */
const AREAS = [
  [0.1, 1, 'm²'],
  [1e-4, 1e-4, 'cm²'],
  [0, 1e-6, 'mm²'],
];
const MOST_DECIMALS = 3;

/**
 * Metres as 1.23 m, 42.3 cm or 8 mm; with how far off it may be as 42.3 ± 0.2 cm.
 * @param {number} metres
 * @param {number | null} [error]
 */
export const formatLength = (metres, error = null) => inUnit(metres, error, LENGTHS);

/**
 * Square metres as 0.42 m², 42.3 cm² or 8 mm².
 * @param {number} area
 * @param {number | null} [error]
 */
export const formatArea = (area, error = null) => inUnit(area, error, AREAS);

/**
 * Degrees as 90.0°, or 90.0 ± 0.4°.
 * @param {number} degrees
 * @param {number | null} [error]
 */
export const formatAngle = (degrees, error = null) =>
  error === null ? `${formatNumber(degrees.toFixed(1))}°` : `${withError(degrees, error)}°`;

/**
 * @param {number} value
 * @param {number | null} error
 * @param {Unit[]} units
 */
function inUnit(value, error, units) {
  const [, size, name] = units.find(([least]) => Math.abs(value) >= least) ?? units[units.length - 1];
  return `${error === null ? formatNumber(Number(Number((value / size).toPrecision(3)).toFixed(MOST_DECIMALS))) : withError(value / size, error / size)} ${name}`;
}

/**
 * A value to the place of its error's first digit, which is rounded up: it must not promise more than is known.
 * @param {number} value
 * @param {number} error
 */
function withError(value, error) {
  const decimals = Math.min(MOST_DECIMALS, Math.max(0, -Math.floor(Math.log10(Math.max(error, 1e-9)))));
  const step = 10 ** decimals;
  return `${formatNumber(value.toFixed(decimals))} ± ${formatNumber((Math.ceil(error * step - 1e-9) / step).toFixed(decimals))}`;
}
