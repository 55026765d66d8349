// The panel of the viewer's page that says in plain words how good a thing is, what to mind, what to shoot again, and how it was made.
import { create, element } from '../shared/dom.js';
import { sentences } from '../shared/problems.js';

/** @import { AssetEntry, CaptureSummary, Manifest, QualityFigures } from '../shared/types.d.ts' */
/** @typedef {[title: string, sentences: string[]]} Section */

const [CLOSE, MOSTLY] = [0.98, 0.9]; // share of the points near the surface, from which on it follows them closely, or mostly
/** @type {Record<string, string>} */
const VERDICTS = {
  better: 'Training made it better than the preview was.',
  even: 'Training did not make it better than the preview was.',
  worse: 'By its figures it is worse than the preview was.',
};
/** @type {Record<string, string>} */
const KEPT = { object: 'the thing without its surroundings', scene: 'everything that was seen' };
/** @type {Record<string, string>} */
const SCALES = { metric: 'Its size was measured.', estimated: 'Its size was estimated.', unknown: 'Its true size is not known.' };
/** @type {Record<string, string>} */
const UP_TELLERS = {
  person: 'by a person',
  app: 'by the app that captured it',
  gravity: "by the photos' sensors",
  turntable: 'by the turntable',
  lines: 'by upright lines in the pictures',
  walk: 'by the way of the camera',
  plane: 'by what it stands on',
  cameras: 'by how the camera was held',
};

/**
 * Fills the panel.
 * @param {AssetEntry} entry
 * @param {(entry: AssetEntry) => Promise<Manifest>} loadManifest
 */
export async function showAbout(entry, loadManifest) {
  const panel = element('about-text', HTMLElement);
  try {
    const manifest = await loadManifest(entry);
    panel.replaceChildren(...sectionsOf(entry, manifest).filter(([, lines]) => lines.length > 0).flatMap(sectionElements));
    document.body.dataset.about = String(entry.version);
  } catch (error) {
    panel.replaceChildren(create('p', { textContent: sentences(error) }));
  }
}

/** @param {Section} section */
function sectionElements([title, lines]) {
  const list = create('ul');
  list.append(...lines.map((line) => create('li', { dir: 'auto', textContent: line })));
  return [create('h2', { textContent: title }), list];
}

/**
 * @param {AssetEntry} entry
 * @param {Manifest} manifest
 * @returns {Section[]}
 */
function sectionsOf(entry, manifest) {
  const { quality, warnings = [], capture = {} } = manifest;
  return [
    ['How good it is', quality ? qualityLines(quality, entry) : []],
    ['Warnings', warnings],
    ['To see more of it', (capture.unseen ?? []).map(({ advice }) => advice)],
    ['How it was made', originLines(entry, manifest)],
  ];
}

/**
 * @param {QualityFigures} quality
 * @param {AssetEntry} entry
 */
function qualityLines({ held_out: heldOut, held_out_mean: distance, coverage, components, boundary_loops: borders, verdict, photos }, entry) {
  const points = heldOut ? 'points that were kept aside to test it' : 'the points that it was made from';
  return [
    coverage === undefined ? '' : `${closeness(coverage)}: ${percent(coverage)} of ${points} lie on it, to within the distance from one to the next.`,
    distance === undefined ? '' : `On average they are ${distanceText(distance, entry)} away from it.`,
    photos ? `${percent(photos.cover)} of what photos that were kept aside show of it is there.` : '',
    components === undefined || borders === undefined ? '' : `It has ${counted(components, 'piece')} and ${counted(borders, 'open border')}.`,
    VERDICTS[verdict ?? ''] ?? '',
  ].filter(Boolean);
}

/** @param {number} coverage */
function closeness(coverage) {
  if (coverage >= CLOSE) return 'It follows what was captured closely';
  return coverage >= MOSTLY ? 'It follows most of what was captured' : 'It misses parts of what was captured';
}

/**
 * A distance as a share of the size, and in millimetres where the size is known.
 * @param {number} share of the longest side
 * @param {AssetEntry} entry
 */
function distanceText(share, { size_m: size, scale_confidence: confidence }) {
  const ofSize = `${(100 * share).toPrecision(2)} % of its size`;
  return confidence === 'unknown' ? ofSize : `${(1000 * share * Math.max(...size)).toPrecision(2)} mm, ${ofSize},`;
}

/**
 * @param {AssetEntry} entry
 * @param {Manifest} manifest
 */
function originLines(entry, { capture = {}, preset, preset_because: because, target, generator }) {
  const made = entry.versions?.find(({ version }) => version === entry.version)?.created;
  const { cut, up } = capture;
  return [
    captureText(capture),
    cut ? `Kept: ${KEPT[cut.kept] ?? cut.kept}; ${cut.because}.` : '',
    SCALES[entry.scale_confidence] ?? '',
    up ? `Which way is up was told ${UP_TELLERS[up.source] ?? up.source}, with ${percent(up.confidence)} confidence.` : '',
    preset ? `Preset ${preset}${because ? `, as ${because}` : ''}${target ? `; for ${target}` : ''}.` : '',
    `Version ${entry.version}, ${entry.state}${made ? `, of ${new Date(made).toLocaleDateString(undefined, { dateStyle: 'long' })}` : ''}${generator ? `, by ${generator}` : ''}.`,
  ].filter(Boolean);
}

/** @param {CaptureSummary} capture */
function captureText({ kind, format, frames, photos = [] }) {
  const unused = photos.filter(({ verdict }) => verdict !== 'ok').length;
  if (kind === 'image') return 'Guessed from one photo: what the photo does not show looks as things of its kind do.';
  if (kind === 'points') return `Made from a scan (${format}).`;
  if (!frames) return '';
  const pictures = format === 'video' ? 'pictures of a film' : kind === 'photos' ? 'photos' : 'depth pictures';
  return `Made from ${frames} ${pictures}${unused ? `; ${unused} of them could not be used` : ''}.`;
}

/** @param {number} share */
const percent = (share) => `${(100 * share).toFixed(share > 0.995 && share < 1 ? 1 : 0)} %`;

/**
 * @param {number} count
 * @param {string} noun
 */
const counted = (count, noun) => `${count === 0 ? 'no' : count.toLocaleString('en')} ${noun}${count === 1 ? '' : 's'}`;
