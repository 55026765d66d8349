// Which things of a collection are garments, of which season, and from where they hang: by the words of their labels and names, in English and German.
import { simplify } from '../shared/search-words.js';

/** @import { CollectionRow } from '../shared/types.d.ts' */
/** @typedef {'spring' | 'summer' | 'autumn' | 'winter'} Season */
/** @typedef {'shoulders' | 'waist'} Hanging from where a garment hangs */
/** @typedef {Season | 'all' | `label:${string}`} Choice garments of a season, all garments, or all things that bear a label */
/** @typedef {Pick<CollectionRow, 'key' | 'label' | 'labels' | 'state'>} Thing */

/** @type {Season[]} */
export const SEASONS = ['spring', 'summer', 'autumn', 'winter'];

// Of words without accents and capital letters. German ones are parts of longer words ("Sommerkleid"); "Falle" and "Springer" are none.
/** @type {Record<Season, RegExp>} */
const SEASON_WORDS = {
  spring: /^(spring|springtime|fruh(ling|jahr).*|frueh(ling|jahr).*)$/,
  summer: /^(summer|sommer)/,
  autumn: /^(fall|autumn.*|herbst.*)$/,
  winter: /^winter/,
};
const WAIST_WORDS = /^(.*skirts?|(?!barock)\w*rocke?|trousers|pants|jeans|shorts|leggings|chinos|culottes|\w*hosen?)$/;
const SHOULDER_WORDS =
  /^(dress|dresses|gown|tunic|.*shirts?|blouses?|sweaters?|jumpers?|pullover|hoodies?|cardigan|jackets?|\w*coats?|suit|(jump|play|boiler)suits?|rompers?|dungarees|\w*overalls?|kimonos?|vests?|ponchos?|capes?|top|\w*kleid(er)?|\w*hemd(en)?|\w*blusen?|\w*jacken?|\w*mantel|\w*westen?|\w*anzug|latzhosen?)$/;
const CLOTHES_WORDS = /^(garments?|clothes|clothing|wardrobe|outfit|fashion|kleidung|garderobe|kleiderschrank)$/;
const MONTHS_BEFORE_SPRING = 2; // seasons of meteorologists: spring begins with March
// Time zones south of the equator whose winter is in July. Where none of them is told, it is the north.
const SOUTH =
  /^(Australia|Antarctica|America\/Argentina)\/|^America\/(Asuncion|Buenos_Aires|Montevideo|Punta_Arenas|Santiago|Sao_Paulo)$|^Africa\/(Gaborone|Johannesburg|Maseru|Mbabane|Windhoek)$|^Pacific\/(Auckland|Chatham)$/;

/**
 * The season of a day: three whole months each, spring from March on, in the south from September on.
 * @param {Date} day
 * @param {string} timeZone as "Europe/Berlin"
 * @returns {Season}
 */
export function seasonOf(day, timeZone) {
  const month = day.getMonth() + (SOUTH.test(timeZone) ? 6 : 0);
  return SEASONS[Math.floor(((month + 12 - MONTHS_BEFORE_SPRING) % 12) / 3)];
}

/**
 * The seasons that a thing's labels name.
 * @param {Pick<Thing, 'labels'>} thing
 */
export function seasonsOf({ labels }) {
  const words = wordsOf(labels);
  return SEASONS.filter((season) => words.some((word) => SEASON_WORDS[season].test(word)));
}

/**
 * From where a thing hangs on a body; null: nothing says that it is a garment.
 * @param {Pick<Thing, 'label' | 'labels'>} thing
 * @returns {Hanging | null}
 */
export function hangingOf({ label, labels }) {
  const words = wordsOf([label, ...labels]);
  const isOne = (/** @type {RegExp} */ kind) => words.some((word) => kind.test(word));
  if (isOne(SHOULDER_WORDS)) return 'shoulders'; // "dress with a wide skirt"
  if (isOne(WAIST_WORDS)) return 'waist';
  return isOne(CLOTHES_WORDS) || seasonsOf({ labels }).length > 0 ? 'shoulders' : null;
}

/**
 * The things of a collection that a choice is about, by name.
 * @template {Thing} T
 * @param {T[]} things
 * @param {Choice} choice
 */
export function chooseGarments(things, choice) {
  const found = things.filter((thing) => thing.state !== 'removed' && isChosen(thing, choice));
  return found.sort((one, other) =>
    one.label.localeCompare(other.label, undefined, { numeric: true, sensitivity: 'base' }),
  );
}

/**
 * @param {Thing} thing
 * @param {Choice} choice
 */
function isChosen(thing, choice) {
  const season = SEASONS.find((each) => each === choice);
  if (season) return seasonsOf(thing).includes(season);
  if (choice === 'all') return hangingOf(thing) !== null;
  return thing.labels.some((label) => simplify(label) === simplify(choice.slice('label:'.length)));
}

/**
 * The labels of a collection's things that name no season, each once whatever its case, by name.
 * @param {Thing[]} things
 */
export function otherLabels(things) {
  const labels = things.filter(({ state }) => state !== 'removed').flatMap((thing) => thing.labels);
  const others = labels.filter((label) => seasonsOf({ labels: [label] }).length === 0);
  return [...new Map(others.map((label) => [simplify(label), label])).values()].sort((one, other) =>
    one.localeCompare(other),
  );
}

/** @param {string[]} texts */
const wordsOf = (texts) => texts.flatMap((text) => simplify(text).split(/[^\p{L}]+/u)).filter(Boolean);
