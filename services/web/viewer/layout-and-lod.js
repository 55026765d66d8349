// Where the things of a scene stand by themselves, and which level of detail each of them gets. Numbers only, no graphics.

// A level is fine enough while the thing's diameter takes less than this share of the view's height.
const FINE_ENOUGH = [Infinity, 0.3, 0.1];
const KEEP = 0.85; // of that share, before a finer level is given up again: nobody stands so still that none would flicker
const GAP = 0.15; // between neighbours, of their mean width
const GAP_M = 0.1; // at least: a hand fits in between
const ONE_ROW = 4; // things that stand beside each other; more make several rows

/**
 * The level of each thing, as a place in its `lods`, finest first.
 *
 * things  [{share, lods: [{level, triangles}], now}]: share of the view's height that its diameter takes; now: the level it has
 * budget  triangles of all together. The coarsest levels are given whatever they cost. Then all become finer by one level
 *         as far as they want to and the budget goes, the largest in view first, before any becomes finer by two.
 */
export function planned(things, budget) {
  const levels = things.map(({ lods }) => lods.length - 1);
  const wanted = things.map(wantedOf);
  let left = budget - things.reduce((sum, { lods }) => sum + lods.at(-1).triangles, 0);
  const nearFirst = things.map((_, place) => place).sort((a, b) => things[b].share - things[a].share);
  for (let round = Math.max(0, ...levels); round > 0; round--) {
    for (const place of nearFirst) {
      const { lods } = things[place];
      const level = levels[place];
      if (level === 0 || level > round || wanted[place] >= level) continue;
      const more = lods[level - 1].triangles - lods[level].triangles;
      if (more > left) continue;
      left -= more;
      levels[place] -= 1;
    }
  }
  return levels;
}

function wantedOf({ share, lods, now }) {
  for (let place = lods.length - 1; place > 0; place--) {
    const limit = FINE_ENOUGH[Math.min(lods[place].level, FINE_ENOUGH.length - 1)];
    if (share < (now < place ? KEEP * limit : limit)) return place;
  }
  return 0;
}

/** Floor centres [[x, z]] in metres of boxes [[width, height, depth]]: side by side, in rows one behind the other; the first row at z = 0. */
export function sideBySide(sizes) {
  const across = sizes.length <= ONE_ROW ? sizes.length : Math.ceil(Math.sqrt(2 * sizes.length));
  const places = [];
  let front = 0;
  for (let first = 0; first < sizes.length; first += across) {
    const row = sizes.slice(first, first + across);
    const depth = Math.max(...row.map((size) => size[2]));
    const middle = first === 0 ? 0 : front - depth / 2;
    places.push(...centres(row).map((x) => [x, middle]));
    front = middle - depth / 2 - gapOf(row);
  }
  return places;
}

function centres(row) {
  const gap = gapOf(row);
  const whole = row.reduce((sum, size) => sum + size[0] + gap, -gap);
  let left = -whole / 2;
  return row.map(([width]) => {
    const middle = left + width / 2;
    left += width + gap;
    return middle;
  });
}

function gapOf(row) {
  return Math.max(GAP_M, (GAP * row.reduce((sum, size) => sum + size[0], 0)) / row.length);
}
