// Merging two changes of one scene, thing by thing. Numbers only, no network.

/** @import { PlacedAsset } from '../shared/types.d.ts' */
/** @typedef {{ name: string, items: PlacedAsset[] }} SceneContent */

/**
 * Merges what this page has changed in a scene with what others have saved. A thing that only one side has changed, added or taken away is as
 * that side has it. One that both have changed is as the others have it, because that is what everybody sees, and is named.
 * @param {SceneContent} base what both began with
 * @param {SceneContent} mine
 * @param {SceneContent} theirs
 * @returns {SceneContent & { lost: string[] }} lost: ids of things whose change of mine is not in it; '' for the name
 */
export function mergeScenes(base, mine, theirs) {
  const [before, here, there] = [base, mine, theirs].map(({ items }) => new Map(items.map((item) => [item.id, item])));
  /** @type {string[]} */
  const lost = [];
  const items = [];
  for (const id of new Set([...there.keys(), ...here.keys()])) {
    const [old, own, other] = [before.get(id), here.get(id), there.get(id)];
    const [ownChanged, otherChanged] = [!isSame(own, old), !isSame(other, old)];
    if (ownChanged && otherChanged && !isSame(own, other)) lost.push(id);
    const merged = ownChanged && !otherChanged ? own : other;
    if (merged) items.push(merged);
  }
  const [ownName, otherName] = [mine.name !== base.name, theirs.name !== base.name];
  if (ownName && otherName && mine.name !== theirs.name) lost.push('');
  return { name: ownName && !otherName ? mine.name : theirs.name, items, lost };
}

/**
 * Whether two contents of a scene are the same.
 * @param {SceneContent} one
 * @param {SceneContent} other
 */
export function isSameContent(one, other) {
  return (
    one.name === other.name &&
    one.items.length === other.items.length &&
    one.items.every((item, place) => isSame(item, other.items[place]))
  );
}

/**
 * @param {PlacedAsset | undefined} one
 * @param {PlacedAsset | undefined} other
 */
export function isSame(one, other) {
  return one === other || (Boolean(one && other) && numbersOf(one) === numbersOf(other));
}

/** @param {PlacedAsset | undefined} item */
function numbersOf(item) {
  return item && [item.id, item.asset, ...item.position_m, ...item.rotation, item.scale].join(' ');
}
