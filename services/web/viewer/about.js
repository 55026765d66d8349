// The panel of the viewer's page that says in plain words how good a thing is, what to mind, what to shoot again, and how it was made.
import { create, element } from '../shared/dom.js';
import { formatCount, formatNumber, stateText } from '../shared/format.js';
import { allStored, loadSentences, stored } from '../shared/stored-sentences.js';
import { t } from '../shared/texts.js';

/** @import { AssetEntry, CaptureSummary, Manifest, QualityFigures } from '../shared/types.d.ts' */
/** @typedef {[title: string, sentences: string[]]} Section */

const [CLOSE, MOSTLY] = [0.98, 0.9]; // share of the points near the surface, from which on it follows them closely, or mostly
/** @type {Record<string, string>} */
const VERDICTS = {
  better: t('Training made it better than the preview was.'),
  even: t('Training did not make it better than the preview was.'),
  worse: t('By its figures it is worse than the preview was.'),
};
/** @type {Record<string, string>} */
const KEPT = { object: t('the object without its surroundings'), scene: t('everything that was seen') };
/** @type {Record<string, string>} */
const SCALES = {
  metric: t('Its size was measured.'),
  estimated: t('Its size was estimated.'),
  unknown: t('Its true size is not known.'),
};
/** @type {Record<string, string>} */
const UP_TELLERS = {
  person: t('by a person'),
  app: t('by the app that captured it'),
  gravity: t('by the photos’ sensors'),
  turntable: t('by the turntable'),
  lines: t('by upright lines in the pictures'),
  walk: t('by the way of the camera'),
  plane: t('by what it stands on'),
  cameras: t('by how the camera was held'),
};

/**
 * Fills the panel.
 * @param {AssetEntry} entry
 * @param {(entry: AssetEntry) => Promise<Manifest>} loadManifest
 * @throws {Problem} as `loadManifest`
 */
export async function showAbout(entry, loadManifest) {
  const [manifest] = await Promise.all([loadManifest(entry), loadSentences()]);
  const sections = sectionsOf(entry, manifest).filter(([, lines]) => lines.length > 0);
  element('about-text', HTMLElement).replaceChildren(...sections.flatMap(sectionElements));
  document.body.dataset.about = String(entry.version);
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
  const { quality, warnings = [], warnings_i18n: codes, capture = {} } = manifest;
  return [
    [t('How good it is'), quality ? qualityLines(quality, entry) : []],
    [t('Warnings'), allStored(warnings, codes)],
    [t('To see more of it'), (capture.unseen ?? []).map(({ advice, advice_i18n: code }) => stored(advice, code))],
    [t('How it was made'), originLines(entry, manifest)],
  ];
}

/**
 * @param {QualityFigures} quality
 * @param {AssetEntry} entry
 */
function qualityLines(
  {
    held_out: heldOut,
    held_out_mean: distance,
    coverage,
    components,
    boundary_loops: borders,
    verdict,
    photos,
    origins,
  },
  entry,
) {
  const points = heldOut ? t('points that were kept aside to test it') : t('the points that it was made from');
  return [
    coverage === undefined
      ? ''
      : t('{closeness}: {percent} of {points} lie on it, to within the distance from one to the next.', {
          closeness: closeness(coverage),
          percent: percent(coverage),
          points,
        }),
    distance === undefined ? '' : distanceText(distance, entry),
    photos
      ? t('{percent} of what photos that were kept aside show of it is there.', { percent: percent(photos.cover) })
      : '',
    origins && origins.measured < 1
      ? t('Of its surface {measured} was measured, {proposed} is a guess, and {filled} was filled in.', {
          measured: percent(origins.measured),
          proposed: percent(origins.proposed),
          filled: percent(origins.filled),
        })
      : '',
    components === undefined || borders === undefined
      ? ''
      : t('It has {pieces} and {borders}.', { pieces: piecesText(components), borders: bordersText(borders) }),
    VERDICTS[verdict ?? ''] ?? '',
  ].filter(Boolean);
}

/** @param {number} coverage */
function closeness(coverage) {
  if (coverage >= CLOSE) return t('It follows what was captured closely');
  return coverage >= MOSTLY ? t('It follows most of what was captured') : t('It misses parts of what was captured');
}

/**
 * Says a distance as a share of the size, and in millimetres where the size is known.
 * @param {number} share of the longest side
 * @param {AssetEntry} entry
 */
function distanceText(share, { size_m: size, scale_confidence: confidence }) {
  const percentage = formatNumber((100 * share).toPrecision(2));
  if (confidence === 'unknown') {
    return t('On average they are {percentage} % of its size away from it.', { percentage });
  }
  const millimetres = formatNumber((1000 * share * Math.max(...size)).toPrecision(2));
  return t('On average they are {millimetres} mm, {percentage} % of its size, away from it.', {
    millimetres,
    percentage,
  });
}

/**
 * @param {AssetEntry} entry
 * @param {Manifest} manifest
 */
function originLines(
  entry,
  {
    capture = {},
    preset,
    preset_because: because,
    preset_because_i18n: becauseCode,
    target,
    generator,
    scale_by_model: byModel,
  },
) {
  const made = entry.versions?.find(({ version }) => version === entry.version)?.created;
  const { cut, up } = capture;
  return [
    captureText(capture, entry.origin),
    cut
      ? t('Kept: {what}; {because}.', {
          what: KEPT[cut.kept] ?? cut.kept,
          because: stored(cut.because, cut.because_i18n),
        })
      : '',
    byModel ? t('Its size was estimated by a learned model.') : (SCALES[entry.scale_confidence] ?? ''),
    up
      ? t('Which way is up was told {how}, with {percent} confidence.', {
          how: UP_TELLERS[up.source] ?? up.source,
          percent: percent(up.confidence),
        })
      : '',
    preset
      ? `${[t('Preset {preset}', { preset }), because && t('as {because}', { because: stored(because, becauseCode) }), target && t('for {target}', { target })].filter(Boolean).join(', ')}.`
      : '',
    `${[
      t('Version {version}', { version: entry.version }),
      stateText(entry.state),
      made && t('of {date}', { date: new Date(made).toLocaleDateString(undefined, { dateStyle: 'long' }) }),
      generator && t('by {program}', { program: generator }),
    ]
      .filter(Boolean)
      .join(', ')}.`,
  ].filter(Boolean);
}

/**
 * @param {CaptureSummary} capture
 * @param {AssetEntry['origin']} origin
 */
function captureText({ kind, format, frames, photos = [] }, origin) {
  if (origin === 'generated') return t('A generator made its shape up from one photo; nothing of it was measured.');
  const unused = photos.filter(({ verdict }) => verdict !== 'ok').length;
  if (kind === 'image') {
    return t('Guessed from one photo: its outline was inflated, and the photo printed on it.');
  }
  if (kind === 'points') return t('Made from a scan ({format}).', { format: format ?? '' });
  if (!frames) return '';
  return (
    madeFrom(frames, format === 'video' ? 'video' : kind) +
    (unused ? ` ${t('{count} of them could not be used.', { count: unused })}` : '')
  );
}

/**
 * @param {number} count
 * @param {string | undefined} kind
 */
function madeFrom(count, kind) {
  if (kind === 'video') return t('Made from {count} pictures of a video.', { count });
  return kind === 'photos'
    ? t('Made from {count} photos.', { count })
    : t('Made from {count} depth pictures.', { count });
}

/** @param {number} share */
const percent = (share) => `${formatNumber((100 * share).toFixed(share > 0.995 && share < 1 ? 1 : 0))} %`;

/** @param {number} count */
const piecesText = (count) => (count === 1 ? t('1 piece') : t('{count} pieces', { count: formatCount(count) }));

/** @param {number} count */
function bordersText(count) {
  if (count === 0) return t('no open borders');
  return count === 1 ? t('1 open border') : t('{count} open borders', { count: formatCount(count) });
}
