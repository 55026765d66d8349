// Numbers as people read them.

/**
 * 1234567 as 1,234,567. The browser's own way would load tables for a twentieth of a second first.
 * @param {number} count
 */
export const formatCount = (count) => String(count).replace(/\B(?=(\d{3})+$)/g, ',');
