// The grade of an asset in words that people understand.
import { t } from './texts.js';

/** @import { Grade, GradeLevel } from './types.d.ts' */

/** @type {Record<GradeLevel, string>} */
const WORDS = {
  good: t('Good'),
  usable: t('Usable'),
  incomplete: t('Incomplete'),
  'shoot again': t('Please shoot again'),
};

/**
 * The words for the level of a grade; '' for one that a newer server has.
 * @param {string} level
 */
export const gradeText = (level) => WORDS[/** @type {GradeLevel} */ (level)] ?? '';

/**
 * Why the grade is not better, and what to do; '' for a good one.
 * @param {Grade} grade
 */
export const gradeReason = ({ because, advice }) =>
  because ? `${because.charAt(0).toUpperCase()}${because.slice(1)}. ${advice}` : '';

/**
 * The warnings of a job without the one that says its grade, which is told by itself.
 * @param {string[]} warnings
 * @param {Grade | null | undefined} grade
 */
export const otherWarnings = (warnings, grade) =>
  warnings.filter((each) => !grade?.because || !each.includes(grade.because));
