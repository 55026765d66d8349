// An asset in the scene: its place, the version that is shown, and how large it is in view. A new version keeps the place.
import * as THREE from '../vendor/three-0.187.0.module.js';
import { deletePlacement, loadPlacement, savePlacement } from './saved-placement.js';
import { Model } from '../graphics/model.js';
import { dispose } from '../graphics/scene.js';

/** @import { AssetEntry, AssetFile, PlacedAsset, Pose } from '../shared/types.d.ts' */
/** @import { Tileset, TilesetOptions } from './tileset.js' */
/** @typedef {SceneItem & { entry: AssetEntry, model: Model }} LoadedItem */

const HALF_VIEW = Math.tan(Math.PI / 8); // half the height of a view of 45 degrees, one metre ahead
const TILESET = 'tileset.json'; // of an asset's files, the one that lists the tiles of a large scene
const WALKABLE_M = 4; // of a side, from which on people walk inside
const NEAR_M = 0.01; // from inside a thing all of it counts as in view
const DIGITS = 5; // of what a scene saves of a place: a hundredth of a millimetre
const DEFAULT_PLACEMENT = { offset_m: [0, 0, 0], turn: [0, 0, 0, 1], scale: 1 };

/** An asset in the scene. */
export class SceneItem {
  /** @type {AssetEntry | null} */
  entry = null; // of the version that is shown
  /** @type {Model | null} */
  model = null;
  /** @type {Tileset | null} */
  tileset = null; // of a large scene, once its module is loaded
  /** @type {{ dispose: () => void } | null} */
  splats = null; // that are shown in place of the mesh
  isTiled = false; // whether it is such a scene, and its finer levels of detail are not needed
  /** @type {number[]} */
  loadedLevels = []; // of detail, in the order in which they came
  problem = ''; // the last message about this item
  code = ''; // of that problem
  isNew = false; // whether somebody has added it here, and it has no place yet
  /** @type {PlacedAsset | null} */
  placed = null; // where its scene has it; null: it stands by itself, or where this device has saved
  /** @type {PlacedAsset | null} */
  #placedFirst = null; // as others have saved it, before it was moved here
  /** @type {THREE.Points | null} */
  #hints = null;

  /**
   * @param {string} key of the asset
   * @param {PlacedAsset | null} [placed] in a scene
   */
  constructor(key, placed = null) {
    this.key = key;
    this.placed = this.#placedFirst = placed;
    this.group = new THREE.Group(); // in the frame of the scene's root: its floor, in metres
    this.home = new THREE.Vector3(); // the default place
  }

  /** Its name for people. */
  get name() {
    return this.entry?.label || this.key;
  }

  /**
   * Loads a version, then shows it in place of the one before. Throws what loading throws.
   * @param {AssetEntry} entry
   * @param {THREE.WebGLRenderer} renderer
   * @param {{ prepare: (group: THREE.Group) => Promise<void>, onChange: () => void, onTileError: (error: Error, file: string) => void }} options
   *   prepare: of gpu-warmup.js; onChange: is called for each level of detail and each tile that has come; onTileError: of a Tileset
   */
  async show(entry, renderer, { prepare, onChange, onTileError }) {
    /** @type {number[]} */
    const loadedLevels = [];
    /** @param {number} level */
    const onLevel = (level) => {
      loadedLevels.push(level);
      onChange();
    };
    const model = new Model(entry, renderer, { prepare, onLevel });
    try {
      await model.start();
    } catch (error) {
      model.dispose();
      throw error;
    }
    this.showHints(null);
    this.#dispose();
    const root = entry.files?.find(({ file }) => file === TILESET);
    Object.assign(this, { entry, model, loadedLevels, isTiled: Boolean(root) });
    this.group.add(model.object);
    if (root) this.#showTiles(entry, root, renderer, { onChange, onError: onTileError });
  }

  /**
   * Loads the tiles of a large scene, which replace the coarse mesh of the whole.
   * @param {AssetEntry} entry
   * @param {AssetFile} root its list of tiles; without it the levels of detail of the whole are shown
   * @param {THREE.WebGLRenderer} renderer
   * @param {TilesetOptions} options
   */
  async #showTiles(entry, root, renderer, { onChange, onError }) {
    /** @type {TilesetOptions['onError']} */
    const report = (error, file) => {
      if (file === TILESET) this.isTiled = false;
      onError(error, file);
    };
    try {
      const { Tileset: Tiles } = await import('./tileset.js');
      if (this.entry !== entry || !this.model) return; // a newer version has come, or the item is gone
      this.tileset = new Tiles(entry, root, renderer, { onChange, onError: report });
      this.group.add(this.tileset.object);
    } catch (error) {
      report(/** @type {Error} */ (error), TILESET);
    }
  }

  /** Frees what the version holds that is shown. */
  #dispose() {
    this.splats?.dispose();
    this.model?.dispose();
    this.tileset?.dispose();
    this.tileset = null;
  }

  /**
   * Shows points in place of the mesh until it is loaded.
   * @param {THREE.Points | null} points null removes them
   */
  showHints(points) {
    if (this.#hints) {
      this.#hints.removeFromParent();
      dispose(this.#hints);
    }
    this.#hints = points;
    if (points) this.group.add(points);
  }

  /** Frees the version that is shown; the item keeps its place. */
  unload() {
    this.showHints(null);
    this.#dispose();
    this.model = null;
    this.entry = null;
  }

  /** Removes the item from the scene and frees its memory. */
  remove() {
    this.showHints(null);
    this.#dispose();
    this.model = null;
    this.group.removeFromParent();
  }

  /** Whether it is so large that people walk inside instead of holding it. */
  get isWalkable() {
    const [width, , depth] = this.#size;
    return Math.max(width, depth) * this.group.matrixWorld.getMaxScaleOnAxis() > WALKABLE_M;
  }

  /** What is drawn of it: its tiles, or the level of detail that is shown. */
  get surface() {
    return this.tileset?.isShown ? this.tileset.object : this.model?.object.children.find(({ visible }) => visible);
  }

  /** Its box in the frame of its group, in metres. */
  get box() {
    const [width, height, depth] = this.#size;
    return new THREE.Box3(
      new THREE.Vector3(-width / 2, 0, -depth / 2),
      new THREE.Vector3(width / 2, height, depth / 2),
    );
  }

  /**
   * Share of the view's height that its diameter takes.
   * @param {THREE.Vector3} eye in the world
   */
  viewShare(eye) {
    const [width, height, depth] = this.#size;
    const middle = new THREE.Vector3(0, height / 2, 0).applyMatrix4(this.group.matrixWorld);
    const diameter = Math.hypot(width, height, depth) * this.group.matrixWorld.getMaxScaleOnAxis();
    return diameter / (2 * HALF_VIEW * Math.max(NEAR_M, eye.distanceTo(middle)));
  }

  /** Places the item where its scene has it, where the person left it, or at its default place. */
  place() {
    if (this.placed) {
      const { position_m: position, rotation, scale } = this.placed;
      this.group.position.fromArray(position);
      this.group.quaternion.fromArray(rotation);
      this.group.scale.setScalar(scale);
      this.group.updateMatrixWorld();
      return;
    }
    const { offset_m: offset, turn, scale } = loadPlacement(this.key) ?? DEFAULT_PLACEMENT;
    this.group.position.fromArray(offset).add(this.home);
    this.group.quaternion.set(turn[0], turn[1], turn[2], turn[3]);
    this.group.scale.setScalar(scale);
    this.group.updateMatrixWorld();
  }

  /** Makes the item part of a scene, where it stands now. */
  fix() {
    this.placed ??= { id: randomId(), asset: this.key, ...this.pose };
    this.#placedFirst ??= this.placed;
  }

  /**
   * Takes over where somebody else has put the item.
   * @param {PlacedAsset} placed
   */
  adopt(placed) {
    this.placed = this.#placedFirst = placed;
  }

  /**
   * Where it stands now in its scene, rounded.
   * @returns {Pose}
   */
  get pose() {
    const { position, quaternion, scale } = this.group;
    const rounded = (/** @type {number[]} */ numbers) => numbers.map((value) => Number(value.toFixed(DIGITS)) + 0); // + 0: no -0
    return {
      position_m: rounded(position.toArray()),
      rotation: rounded(quaternion.clone().normalize().toArray()),
      scale: Number(scale.x.toFixed(DIGITS)),
    };
  }

  /** Saves where the item stands now. */
  savePlace() {
    if (this.placed) {
      this.placed = { ...this.placed, ...this.pose };
      return;
    }
    const offset = this.group.position.clone().sub(this.home);
    savePlacement(this.key, {
      offset_m: offset.toArray(),
      turn: this.group.quaternion.toArray(),
      scale: this.group.scale.x,
    });
  }

  /** Puts the item back to its default place, in a scene to where that had it before it was moved here. */
  resetPlace() {
    if (this.placed) this.placed = this.#placedFirst;
    else deletePlacement(this.key);
    this.place();
  }

  /** Width, height and depth in metres. */
  get #size() {
    if (!this.entry) throw new Error(`${this.key} is not loaded, so its size is not known.`);
    return this.entry.size_m;
  }
}

/** An id within a scene. (`crypto.randomUUID` needs HTTPS, which a headset in the same room has not.) */
export function randomId() {
  return [...crypto.getRandomValues(new Uint8Array(8))].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

/**
 * Whether a version of the item is shown.
 * @param {SceneItem} item
 * @returns {item is LoadedItem}
 */
export function isLoaded(item) {
  return item.entry !== null;
}
