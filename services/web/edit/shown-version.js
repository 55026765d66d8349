// A version of an asset as it is edited: its files, its frame, its mesh, and the job that can be run again.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { verticesOf } from './cut-preview.js';
import { checkEntry } from '../catalogue/signed-catalogue.js';
import { loadFile } from '../catalogue/verified-cache.js';
import { CaptureFrame } from '../graphics/capture-frame.js';
import { prepare } from '../graphics/gpu-warmup.js';
import { Model } from '../graphics/model.js';
import { getJson, getVersion } from '../shared/api.js';
import { Problem } from '../shared/problems.js';
import { t } from '../shared/texts.js';

/** @import { Stage } from '../graphics/scene.js' */
/** @import { AssetEntry, AssetFile, Edits, Job, Manifest } from '../shared/types.d.ts' */

const CAMERAS = 'cameras.json'; // of a bundle of photos

/**
 * @typedef {object} ShownVersion
 * @property {AssetEntry} entry as it was with this version
 * @property {Edits} edits the recipe that it was made with
 * @property {CaptureFrame} frame
 * @property {Model} model
 * @property {THREE.Box3} bounds of the mesh, asset frame
 * @property {AssetFile | undefined} cameras the file with the cameras of the capture's photos
 */

/**
 * Loads a version until its coarsest level of detail is there.
 * @param {AssetEntry} newest
 * @param {number} version
 * @param {Stage} stage
 * @param {() => void} onLevel is called for each level that has come
 * @returns {Promise<ShownVersion>}
 * @throws {Problem} NO_FRAME, and what loading throws
 */
export async function loadVersion(newest, version, stage, onLevel) {
  const entry = version === newest.version ? await checkEntry(newest) : await getVersion(newest.key, version);
  if (!entry.capture_to_asset) {
    throw new Problem({
      code: 'NO_FRAME',
      detail: t('This object was not made from a capture here, so there is nothing to edit.'),
    });
  }
  const { url, sha256 } = entry.manifest;
  /** @type {Manifest} */
  const manifest = JSON.parse(new TextDecoder().decode(await loadFile({ url, sha256, file: 'manifest.json' })));
  const model = new Model(entry, stage.renderer, { prepare: (level) => prepare(stage, level), onLevel });
  await model.start();
  model.want(0);
  const coarsest = model.coarsest ?? model.object;
  const bounds = new THREE.Box3().setFromPoints(verticesOf(coarsest, model.object));
  const cameras = entry.files?.find(({ file }) => file === CAMERAS);
  return {
    entry,
    edits: manifest.edits ?? {},
    frame: new CaptureFrame(entry.capture_to_asset),
    model,
    bounds,
    cameras,
  };
}

/**
 * The job whose capture can be reconstructed again: that of a version, else the newest one.
 * @param {AssetEntry} newest
 * @param {number} version
 * @returns {Promise<Job>}
 * @throws {Problem} NO_JOB, and what the server says
 */
export async function findJob({ versions = [] }, version) {
  const own = versions.find((record) => record.version === version)?.job;
  const id = own || versions.findLast((record) => record.job)?.job;
  if (!id) throw notStored();
  try {
    return await getJson(`/v1/jobs/${encodeURIComponent(id)}`);
  } catch (error) {
    if (error instanceof Problem && error.code === 'JOB_UNKNOWN') throw notStored();
    throw error;
  }
}

/** Nothing is stored that the thing could be made from again. */
export const notStored = () =>
  new Problem({ code: 'NO_JOB', detail: t('No capture of this object is stored here, so it cannot be made again.') });
