// Search words of a thing as people type them, with commas between them; and words without what a search does not mind.

/**
 * "summer, , Wardrobe" -> ["summer", "Wardrobe"]
 * @param {string} text
 */
export const splitWords = (text) =>
  text
    .split(/[,;\n]/)
    .map((word) => word.trim())
    .filter(Boolean);

/** @param {string[]} words */
export const joinWords = (words) => words.join(', ');

/**
 * Removes accents and capital letters.
 * @param {string} text
 */
export const simplify = (text) => text.normalize('NFKD').replace(/\p{M}/gu, '').toLowerCase();
