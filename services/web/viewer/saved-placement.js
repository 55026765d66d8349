// Where people put things, remembered by the browser from visit to visit. What it reads may be old, full or meddled with.

const PLACE = 'capture2vr:placed';
const MOST = 200; // assets; the one that was moved longest ago is forgotten first
const FAR_M = 20; // from where it would stand by itself: a hall; farther off nobody would find it again
export const SCALES = [0.05, 20]; // smallest and largest against true size

/** {offset_m: [x, y, z], turn: [x, y, z, w], scale} of an asset against where it would stand by itself, or null. */
export function remembered(key) {
  const row = rows().find(([name]) => name === key);
  return row ? placementOf(row[1]) : null;
}

export function remember(key, { offset_m: offset, turn, scale }) {
  const numbers = [...offset, ...turn, scale].map((value) => Number(value.toFixed(5)));
  if (placementOf(numbers)) store([...rows().filter(([name]) => name !== key), [key, numbers]].slice(-MOST));
}

export function forget(keys) {
  store(rows().filter(([name]) => !keys.includes(name)));
}

/** Eight numbers that make sense, or null. */
function placementOf(numbers) {
  if (!Array.isArray(numbers) || numbers.length !== 8 || !numbers.every(Number.isFinite)) return null;
  const [offset, turn, scale] = [numbers.slice(0, 3), numbers.slice(3, 7), numbers[7]];
  const length = Math.hypot(...turn);
  if (Math.hypot(...offset) > FAR_M || Math.abs(length - 1) > 0.01 || scale < SCALES[0] || scale > SCALES[1]) return null;
  return { offset_m: offset, turn: turn.map((value) => value / length), scale };
}

function rows() {
  try {
    const kept = JSON.parse(localStorage.getItem(PLACE));
    return Array.isArray(kept) ? kept.filter((row) => Array.isArray(row) && typeof row[0] === 'string').slice(-MOST) : [];
  } catch {
    return [];
  }
}

function store(kept) {
  try {
    localStorage.setItem(PLACE, JSON.stringify(kept));
  } catch {
    // A full or forbidden store: it stands where it was put until the page is closed.
  }
}
