// Search words of a thing as people type them: with commas between them.

/**
 * "summer, , Wardrobe" -> ["summer", "Wardrobe"]
 * @param {string} text
 */
export const splitWords = (text) => text.split(/[,;\n]/).map((word) => word.trim()).filter(Boolean);

/** @param {string[]} words */
export const joinWords = (words) => words.join(', ');
