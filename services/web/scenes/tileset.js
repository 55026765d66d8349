// A scene in tiles (3D Tiles): loads the tiles that are in view, as fine as the device can draw, and forgets those that were left behind.
// Loaded only for an asset that has tiles.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { TilesRenderer } from '../vendor/tiles-renderer-0.5.3.index.js';
import { MOST_TRIANGLES } from './layout-and-lod.js';
import { loadFile } from '../catalogue/verified-cache.js';
import { createGlbLoader } from '../graphics/glb-loader.js';
import { dispose } from '../graphics/scene.js';

/** @import { Tile } from '../vendor/tiles-renderer-0.5.3.index.js' */
/** @import { AssetEntry, AssetFile } from '../shared/types.d.ts' */

const FINE_ENOUGH_PX = 6; // of a tile's error on the screen; below, its finer ones are not loaded
const COARSEST_PX = 200; // to which a crowded view may raise it
const EASE = 1.15; // by which the allowed error rises or falls from frame to frame
const ROOM_TO_SPARE = 0.6; // of the triangles, below which it falls again: otherwise the tiles would flicker
const MOST_BYTES = 256 * 2 ** 20; // of meshes and pictures that were left behind and are kept
const DOWNLOADS = 6; // at once
const DECODINGS = 2; // at once, as the workers that do it
const HASH = /\.[0-9a-f]{64}(?=\.)/; // in a file's name
const RETRY_MS = 30_000; // before what could not be loaded is asked for again

/**
 * @typedef {object} TilesetOptions
 * @property {() => void} onChange is called when there is something new to draw
 * @property {(error: Error, file: string) => void} onError is called for a tile that could not be loaded
 */

/** The tiles of one version of an asset. */
export class Tileset {
  object = new THREE.Group(); // in the asset's frame
  triangles = 0; // of the tiles that are shown
  #tiles;
  #files;
  #renderer;
  /** @type {Map<Tile, number>} */
  #unrefined = new Map(); // tiles that stand in for children that could not be loaded, and their own error
  /** @type {THREE.Camera | null} */
  #camera = null;
  #retryAt = Infinity;

  /**
   * @param {AssetEntry} entry
   * @param {AssetFile} root its tileset.json
   * @param {THREE.WebGLRenderer} renderer
   * @param {TilesetOptions} options
   */
  constructor(entry, root, renderer, { onChange, onError }) {
    this.#files = new Map((entry.files ?? []).map((file) => [baseName(file.name), file]));
    this.#renderer = renderer;
    this.#tiles = new TilesRenderer(new URL(root.url, location.href).href);
    this.#limit();
    this.#tiles.registerPlugin({ name: 'VERIFIED_FILES', fetchData: (url) => this.#fetch(String(url)) });
    this.#tiles.manager.addHandler(/\.gltf$/, createGlbLoader(renderer)); // the name by which the library asks for a loader
    this.#tiles.addEventListener('needs-update', onChange);
    this.#tiles.addEventListener('tile-visibility-change', ({ scene, visible }) => {
      this.triangles += (visible ? 1 : -1) * trianglesOf(scene);
      onChange();
    });
    this.#tiles.addEventListener('load-error', ({ tile, error, url }) => {
      this.#standIn(tile);
      onError(error, baseName(String(url)).replace(HASH, ''));
    });
    this.#tiles.group.rotation.x = -Math.PI / 2; // a tileset's Z is up
    this.object.add(this.#tiles.group);
  }

  /** Whether its tiles are drawn, so that nothing has to stand for them any more. */
  get isShown() {
    return this.#tiles.visibleTiles.size > 0;
  }

  /** How many tiles are drawn. */
  get tileCount() {
    return this.#tiles.visibleTiles.size;
  }

  /** Bytes of all tiles that are kept. */
  get bytes() {
    return this.#tiles.lruCache.cachedBytes;
  }

  /**
   * Chooses the tiles for a camera, and loads those that are missing. To be called before each frame.
   * @param {THREE.Camera} camera
   */
  update(camera) {
    if (camera !== this.#camera) {
      if (this.#camera) this.#tiles.deleteCamera(this.#camera);
      this.#tiles.setCamera(camera);
      this.#camera = camera;
    }
    this.#setResolution(camera);
    if (performance.now() > this.#retryAt) this.#retry();
    this.#keepBudget();
    this.#tiles.update();
  }

  /** Frees all memory. */
  dispose() {
    this.#tiles.dispose();
    dispose(this.object);
    this.object.removeFromParent();
  }

  #limit() {
    this.#tiles.errorTarget = FINE_ENOUGH_PX;
    this.#tiles.lruCache.minBytesSize = 0.8 * MOST_BYTES;
    this.#tiles.lruCache.maxBytesSize = MOST_BYTES;
    this.#tiles.downloadQueue.maxJobsPerOrigin = DOWNLOADS;
    this.#tiles.parseQueue.maxJobs = DECODINGS;
  }

  /** @param {THREE.Camera} camera */
  #setResolution(camera) {
    const eye = camera instanceof THREE.ArrayCamera ? camera.cameras.at(0) : null;
    if (eye?.viewport) this.#tiles.setResolution(camera, eye.viewport.z, eye.viewport.w);
    else this.#tiles.setResolutionFromRenderer(camera, this.#renderer);
  }

  /** Allows a larger error while there are too many triangles in view. */
  #keepBudget() {
    const allowed = this.#tiles.errorTarget;
    if (this.triangles > MOST_TRIANGLES) this.#tiles.errorTarget = Math.min(COARSEST_PX, allowed * EASE);
    else if (this.triangles < ROOM_TO_SPARE * MOST_TRIANGLES) {
      this.#tiles.errorTarget = Math.max(FINE_ENOUGH_PX, allowed / EASE);
    }
  }

  /**
   * Loads a file of the asset, by the hash that the catalogue has for it.
   * @param {string} url
   */
  async #fetch(url) {
    const file = this.#files.get(baseName(url));
    if (!file) throw new Error(`The catalogue has no file ${baseName(url)}.`);
    const bytes = await loadFile(file);
    return file.file.endsWith('.json') ? inAssetFrame(JSON.parse(new TextDecoder().decode(bytes))) : bytes;
  }

  /**
   * Shows a tile's parent in place of it and its siblings: a coarser part is better than a hole.
   * @param {Tile | null} tile
   */
  #standIn(tile) {
    this.#retryAt = Math.min(this.#retryAt, performance.now() + RETRY_MS);
    const parent = tile?.parent;
    if (!parent || this.#unrefined.has(parent)) return;
    this.#unrefined.set(parent, parent.geometricError);
    parent.geometricError = 0;
  }

  /** Asks again for what could not be loaded. */
  #retry() {
    this.#retryAt = Infinity;
    for (const [tile, error] of this.#unrefined) tile.geometricError = error;
    this.#unrefined.clear();
    this.#tiles.resetFailedTiles();
  }
}

/**
 * Takes the place on earth out of a tileset.json: the tiles of a survey lie in the asset's frame, as all else here.
 * @param {{ root: { transform?: number[] } }} document
 */
function inAssetFrame(document) {
  delete document.root.transform;
  return document;
}

/**
 * The last part of an address or of a store's name, without a query.
 * @param {string} address
 */
function baseName(address) {
  return address.split(/[?#]/)[0].split('/').at(-1) ?? '';
}

/** @param {THREE.Object3D} scene of a tile */
function trianglesOf(scene) {
  let count = 0;
  scene.traverse((node) => {
    if (node instanceof THREE.Mesh) {
      count += (node.geometry.index?.count ?? node.geometry.attributes.position.count) / 3;
    }
  });
  return count;
}
